"""What held when: for how long, how often, and in which part of the time. Pure."""

from __future__ import annotations

from math import nan
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]

HOLDS_S: Final = 1.0
"""What a frame says holds until the next one, but no longer than that: then the daemon, too, has no heave any more."""
MOST_KINDS: Final = 48
"""That are kept apart; more than that are one."""
OTHERS: Final = "others"


class Spells(msgspec.Struct, frozen=True, kw_only=True):
    """How long something held."""

    seconds: float = 0.0
    spells: int = 0
    """Times that it began."""
    longest_s: float = 0.0
    first_s: float = nan
    """When it first began,"""
    last_s: float = nan
    """and when it last ended."""


class Lane(msgspec.Struct, frozen=True, eq=False):
    """One of them, ready to be drawn: the share of each bin of time in which it held."""

    begin_s: Array
    """(k,) of each bin."""
    width_s: float
    share: Array


class Timeline:
    """Takes down which of some kinds held in each frame, of which several may hold at a time.

    Attributes:
        seconds: that were told of: with samples.
        silent_s: in between, without.
    """

    def __init__(self, *, bins: int = 720, width_s: float = 0.0625) -> None:
        """Shares are kept in at most ``bins``, an even number, at first each ``width_s`` wide."""
        self.seconds = self.silent_s = 0.0
        self._bins, self._width_s = bins, width_s
        self._names: list[str] = []
        self._seconds = np.zeros((MOST_KINDS + 1, bins))
        self._spells: list[_Counted] = []
        self._places: dict[str, int] = {}
        self._begin_s = nan

    def place(self, name: str) -> int:
        """Number of a kind, which is new if it has not been seen before."""
        place = self._places.get(name)
        if place is None:
            if len(self._names) >= MOST_KINDS and name != OTHERS:
                return self.place(OTHERS)
            place = self._places[name] = len(self._names)
            self._names.append(name)
            self._spells.append(_Counted())
        return place

    def push(self, t_s: Array, step_s: Array, held: Sequence[tuple[int, ...]]) -> None:
        """Frames (n,) at their times, the time to the next one, and the numbers of the kinds that held."""
        if len(t_s) == 0:
            return
        if np.isnan(self._begin_s):
            self._begin_s = float(t_s[0])
        while t_s[-1] - self._begin_s >= self._bins * self._width_s:
            half = self._bins // 2
            self._seconds[:, :half] = self._seconds[:, ::2] + self._seconds[:, 1::2]
            self._seconds[:, half:] = 0.0
            self._width_s *= 2.0
        lasts_s = np.minimum(step_s, HOLDS_S)
        self.seconds += float(lasts_s.sum())
        self.silent_s += float((step_s - lasts_s).sum())
        bins = ((t_s - self._begin_s) / self._width_s).astype(np.int64)
        combinations = {combination: i for i, combination in enumerate(dict.fromkeys(held))}
        which = np.array([combinations[one] for one in held])
        for place in sorted({place for combination in combinations for place in combination}):
            has = np.array([place in combination for combination in combinations])
            holds = has[which]
            np.add.at(self._seconds[place], bins[holds], lasts_s[holds])
            self._spells[place].push(t_s, lasts_s, step_s, holds)
        for place, counted in enumerate(self._spells):
            if not any(place in combination for combination in combinations):
                counted.end()

    def spells(self, name: str) -> Spells:
        """Of one kind; one that was never seen never held."""
        place = self._places.get(name)
        return Spells() if place is None else self._spells[place].spells()

    @property
    def names(self) -> list[str]:
        """Of all kinds that were seen, the one that held longest first."""
        return sorted(self._names, key=lambda name: -self.spells(name).seconds)

    def lane(self, name: str) -> Lane:
        """Of one kind, ready to be drawn."""
        place = self._places.get(name)
        held = np.zeros(self._bins) if place is None else self._seconds[place]
        last = int(np.flatnonzero(self._seconds.any(axis=0))[-1]) + 1 if self._seconds.any() else 0
        begin_s = (self._begin_s if last else 0.0) + self._width_s * np.arange(last)
        return Lane(np.asarray(begin_s, dtype=np.float64), self._width_s, np.minimum(held[:last] / self._width_s, 1.0))


class _Counted:
    """One kind, while it is counted."""

    def __init__(self) -> None:
        self._seconds = self._longest_s = self._now_s = 0.0
        self._count = 0
        self._first_s = self._last_s = nan

    def push(self, t_s: Array, lasts_s: Array, step_s: Array, holds: NDArray[np.bool_]) -> None:
        """Frames, how long each held, the time to the next one, and whether this was among what held."""
        self._seconds += float(lasts_s[holds].sum())
        # A spell also ends where nothing was told for a while.
        ends_after = step_s > lasts_s
        before = np.concatenate(([self._now_s > 0.0], holds[:-1] & ~ends_after[:-1]))
        begins = np.flatnonzero(holds & ~before)
        goes_on = bool(holds[0] and before[0])
        number = np.cumsum(holds & ~before)[holds]
        length = np.bincount(number, lasts_s[holds], minlength=len(begins) + 1)
        if goes_on:
            length[0] += self._now_s
        self._count += len(begins)
        self._longest_s = max(self._longest_s, float(length.max()))
        last = int(np.flatnonzero(holds)[-1])
        if np.isnan(self._first_s):
            self._first_s = float(t_s[np.flatnonzero(holds)[0]])
        self._last_s = float(t_s[last] + lasts_s[last])
        self._now_s = float(length[-1]) if last == len(holds) - 1 and not ends_after[-1] else 0.0

    def end(self) -> None:
        """It holds no more."""
        self._now_s = 0.0

    def spells(self) -> Spells:
        return Spells(
            seconds=self._seconds,
            spells=self._count,
            longest_s=self._longest_s,
            first_s=self._first_s,
            last_s=self._last_s,
        )
