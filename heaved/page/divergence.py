"""How far the real-time heave was from the delayed one, which is exact and old: what a person should see diverge."""

from __future__ import annotations

from collections import deque
from math import sqrt
from typing import Final

import msgspec

WINDOW_S: Final = 300.0
"""Some thirty waves."""
_LONGEST_DELAY_S: Final = 180.0
_LONGEST_GAP_S: Final = 0.5
"""Between two frames that are this far apart nothing is known of the heave."""
_MOST: Final = 20_000
"""Differences that are kept, should delayed heaves come at 60 Hz and more."""


class Divergence(msgspec.Struct, frozen=True, kw_only=True):
    """Real-time heave minus delayed heave of the same moments."""

    rms_m: float
    expected_m: float
    """What their standard deviations say that it should be."""
    span_s: float
    """Between the first and the last of those moments."""
    count: int


class _Heave(msgspec.Struct, frozen=True, gc=False):
    at_s: float
    heave_m: float
    std_m: float


class DivergenceMeter:
    """Meets each delayed heave with the real-time heave that was said for the same moment. Times on one clock."""

    def __init__(self) -> None:
        self._said: deque[_Heave] = deque()
        self._differences: deque[tuple[float, float, float]] = deque(maxlen=_MOST)
        """(time, squared difference, squared standard deviation of it)"""

    def said(self, at_s: float, heave_m: float, std_m: float) -> None:
        """The real-time heave of ``at_s``."""
        if self._said and at_s <= self._said[-1].at_s:
            return
        self._said.append(_Heave(at_s, heave_m, std_m))
        while self._said[0].at_s < at_s - _LONGEST_DELAY_S:
            self._said.popleft()

    def delayed(self, at_s: float, heave_m: float, std_m: float) -> None:
        """The delayed heave of ``at_s``; they come in the order of their times."""
        said = self._said
        while len(said) > 1 and said[1].at_s <= at_s:
            said.popleft()
        if len(said) < 2 or said[0].at_s > at_s or said[1].at_s - said[0].at_s > _LONGEST_GAP_S:
            return
        before, after = said[0], said[1]
        share = (at_s - before.at_s) / (after.at_s - before.at_s)
        difference_m = before.heave_m + share * (after.heave_m - before.heave_m) - heave_m
        self._differences.append((at_s, difference_m**2, before.std_m**2 + std_m**2))
        while self._differences[0][0] < at_s - WINDOW_S:
            self._differences.popleft()

    def result(self) -> Divergence | None:
        """Of the last minutes; None: nothing could be compared."""
        if not self._differences:
            return None
        count = len(self._differences)
        return Divergence(
            rms_m=round(sqrt(sum(squared for _, squared, _ in self._differences) / count), 5),
            expected_m=round(sqrt(sum(variance for _, _, variance in self._differences) / count), 5),
            span_s=round(self._differences[-1][0] - self._differences[0][0], 3),
            count=count,
        )
