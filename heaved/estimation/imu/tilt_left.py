"""How much of the vertical acceleration is tilt, where no attitude takes it out.

A tilt of the angle a shows g sin(a) across the mast and takes g (1 - cos(a)) off it, which is the square of the former
over 2 g: the variation of that is taken for waves.

* Where the specific force across is measured, that tells how large it is.
* Where nothing but the vertical is, its own spectrum tells, below the waves: half of the power of the square of a lean
  lies there, between zero and the width of the lean's spectrum, and nothing else of that size does.
* Before there is enough of that to see, the vessel is held to lean by the slope of the waves, as ships do that are not
  much longer than these: in deep water the surface has the slope of its vertical acceleration over g (Airy), so that
  what is seen along the mast stands for what would be across. That is no measurement.
"""

from __future__ import annotations

from collections import deque
from math import exp, inf, isfinite, nan, sqrt
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np

from heaved.samples import GRAVITY_MPS2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of :class:`TiltLeft`. Without a source: chosen, and held by the tests of a vessel without an attitude."""

    hold_s: float = 0.5
    """After a longer pause it begins anew."""
    memory_s: float = 60.0
    """Of what is measured across, and of what stands upright."""
    leans: float = 1.5
    """Ships lean by so much of the slope of the waves,"""
    short_s: float = 1.3
    """less in those that are shorter than they are: two low-passes of that time constant, 8 s,"""
    rolls: float = 5.0
    """and by so much more in a beam swell near their own period:"""
    long_s: float = 2.3
    """four low-passes of that one, 14 s."""
    band_hz: float = 0.1
    """Width of the spectrum of what leans, most: half of the power of its square is below that, falling in a straight
    line (the spectrum of the square of a Gaussian of a rectangular one), the other half about twice its frequency."""
    mean_s: float = 1.0
    """Means over so long are kept of the vertical acceleration,"""
    kept: int = 300
    """the last so many,"""
    enough: int = 60
    """and of so many something is said, each time that there are a few more:"""
    often: int = 5
    sure: int = 90
    """From so many on what is told counts as measured: in a shorter record long waves count as well."""
    below_hz: float = 0.022
    """what is below the longest swell is none of it: 25 s, and the width of the window."""
    fewest: float = 3.7
    """In a short record all up to that frequency is looked at, in its own resolution: there swell counts."""
    smooth_hz: float = 0.0125
    """A spectrum is the mean over so much to either side."""
    unsure: float = 1.0
    """Standard deviations of an estimate by which it is taken larger."""


TUNING: Final = Tuning()
TILT_HZ: Final = np.linspace(0.05, 0.95, 19) * TUNING.band_hz
"""Where it is said what noise that is,"""
TILT_SHAPE: Final = (1.0 - TILT_HZ / TUNING.band_hz) / TUNING.band_hz
"""and its density for a mean square of 1."""


class TiltLeft:
    """Feed it the specific force in order of time.

    Attributes:
        square: mean square of what the tilt makes of the vertical acceleration, (m/s2)2.
        is_measured: False: it is only what ships do in such waves.
    """

    def __init__(self) -> None:
        self.square = 0.0
        self.is_measured = False
        self._mean = 0.0
        self._upright = GRAVITY_MPS2
        """Mean of what is measured along the mast."""
        self._t_s = self._since_s = nan
        self._passed = _Passed()
        self._lean_square = 0.0
        self._below = _BelowTheWaves()

    @property
    def density(self) -> Array:
        """One-sided, at ``TILT_HZ``, (m/s2)2/Hz: no more than there is in all."""
        return np.minimum(self.square * TILT_SHAPE, self._below.density)

    def seconds(self, t_s: float) -> float:
        """For how long it has been seen without a pause."""
        return self._t_s - self._since_s if t_s - self._t_s <= TUNING.hold_s else 0.0

    def step(self, t_s: float, x_mps2: float, y_mps2: float, z_mps2: float) -> None:
        """Take a sample; nan: there is none."""
        elapsed_s = t_s - self._t_s
        across_square = x_mps2 * x_mps2 + y_mps2 * y_mps2
        is_across = isfinite(across_square)
        if not is_across:
            if not isfinite(z_mps2):
                return
            short, long = self._passed.step(elapsed_s, z_mps2 - self._upright)
            across_square = (TUNING.leans * abs(short) + TUNING.rolls * abs(long)) ** 2
        part = across_square / (2.0 * GRAVITY_MPS2)
        self._t_s = t_s
        if not elapsed_s <= TUNING.hold_s:
            self._since_s, self._mean, self._lean_square = t_s, part, 0.0
            self._upright = z_mps2 if isfinite(z_mps2) else GRAVITY_MPS2
            self._passed, self._below = _Passed(), _BelowTheWaves()
            return
        # At first the mean of what there is, later a fading one.
        share = elapsed_s / min(max(t_s - self._since_s, elapsed_s), TUNING.memory_s)
        if isfinite(z_mps2):
            self._upright += share * (z_mps2 - self._upright)
            self._below.step(t_s, z_mps2)
        off = part - self._mean
        self._mean += share * off
        self._lean_square += share * (off * off - self._lean_square)
        below = self._below.square
        self.is_measured = is_across or self._below.is_sure
        self.square = self._lean_square if is_across or not isfinite(below) else below


class _Passed:
    """Low-passes: two of the one time constant, four of the other."""

    def __init__(self) -> None:
        self._short, self._long = [0.0] * 2, [0.0] * 4

    def step(self, elapsed_s: float, value: float) -> tuple[float, float]:
        """What of ``value`` is in long waves, and what in very long ones."""
        return (
            _passed(self._short, elapsed_s / TUNING.short_s, value),
            _passed(self._long, elapsed_s / TUNING.long_s, value),
        )


def _passed(stages: list[float], part: float, value: float) -> float:
    """The output of low-passes one after the other, after that part of their time constant."""
    share = 1.0 - exp(-part) if part > 0.0 else 0.0
    for k, stage in enumerate(stages):
        stages[k] = value = stage + share * (value - stage)
    return value


class _BelowTheWaves:
    """The spectrum of the vertical acceleration at low frequencies, and what of it a lean may have made.

    Attributes:
        square: mean square of what the tilt makes of it, by what there is below the waves; nan: that does not show yet.
        density: of all that there is at ``TILT_HZ``; inf, likewise.
        is_sure: the record is long enough to tell the waves from it.
    """

    def __init__(self) -> None:
        self.square, self.is_sure = nan, False
        self.density: Array = np.full(len(TILT_HZ), inf)
        self._means: deque[float] = deque(maxlen=TUNING.kept)
        self._t_s = self._z = nan
        self._integral, self._until_s, self._new = 0.0, nan, 0
        """Of the straight lines between the samples, since the last mean: their times need not be even."""

    def step(self, t_s: float, z_mps2: float) -> None:
        before_s, before = self._t_s, self._z
        self._t_s, self._z = t_s, z_mps2
        if not t_s > before_s:
            self._until_s = t_s + TUNING.mean_s
            return
        while t_s >= self._until_s:
            at = before + (z_mps2 - before) * (self._until_s - before_s) / (t_s - before_s)
            self._take(self._integral + 0.5 * (before + at) * (self._until_s - before_s))
            before_s, before = self._until_s, at
            self._until_s += TUNING.mean_s
        self._integral += 0.5 * (before + z_mps2) * (t_s - before_s)

    def _take(self, integral: float) -> None:
        self._means.append(integral / TUNING.mean_s)
        self._integral, self._new = 0.0, self._new + 1
        if len(self._means) >= TUNING.enough and self._new >= TUNING.often:
            self._new = 0
            self.square, self.density = low_spectrum(np.array(self._means))
            self.is_sure = len(self._means) >= TUNING.sure


def low_spectrum(means: Array) -> tuple[float, Array]:
    """The mean square of what a lean has made of the vertical acceleration, and the density of all that there is at
    ``TILT_HZ``, each at most; from means (n,) over ``mean_s`` each, m/s2.
    """
    window = np.hanning(len(means))
    f = np.fft.rfftfreq(len(means), TUNING.mean_s)
    # Fitted through the window, waves that are cut at its ends do not make a straight line.
    line = np.polyfit(np.arange(len(means)), means, 1, w=window)
    off = (means - np.polyval(line, np.arange(len(means)))) * window
    power = np.abs(np.fft.rfft(off)) ** 2 * 2.0 * TUNING.mean_s / float(window @ window)
    below_hz = max(TUNING.below_hz, TUNING.fewest * f[1])
    below = (f > 1.5 * f[1]) & (f <= below_hz)
    square = _at_most(power[below]) * TUNING.band_hz / (1.0 - 0.5 * below_hz / TUNING.band_hz)
    # Of the lowest frequencies the straight line has been taken out: they show no less than the first that are whole.
    centres = np.maximum(TILT_HZ, 2.0 * f[1] + TUNING.smooth_hz)
    near = (power[(np.abs(f - at) <= TUNING.smooth_hz + 0.5 * f[1]) & (f > 1.5 * f[1])] for at in centres)
    return square, np.array([_at_most(part) for part in near])


def _at_most(power: Array) -> float:
    """The density of which these are neighbouring bins of a periodogram."""
    # Under that window neighbours tell the same by two thirds, in the mean square by four ninths.
    alike = 1.0 + 2.0 * (4.0 / 9.0) * (1.0 - 1.0 / len(power))
    return float(power.mean()) * (1.0 + TUNING.unsure * sqrt(alike / len(power)))
