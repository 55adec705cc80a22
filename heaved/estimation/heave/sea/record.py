"""The past that the sea is fitted to, and when it is time to fit it again."""

from __future__ import annotations

from math import nan
from typing import Final

import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common import down_sampler
from heaved.estimation.common.ring import RingBuffer

Array = NDArray[np.float64]

EARLY_EVERY_S: Final = 10.0
"""Between fits, until EARLY_S of record: each sees much more than the one before."""
EARLY_S: Final = 120.0
AGAIN_S: Final = 1.0
MUCH_MPS2: Final = 5e-4
"""RMS by which the past is amended from which the sea is looked at anew at once: below the waves, so much is as much as
the noise of a good sensor."""


class SeaRecord:
    """Beats of the last ``length_s``, and which fit of them is awaited.

    Attributes:
        started_s: time of the first sample; nan: none yet.
    """

    def __init__(self, length_s: float, first_fit_s: float, refresh_s: float) -> None:
        self._length_s, self._first_fit_s, self._refresh_s = length_s, first_fit_s, refresh_s
        self._early_s = min(EARLY_EVERY_S, refresh_s)
        self._beats = RingBuffer(int(length_s / down_sampler.TUNING.least_s), 2)
        self._number = 0
        self.clear()

    def clear(self) -> None:
        """Forget the past; what is awaited is not of it."""
        self._beats.clear()
        self._newest_s = self.started_s = self._asked_s = nan
        self._cuts: list[tuple[float, float]] = []
        self._spoilt: list[tuple[float, float]] = []
        self._blows: list[float] = []
        self._number += 1
        self._awaited = -1

    def start(self, t_s: float) -> None:
        """Time runs from here."""
        self.started_s = self._asked_s = t_s

    # --- beats -------------------------------------------------------------------------------------------------------

    def follows(self, t_s: float) -> bool:
        """Whether a beat at ``t_s`` comes after those that are stored."""
        return not t_s <= self._newest_s

    def push(self, t_s: float, a_mps2: float) -> None:
        """Store a beat."""
        self._beats.push((t_s, a_mps2))
        self._newest_s = t_s

    def amend(self, t_s: Array, more_mps2: Array) -> None:
        """Add ``more_mps2`` (n,) to what is stored, linear between ``t_s`` (n,). If it is much, look soon."""
        self._beats.add(1, t_s, more_mps2)
        if float(np.sqrt(np.mean(more_mps2**2))) > MUCH_MPS2:
            self.ask_again()

    def cut(self, from_s: float, to_s: float) -> None:
        """From ``to_s`` on it is measured otherwise than before (another level, another tilt); between, as neither."""
        self._cuts = [cut for cut in self._cuts if cut[1] > to_s - self._length_s] + [(from_s, to_s)]

    @property
    def cuts_s(self) -> tuple[tuple[float, float], ...]:
        """Where the past is cut: no spectrum is taken across, and no bias."""
        return tuple(self._cuts)

    def spoil(self, from_s: float, to_s: float) -> None:
        """What is stored of this span has turned out not to be of the sea."""
        self._spoilt = [span for span in self._spoilt if span[1] > to_s - self._length_s] + [(from_s, to_s)]

    def strike(self, t_s: float) -> None:
        """Something has struck the hull since the last beat; that at ``t_s`` is in part of before."""
        self._blows = [blow for blow in self._blows if blow > t_s - self._length_s] + [t_s]

    @property
    def blows_s(self) -> tuple[float, ...]:
        """First beats after something struck the hull."""
        return tuple(self._blows)

    @property
    def spoilt_s(self) -> tuple[tuple[float, float], ...]:
        """Spans of which nothing is to be learned."""
        return tuple(self._spoilt)

    def since(self, t_s: float) -> Array:
        """(n, 2) time and acceleration of the beats from ``t_s`` on: a view, overwritten by later ones."""
        return self._beats.since(t_s)

    # --- fits --------------------------------------------------------------------------------------------------------

    def is_due(self, t_s: float, *, is_changing: bool) -> bool:
        """Whether it is time for another look at the past; sooner early on, and when the sea ``is_changing``."""
        if not t_s - self.started_s >= self._first_fit_s:
            return False
        was_asked, since_s = self._asked_s > self.started_s, t_s - self._asked_s
        if was_asked and since_s < self._early_s:
            return False
        is_early = t_s - self.started_s < EARLY_S or is_changing
        return not was_asked or is_early or since_s >= self._refresh_s

    def ask(self, t_s: float) -> tuple[int, Array]:
        """The past (n, 2) that the longest window sees, for a fit, and the number that its answer carries."""
        self._asked_s = t_s
        self._number += 1
        self._awaited = self._number
        return self._number, self._beats.since(t_s - self._length_s)

    def ask_again(self) -> None:
        """The answer could not be used: the next look is due AGAIN_S from now."""
        self._asked_s -= max(self._refresh_s - AGAIN_S, 0.0)

    def answered(self, number: int) -> bool:
        """Whether an answer of this number is the one that is awaited, which then is no more."""
        if number != self._awaited:
            return False
        self._awaited = -1
        return True
