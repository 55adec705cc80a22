"""How far the sea observer trusts itself: what its innovations and the delayed heave say, as a factor and in words."""

from __future__ import annotations

from math import inf, sqrt
from typing import Final

from heaved.estimation.heave.sea.smoother import Divergence
from heaved.samples import SeaState, vibration_in_words

CHANGED: Final = 3.0
"""Whiteness of the innovations above which the sea is changing: the next fit comes sooner."""
CHANGED_NOW: Final = 9.0
"""The same in the last seconds, which are fewer."""
STUBBORN: Final = 30.0
"""Whiteness at two fits in a row above which it is not the sea that changes, but what is measured that is no sea (tilt
that is not removed): fitting sooner helps nothing."""
STILL_LIKELIHOOD: Final = 15.0
"""Waves must make the record that much likelier than noise alone (ten parameters give a third of it by chance)."""
STILL_SHARE: Final = 0.5
"""Nor is it a sea when the error of the heave is that share of the heave itself."""
FACTOR_LIMIT: Final = 10.0
ENOUGH_WAVES: Final = 8.0
"""A spectrum of fewer of the longest waves is too coarse for its skirt, and the errors are as many times larger as the
square of what is lacking (cold starts in swell of 16 and 19 s: 4 and 10 times with fewer than three of them)."""
NEEDED_S: Final = 60.0
"""Seconds of record from which the observer counts as settled."""
DIVERGED: Final = 2.5
"""RMS difference from the delayed heave, over the modelled standard deviation, from which the output is in doubt; the
published standard deviation has grown with it by then."""
SMALL_M: Final = 0.01
"""Differences below this are well whatever the sea."""
KNOWN_YOUTH: Final = 1.8
"""Of a model that was fitted to six of the longest waves or more."""
LONGEST_PEAK_S: Final = 28.0
"""Longer waves than this are not told from the drift of the sensor."""


class SeaTrust:
    """Give it every fit and every beat; between beats nothing of it changes.

    Attributes:
        divergence: of real-time and delayed heave.
        surprise: variance of the averaged innovations over the model's, at the last fit or in the last seconds.
        factor: by which errors are larger than the model says; 1 when it is right.
        youth: the same for what the spectrum of few waves leaves open alone; inf before the first fit.
    """

    def __init__(self, delayed_beats: int) -> None:
        """``delayed_beats``: by which the delayed heave is late, at most."""
        self.divergence = Divergence(delayed_beats)
        self.surprise = self.factor = 1.0
        self._whiteness, self._waves, self._is_still = 1.0, inf, False
        self._is_stubborn = False
        self.youth = inf
        self._sea: SeaState | None = None
        self._shaken: tuple[str, ...] = ()
        self._is_recovering = False
        self._standing: tuple[str, ...] = ()

    def fitted(self, whiteness: float, waves: float, error_m: float, sea_std_m: float, waves_seen: float) -> None:
        """A fit: whiteness of its innovations, how much likelier it is than noise, error of its heave, that itself, and
        how many of the longest waves it was fitted to."""
        self.youth = max((ENOUGH_WAVES / max(waves_seen, 1.0)) ** 2, 1.0)
        self._is_stubborn = min(whiteness, self._whiteness) > STUBBORN
        self._whiteness, self._waves = whiteness, waves
        self._is_still = waves < STILL_LIKELIHOOD or error_m > STILL_SHARE * sea_std_m

    def beat(self, surprise: float, is_recovering: bool, sea: SeaState | None) -> None:
        """What the filter says after a beat."""
        self.surprise = max(self._whiteness, surprise)
        ratio = self.divergence.ratio
        shown = min(max(1.0, sqrt(0.5 * self.surprise), ratio), FACTOR_LIMIT)
        self.factor = max(shown, self.youth) if self.youth < inf else shown
        self._is_recovering = is_recovering
        if sea is not self._sea:
            self._sea = sea
            words = "" if sea is None else vibration_in_words(sea.vibration)
            self._shaken = (words,) if words else ()
        found = []
        if self._whiteness > CHANGED or self.surprise > CHANGED_NOW:
            found.append("the sea or the sensor is changing")
        if ratio > DIVERGED and self.divergence.rms_m > SMALL_M:
            found.append(f"{ratio:.1f} times its standard deviation off the delayed heave")
        if sea is not None and not sea.is_still and sea.peak_period_s > LONGEST_PEAK_S:
            found.append(f"swell of {sea.peak_period_s:.0f} s: longer than the sensor can follow")
        self._standing = tuple(found)

    @property
    def is_model_known(self) -> bool:
        """Whether the model is so good that what it does not explain is not of the sea."""
        return self.youth <= KNOWN_YOUTH and self._whiteness <= CHANGED_NOW

    @property
    def is_changing(self) -> bool:
        """Whether the sea is not any more what was fitted, and another fit would help."""
        return self.surprise > CHANGED and not self._is_stubborn

    @property
    def is_still(self) -> bool:
        """Whether the last fit saw no waves."""
        return self._is_still

    def doubts(self, settled_s: float) -> tuple[str, ...]:
        """What is held against the output, for people; ``settled_s``: seconds of record."""
        if self._is_recovering and settled_s > NEEDED_S:
            return ("recovering from a gap", *self._standing)
        return self._standing

    @property
    def notes(self) -> tuple[str, ...]:
        """What people should know, and no reason to trust the output less."""
        still = ("still: no motion above the noise of the sensor",) if self._is_still else ()
        return (*still, *self._shaken)
