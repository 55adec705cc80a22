"""A model of the sea that was not fitted to what comes now: from an earlier run, or from before a long gap.

The sea of an hour ago is often that of now, and then serves at once; when it is not, its standard deviations are those
of another sea. What can be told in seconds is whether the acceleration is as large as the model has it, and whether it
comes as the model foretells it from sample to sample. Long swell cannot be told in seconds: until the first fit of its
own the model is trusted less than one that was fitted.
"""

from __future__ import annotations

from math import isfinite, sqrt
from typing import Final

from heaved.estimation.heave.sea.model import SeaSystem

TOLD_S: Final = 10.0
"""Nothing is said before."""
SETTLES_S: Final = 2.0
"""Innovations of the first seconds are those of a filter that knows nothing."""
LARGEST: Final = 4.0
"""Mean square of acceleration or innovations, over that of the model, from which it is another sea. (In ten seconds of
waves of eight the first scatters by a factor of two.)"""
DOUBT: Final = 1.5
"""Published over modelled standard deviation where the model is fresh,"""
DOUBT_PER_HOUR: Final = 0.5
MOST_DOUBT: Final = 3.0
"""and where it is old, or of unknown age."""


class Trial:
    """Feed it every beat until the first fit.

    Attributes:
        is_told: whether anything may be said from the model.
        is_another: whether the sea has turned out to be another one.
        factor: by which errors are larger than the model says.
    """

    def __init__(self, system: SeaSystem, age_s: float) -> None:
        """``age_s``: of the model; nan: not known."""
        self._acceleration2 = float(system.H[:-1] @ system.stationary[:-1, :-1] @ system.H[:-1])
        self._acceleration2 += 2.0 * system.model.noise_psd
        self._doubt = min(DOUBT + DOUBT_PER_HOUR * age_s / 3600.0, MOST_DOUBT) if isfinite(age_s) else MOST_DOUBT
        self._began_s: float | None = None
        self._count = 0
        self._sum = self._square = self._innovation2 = 0.0
        self.is_told = self.is_another = False
        self.factor = self._doubt

    def take(self, t_s: float, a_mps2: float, scaled: float) -> None:
        """A beat: its acceleration, and its innovation over the deviation of that."""
        if self._began_s is None:
            self._began_s = t_s
        since_s = t_s - self._began_s
        if since_s < SETTLES_S:
            return
        self._count += 1
        self._sum += a_mps2
        self._square += a_mps2 * a_mps2
        self._innovation2 += scaled * scaled
        if since_s < TOLD_S:
            return
        n = self._count
        spread = (self._square / n - (self._sum / n) ** 2) / self._acceleration2
        surprise = self._innovation2 / n
        self.is_told = True
        self.is_another = max(spread, surprise) > LARGEST
        self.factor = self._doubt * sqrt(max(spread, surprise, 1.0))
