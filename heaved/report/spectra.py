"""Spectra of a series of any length: Welch's average, taken down as the samples come. Pure."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LENGTHS_S: Final = (32.0, 64.0, 128.0, 256.0)
"""Of the segments that are taken side by side: how long the recording is shows in the end."""
ENOUGH: Final = 8
"""Segments (with half overlap) that an average should have: a spectrum known to a third."""
LONGEST_STEP: Final = 3.5
"""Usual intervals. Samples further apart have a hole between them, and no segment reaches across."""


class Spectrum(msgspec.Struct, frozen=True, eq=False):
    """One-sided density at ``f_hz`` (k,), in the square of the series' unit per Hz."""

    f_hz: Array
    density: Array
    segments: int
    """That were averaged,"""
    segment_s: float
    """each so long."""

    @property
    def variance(self) -> float:
        """Of the series, all that is faster than one period in a segment."""
        return float(self.density[1:].sum() * (self.f_hz[1] - self.f_hz[0]))

    @property
    def independent_s(self) -> float:
        """Time T after which the square of the series is as good as independent of what it was: the mean of the square
        over a time D scatters as that of D / T independent values.

        For a normal process of autocorrelation r, T is the integral of r^2 over all lags (Bartlett), which by
        Parseval's theorem is half the integral of S^2 over the square of the integral of S.
        """
        step_hz = float(self.f_hz[1] - self.f_hz[0])
        power = self.density[1:]
        total = float(power.sum()) * step_hz
        return 0.5 * float(power @ power) * step_hz / total**2 if total > 0.0 else 0.0


class Welch:
    """Average of the periodograms of Hann segments with half overlap, each less its straight line (Welch 1967).

    Samples may come at uneven times: they are brought to an even grid by straight lines, which changes nothing where
    they lie on one.
    """

    def __init__(self, interval_s: float, segment_s: float) -> None:
        """``interval_s``: usual time between samples."""
        self._interval_s = interval_s
        self._n = max(2 * round(0.5 * segment_s / interval_s), 8)
        self._window = np.hanning(self._n + 1)[:-1]
        self._line = np.stack([np.ones(self._n), np.linspace(-1.0, 1.0, self._n)])
        self._power = np.zeros(self._n // 2 + 1)
        self._segments = 0
        self._t_s, self._x = np.empty(0), np.empty(0)
        self._begin_s = np.nan

    def push(self, t_s: Array, x: Array) -> None:
        """Samples (n,), later than those before; nan is a hole."""
        known = np.isfinite(x)
        t_s, x = np.concatenate((self._t_s, t_s[known])), np.concatenate((self._x, x[known]))
        cuts = np.flatnonzero(np.diff(t_s) > LONGEST_STEP * self._interval_s) + 1
        for begin, end in zip((0, *cuts), (*cuts, len(t_s)), strict=True):
            if begin > 0:
                self._begin_s = np.nan
            left = self._take(t_s[begin:end], x[begin:end])
            self._t_s, self._x = t_s[begin:end][left:], x[begin:end][left:]

    def _take(self, t_s: Array, x: Array) -> int:
        """All segments in a stretch; how much of it is not needed any more."""
        if len(t_s) == 0:
            return 0
        step_s, n = self._interval_s, self._n
        begin_s = self._begin_s if np.isfinite(self._begin_s) else float(t_s[0])
        while begin_s + (n - 1) * step_s <= t_s[-1] + 1e-6 * step_s:
            even = np.interp(begin_s + step_s * np.arange(n), t_s, x)
            even -= np.linalg.lstsq(self._line.T, even, rcond=None)[0] @ self._line
            self._power += np.abs(np.fft.rfft(even * self._window)) ** 2
            self._segments += 1
            begin_s += n // 2 * step_s
        self._begin_s = begin_s
        return max(int(np.searchsorted(t_s, begin_s)) - 2, 0)

    def spectrum(self) -> Spectrum | None:
        """The average so far; None: there has been no whole segment."""
        if self._segments == 0:
            return None
        n, step_s = self._n, self._interval_s
        density = self._power / self._segments * (2.0 * step_s / float(self._window @ self._window))
        density[0] /= 2.0
        density[-1] /= 2.0
        return Spectrum(np.asarray(np.fft.rfftfreq(n, step_s), dtype=np.float64), density, self._segments, n * step_s)


class Spectra:
    """Averages over segments of several lengths."""

    def __init__(self, interval_s: float) -> None:
        """``interval_s``: usual time between samples."""
        self._averages = [Welch(interval_s, length_s) for length_s in LENGTHS_S]

    def push(self, t_s: Array, x: Array) -> None:
        """Samples (n,), later than those before; nan is a hole."""
        for average in self._averages:
            average.push(t_s, x)

    def spectrum(self) -> Spectrum | None:
        """Of the longest segments of which there are enough, else of the shortest; None: there is none whole."""
        found = [one for average in self._averages if (one := average.spectrum()) is not None]
        return next((one for one in reversed(found) if one.segments >= ENOUGH), found[0] if found else None)
