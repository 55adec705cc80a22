"""What one address may have of the connections that a server has room for: so that one client in a loop, or one machine
that somebody has taken over, does not shut out the others.

This machine may have all of them: what runs on it is trusted with more than that.
"""

from __future__ import annotations

from collections import Counter
from typing import Final

from heaved.networks import neighbourhood

SHARE: Final = 4
"""One address has at most the fourth part, rounded down, ..."""
LEAST: Final = 4
"""... or so many, if that is more: a machine with a display, a log and a compensator is one address."""
TOO_MANY: Final = "too_many_of_one_address"
"""Reason under which it is counted."""


class Shares:
    """Who has how many of ``most`` places.

    Attributes:
        each: how many one address may have.
    """

    def __init__(self, most: int) -> None:
        self.each = min(max(most // SHARE, LEAST), most)
        self._taken: Counter[str] = Counter()

    def take(self, address: str) -> bool:
        """Whether ``address`` may have one more; what it takes it gives back."""
        whose = neighbourhood(address)
        if whose and self._taken[whose] >= self.each:
            return False
        self._taken[whose] += 1
        return True

    def give_back(self, address: str) -> None:
        """It has one less."""
        whose = neighbourhood(address)
        self._taken[whose] -= 1
        if not self._taken[whose]:
            del self._taken[whose]

    def refusal(self, address: str) -> str:
        """For people."""
        return f"{address} has {self.each} connections, and no more are served to one address"
