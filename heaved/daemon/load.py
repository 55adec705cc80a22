"""Whether the event loop keeps up, and what gives way where it does not. Pure: it is told how late the loop is.

What a machine cannot do all of is done without what fewest need. A client of the stream that does not keep up loses
lines of its own before anything else does. Then frames go to the clients several at a time, which loses none and makes
them a little older: a write costs the same whatever is in it, and with many clients that is most of the work. Then what
the heave does without is left out. Acquisition, heave, points, telegrams and registers never give way.
"""

from __future__ import annotations

from enum import Enum
from math import inf
from typing import Final

import msgspec


class Relief(Enum):
    """What gives way, by how many frames go to the clients of the stream at once."""

    NONE = 1
    GATHERED = 2
    LEFT_OUT = 4
    """And rock predictions and quiet windows are left out."""


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What is set by us, not by the user."""

    probe_s: float = 0.05
    """The loop is asked so often how late it is."""
    late_periods: float = 1.0
    """Late: by more than so many periods of the IMU. A poll that is due then is not made."""
    late_least_s: float = 2e-3
    """And by more than the loop's own timers may be."""
    busy: float = 0.25
    """Share of a second's answers that are late, from which it does not keep up: so many polls are not made ..."""
    calm: float = 0.1
    """... and up to which there is room."""
    busy_s: int = 3
    """Seconds in a row, until more gives way. What holds the loop up for a moment is over by then."""
    calm_s: int = 10
    """Seconds in a row, until less does. At first: what has to give way again soon stays so for twice as long ..."""
    soon_s: float = 60.0
    calm_most_s: int = 320
    """... and at the most for that."""


TUNING: Final = Tuning()
_STEPS: Final = tuple(Relief)


class Load:
    """Feed it how late the loop was, whenever it was asked.

    Attributes:
        relief: what gives way now.
    """

    def __init__(self) -> None:
        self.relief = Relief.NONE
        self._second_s = -inf
        """When the present second began."""
        self._asked = self._late = 0
        self._busy_s = self._calm_s = 0
        self._calm_needed_s = TUNING.calm_s
        self._relaxed_s = -inf
        """When something was taken up again."""

    def step(self, now_s: float, late_s: float, period_s: float) -> bool:
        """One answer; returns whether :attr:`relief` is another now. ``period_s``: of the IMU's polls."""
        self._asked += 1
        self._late += late_s > max(TUNING.late_periods * period_s, TUNING.late_least_s)
        if now_s - self._second_s < 1.0:
            return False
        share = self._late / self._asked
        self._second_s, self._asked, self._late = now_s, 0, 0
        self._busy_s = self._busy_s + 1 if share >= TUNING.busy else 0
        self._calm_s = self._calm_s + 1 if share <= TUNING.calm else 0
        number = _STEPS.index(self.relief)
        if self._busy_s >= TUNING.busy_s and number + 1 < len(_STEPS):
            again = now_s - self._relaxed_s < TUNING.soon_s
            self._calm_needed_s = min(2 * self._calm_needed_s, TUNING.calm_most_s) if again else self._calm_needed_s
            return self._change(number + 1)
        if number == 0:
            if self._calm_s >= TUNING.calm_most_s:
                self._calm_needed_s = TUNING.calm_s
            return False
        if self._calm_s >= self._calm_needed_s:
            self._relaxed_s = now_s
            return self._change(number - 1)
        return False

    def _change(self, number: int) -> bool:
        self.relief = _STEPS[number]
        self._busy_s = self._calm_s = 0
        return True
