"""What one address may have of the connections that a server has room for, and how fast it may make them: so that one
client in a loop, or one machine that somebody has taken over, does not shut out the others or hold up the loop.

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
BURST: Final = 40
"""So many connections one address may make at once, with a browser that opens six for each of its tabs, ..."""
RATE_HZ: Final = 10.0
"""... and so many a second for long. To let one in takes the loop some 0.1 ms, and a hundred may come at once."""
TOO_FAST: Final = "too_fast"
"""Reason under which it is counted."""
_MOST_KNOWN: Final = 1024
"""Addresses that are remembered; the one that has been silent for longest is forgotten, and may make a burst again."""


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


class Arrivals:
    """Who has connected lately. Pure: times are arguments.

    A bucket for each address, which holds ``BURST`` and is filled at ``RATE_HZ``; what is kept is when it will be full.
    """

    def __init__(self) -> None:
        self._full_s: dict[str, float] = {}

    def admits(self, address: str, now_s: float) -> bool:
        """Whether one more may come now."""
        whose = neighbourhood(address)
        if not whose:
            return True
        full_s = max(self._full_s.pop(whose, now_s), now_s)
        is_admitted = full_s - now_s <= (BURST - 1) / RATE_HZ
        self._full_s[whose] = full_s + is_admitted / RATE_HZ  # At the end: by who has come last.
        if len(self._full_s) > _MOST_KNOWN:
            del self._full_s[next(iter(self._full_s))]
        return is_admitted

    @staticmethod
    def refusal(address: str) -> str:
        """For people."""
        return f"{address} makes more than {RATE_HZ:g} connections a second: let it keep the one that it has"
