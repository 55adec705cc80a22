"""The slow motion that a shaking gyro measures, from readings of which some are missing and some are wrong.

A hull vibrates: engines, thrusters, slams turn the feet of both IMUs to and fro above the waves' frequencies, each in
its own way. Compared as they come, such rates are no motion of one rigid hull, and since the midships rate stands on
the other side of the equation, a line that both share passes for a rotation between them. So before they are compared,
both are reduced to what is slow, by the same rule: the conditional mean of a Gaussian process (Rasmussen & Williams
2006, eq. 2.23-2.24; in geostatistics, simple kriging). A reading is the slow motion, of a smooth covariance that no
vessel's waves exceed, plus what vibrates, of the covariance that the gyro's own record shows above the waves: white
noise, lines that wander, a broad hum alike. Nothing within the waves' band is inferred from it. The conditional mean
within a window of some seconds is at once

* the low-pass before the down-sampling, as sharp as the window and the vibration at hand allow,
* the bridge over readings that are missing: what vibrates is told apart from what moves whatever the pattern of holes,
  and the variance that the holes leave is known, reading by reading,
* the gate: each reading against what all others expect there (the same book, eq. 5.10-5.12).

The motion comes with its derivatives, as a polynomial in time: what a delay between both IMUs needs.
"""

from __future__ import annotations

from math import ceil, factorial, inf, pi
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotrs

from heaved.estimation.hull.tuning import TUNING

Array = NDArray[np.float64]

MEDIAN_OF_SQUARE: Final = 0.4549
"""Of a standard normal value."""
COLUMNS: Final = (slice(1, 4), slice(4, 7))
"""Rates of both triads in a row of a record ..."""
AFTER: Final = (7, 8)
"""... and by how much later than the row's own time they were taken."""


class SlowRate(msgspec.Struct, frozen=True, eq=False, gc=False):
    """The slow motion of one gyro triad about one moment."""

    motion: Array
    """(terms, 3): a polynomial in seconds, constant term first, rad/s."""
    variance: Array
    """(3,) of the constant term, by holes and vibration."""
    wrong: list[int]
    """Rows of the window whose reading is none of a gyro."""


class _Pattern(msgspec.Struct, frozen=True, eq=False, gc=False):
    """What depends on the times of the readings alone."""

    factor: Array
    """Cholesky factor of their covariance."""
    precision: Array
    """(n, 1): inverse of the variance of each, given all others, square root."""
    freedom: float
    """Mean square of the normalised readings when there is no motion: the share of them that the motion leaves over."""
    weights: Array
    """(terms, n)."""
    variance: float


class SlowMotion:
    """One gyro triad at ``rate_hz``.

    Attributes:
        power: spectrum of the vibration, two-sided, (rad/s)^2/Hz, from 0 to half of the rate.
    """

    def __init__(self, rate_hz: float, least_noise_radps: float) -> None:
        """``least_noise_radps``: standard deviation of the white noise of one reading that is assumed at the least."""
        self.rate_hz = rate_hz
        self.ahead = max(2, ceil(TUNING.ahead_s * rate_hz - 1e-6))
        self.back = max(2, ceil(TUNING.back_s * rate_hz - 1e-6))
        self._least = least_noise_radps**2 / rate_hz
        self._f = np.linspace(0.0, 0.5 * rate_hz, TUNING.spectrum_lines)
        self.set_vibration(np.full(TUNING.spectrum_lines, self._least))

    def copy(self) -> SlowMotion:
        """Another, with the same spectrum."""
        twin = SlowMotion(self.rate_hz, (self._least * self.rate_hz) ** 0.5)
        twin.set_vibration(self.power)
        twin._square = self._square.copy()
        return twin

    def set_vibration(self, power: Array) -> None:
        """Take a spectrum (lines,) for that of the vibration."""
        self.power = np.maximum(power, self._least)
        white = float(np.min(self.power)) * self.rate_hz
        self._motion = float(np.clip(TUNING.motion_over_white * white, *np.square(TUNING.motion_std_radps)))
        self._table = self._covariance(
            np.arange((self.back + self.ahead + 2) * TUNING.lags_per_step) / (TUNING.lags_per_step * self.rate_hz)
        )
        self._patterns: dict[bytes, _Pattern | None] = {}
        self._square = np.ones(3)
        """Size of the residuals: their mean square over what the spectrum makes of it, per axis."""

    def _covariance(self, lag_s: Array) -> Array:
        """Of the vibration."""
        lines = np.full(TUNING.spectrum_lines, 2.0)
        lines[[0, -1]] = 1.0
        step = 0.5 * self.rate_hz / (TUNING.spectrum_lines - 1)
        result: Array = np.cos(2.0 * pi * np.multiply.outer(lag_s, self._f)).dot(lines * self.power * step)
        result *= np.exp(-0.5 * (lag_s / TUNING.coherent_s) ** 2)
        return result

    def _smooth(self, lag_s: Array) -> Array:
        """Covariance of the slow motion."""
        return np.asarray(self._motion * np.exp(-0.5 * (2.0 * pi * TUNING.motion_hz * lag_s) ** 2))

    # --- one moment --------------------------------------------------------------------------------------------------

    def at(self, offset_s: Array, rates: Array) -> SlowRate | None:
        """The slow motion at the moment from which readings ``rates`` (n, 3), nan where missing, are ``offset_s`` away.

        None: too much is missing or wrong.
        """
        known = np.isfinite(rates[:, 0])
        if self._is_torn(offset_s, known):
            return None
        pattern = self._pattern(offset_s[known])
        if pattern is None:
            return None
        square = self._misfits(pattern, rates[known])[1]
        wrong = list[int]()
        if float((square / np.maximum(self._square, 1.0)).max()) > TUNING.reading_gate_std**2:
            wrong = self._wrong(offset_s, rates, known)
            known[wrong] = False
            pattern = self._pattern(offset_s[known])
            if pattern is None or self._is_torn(offset_s, known):
                return None
        values = rates[known]
        here = self._misfits(pattern, values)[0]
        self._square += TUNING.residual_weight * (here - self._square)
        # What has just begun shows in this window, and in the mean only later.
        variance = pattern.variance * np.maximum(self._square, here)
        return SlowRate(pattern.weights.dot(values), variance, wrong)

    def _is_torn(self, offset_s: Array, known: NDArray[np.bool_]) -> bool:
        """Is there a hole about the moment?"""
        near = np.abs(offset_s) < TUNING.ahead_s + 0.5 / self.rate_hz
        ends, inside = offset_s[near], offset_s[near & known]
        if len(inside) < 3:
            return True
        longest = max(float(np.max(np.diff(inside))), float(inside[0] - ends[0]), float(ends[-1] - inside[-1]))
        return longest > max(TUNING.longest_hole_s, 2.5 / self.rate_hz)

    def _misfits(self, pattern: _Pattern, values: Array) -> tuple[Array, Array]:
        """Of readings (n, 3): mean normalised square of all (3,), and of each from what the others expect (n, 3)."""
        solved = dpotrs(pattern.factor, values, lower=1)[0]
        residual = solved / pattern.precision
        return (values * solved).mean(axis=0) / pattern.freedom, residual * residual

    def _wrong(self, offset_s: Array, rates: Array, known: NDArray[np.bool_]) -> list[int]:
        """Rows that stand out from all others.

        Without the worst of them the misfit of the rest is less by just its own square. So rows are left out one after
        the other, and as long as one was many times as wrong as those that then remain, it and those before it are.
        """
        left, found, wrong = known.copy(), list[int](), 0
        for _ in range(int(TUNING.most_wrong * np.count_nonzero(known))):
            pattern = self._pattern(offset_s[left])
            if pattern is None:
                break
            mean, square = self._misfits(pattern, rates[left])
            count = len(square)
            rest = (count * mean - square / pattern.freedom) / (count - 1)
            rest = np.maximum(rest, np.maximum(self._square, 1.0))
            odd = (square / rest).max(axis=1)
            worst = int(odd.argmax())
            found.append(int(np.flatnonzero(left)[worst]))
            left[found[-1]] = False
            if odd[worst] > TUNING.reading_gate_std**2:
                wrong = len(found)
        return found[:wrong]

    def _pattern(self, offset_s: Array) -> _Pattern | None:
        """None: two readings are too close to be told apart."""
        ticks = np.round(offset_s * (1e4 * self.rate_hz)).astype(np.int64)
        key = ticks.tobytes()
        if key not in self._patterns:
            if len(self._patterns) >= TUNING.patterns_kept:
                self._patterns.clear()
            self._patterns[key] = self._new_pattern(ticks / (1e4 * self.rate_hz))
        return self._patterns[key]

    def _new_pattern(self, at_s: Array) -> _Pattern | None:
        lag = np.abs(np.subtract.outer(at_s, at_s))
        vibration = np.interp(lag * (TUNING.lags_per_step * self.rate_hz), np.arange(len(self._table)), self._table)
        factor, info = dpotrf(self._smooth(lag) + vibration, lower=1)
        if info != 0:
            return None
        # Derivatives of a Gaussian are Hermite polynomials times it: the powers of time about the moment.
        scale = 2.0 * pi * TUNING.motion_hz
        u = -scale * at_s
        hermite = [np.ones_like(u), u]
        for k in range(1, TUNING.motion_terms - 1):
            hermite.append(u * hermite[k] - k * hermite[k - 1])
        smooth = self._smooth(at_s)
        sides = [(-scale) ** k / factorial(k) * h * smooth for k, h in enumerate(hermite)]
        weights = dpotrs(factor, np.array(sides).T, lower=1)[0].T
        inverse = dpotrs(factor, np.eye(len(at_s)), lower=1)[0]
        return _Pattern(
            factor=factor,
            precision=np.sqrt(np.maximum(np.diag(inverse), 1e-300))[:, None],
            freedom=max(float(np.vdot(vibration, inverse)) / len(at_s), 0.1),
            weights=np.ascontiguousarray(weights),
            variance=max(self._motion - float(weights[0].dot(smooth)), 0.0),
        )

    # --- what vibrates -----------------------------------------------------------------------------------------------

    def assume_white(self, rates: Array) -> None:
        """Take a record (n, 3) of unknown vibration for slow motion and white noise: of its usual second difference."""
        bends = np.diff(rates, 2, axis=0)
        square = bends[np.isfinite(bends)] ** 2
        if len(square):
            self.set_vibration(
                np.full(TUNING.spectrum_lines, float(np.median(square)) / (6.0 * MEDIAN_OF_SQUARE * self.rate_hz))
            )

    def identify(self, t_s: Array, after_s: Array, rates: Array) -> Array | None:
        """Spectrum (lines,) of the vibration of a record, rates (n, 3), nan where missing; None: it is too short.

        t_s (n,) are places on the grid, after_s (n,) says how much later the readings were taken. What is missing, or
        was not taken on the grid, is first put in as the present spectrum expects it; what that leaves open is added
        as white.
        Hence identifying again with the spectrum that was found finds it better. Below the end of the waves only
        the white part is assumed.
        """
        place = np.round((t_s - t_s[0]) * self.rate_hz).astype(np.int64)
        series = np.full((int(place[-1]) + 1, 4), np.nan)
        series[place] = np.column_stack([rates, after_s])
        count = max(1, len(series) // TUNING.spectrum_segment)
        powers = [p for part in np.array_split(series, count) if (p := self._spectrum(part)) is not None]
        if not powers:
            return None
        power = np.mean(powers, axis=0)
        above = self._f >= min(TUNING.waves_end_hz, 0.25 * self.rate_hz)
        power[~above] = np.quantile(power[above], TUNING.white_quantile)
        return np.asarray(power)

    def _spectrum(self, part: Array) -> Array | None:
        """Of one piece (n, 4): rates on the grid, and by how much later they were taken."""
        series, after_s, known = part[:, :3], part[:, 3], np.isfinite(part[:, 0])
        n = len(series)
        if np.count_nonzero(known) < max(TUNING.spectrum_from, 0.3 * n):
            return None
        white = 0.0
        here = ~(known & (np.abs(after_s) < TUNING.on_grid / self.rate_hz))
        if here.any():
            grid_s = np.arange(n) / self.rate_hz
            there_s = (grid_s + after_s)[known]
            table = self._covariance(np.arange(TUNING.lags_per_step * (n + 1)) / (TUNING.lags_per_step * self.rate_hz))

            def covariance(a_s: Array, b_s: Array) -> Array:
                lag = np.abs(np.subtract.outer(a_s, b_s))
                vibration = np.interp(lag * (TUNING.lags_per_step * self.rate_hz), np.arange(len(table)), table)
                return np.asarray(self._smooth(lag) + vibration)

            factor, info = dpotrf(covariance(there_s, there_s), lower=1)
            if info != 0:
                return None
            across = covariance(there_s, grid_s[here])
            series = series.copy()
            series[here] = across.T.dot(dpotrs(factor, part[known, :3], lower=1)[0])
            left = self._motion + table[0] - np.sum(across * dpotrs(factor, across, lower=1)[0], axis=0)
            white = float(np.sum(np.minimum(np.maximum(left, 0.0), table[0]))) / n / self.rate_hz
        # Differences and a taper of low side lobes (Blackman & Harris): the waves are a million times as strong.
        bends = np.diff(series, 2, axis=0)
        phase = 2.0 * pi * (np.arange(n - 2) + 0.5) / (n - 2)
        taper = 0.35875 - 0.48829 * np.cos(phase) + 0.14128 * np.cos(2.0 * phase) - 0.01168 * np.cos(3.0 * phase)
        power = np.abs(np.fft.rfft(bends * taper[:, None], axis=0)) ** 2 / (self.rate_hz * np.sum(taper**2))
        f = np.fft.rfftfreq(n - 2, 1.0 / self.rate_hz)
        mean = np.mean(power, axis=1) / np.maximum(2.0 * np.sin(pi * f / self.rate_hz), 1e-3) ** 4
        return np.asarray(np.interp(self._f, f, mean) + white)


SlowReading = tuple[float, SlowRate | None, SlowRate | None]
"""Time, and the slow motion midships and local."""


class SlowPair:
    """Both gyro triads of a hull; rows (n, 9) are t, midships rates, local rates, how much later each was taken."""

    def __init__(self, midships: SlowMotion, local: SlowMotion) -> None:
        self.midships, self.local = midships, local
        self.back, self.ahead = midships.back, midships.ahead
        self.out_hz = midships.rate_hz / max(1, round(midships.rate_hz / TUNING.slow_hz))

    def copy(self) -> SlowPair:
        """Another, with the same spectra."""
        return SlowPair(self.midships.copy(), self.local.copy())

    def is_due(self, before_s: float, t_s: float) -> bool:
        """Is a slow reading made of the row at ``t_s``, that before it at ``before_s``?"""
        return (t_s * self.out_hz + 1e-6) // 1.0 > (before_s * self.out_hz + 1e-6) // 1.0

    def at(self, rows: Array, ahead: int) -> SlowReading:
        """Time and both slow motions ``ahead`` rows before the last one."""
        t = float(rows[-1 - ahead, 0])
        midships, local = (
            motion.at(rows[:, 0] + rows[:, after] - t, rows[:, columns])
            for motion, columns, after in zip((self.midships, self.local), COLUMNS, AFTER, strict=True)
        )
        return t, midships, local

    def through(self, rows: Array, after_s: float = -inf, to_end: bool = False) -> list[SlowReading]:
        """What is slow in a record wherever it is due, later than ``after_s``. Readings that are none are struck out.

        ``to_end``: with ever shorter windows to its end, not just as far as whole ones fit into it.
        """
        found = list[SlowReading]()
        for i in range(TUNING.shortest_window, len(rows) - (TUNING.shortest_window if to_end else self.ahead)):
            if rows[i, 0] > after_s and self.is_due(float(rows[i - 1, 0]), float(rows[i, 0])):
                window = rows[max(0, i - self.back) : i + self.ahead + 1]
                reading = self.at(window, min(self.ahead, len(rows) - 1 - i))
                for slow, columns in zip(reading[1:], COLUMNS, strict=True):
                    if slow is not None and slow.wrong:
                        window[slow.wrong, columns] = np.nan
                found.append(reading)
        return found

    def identify(self, rows: Array, rounds: int = 1) -> None:
        """Learn what vibrates from a record; ``rounds``: so often where readings are missing or off the grid."""
        for band, columns, after in zip((self.midships, self.local), COLUMNS, AFTER, strict=True):
            rates, after_s = rows[:, columns], rows[:, after]
            is_even = not np.isnan(rates).any() and float(np.abs(after_s).max()) * band.rate_hz < TUNING.on_grid
            for number in range(1 if is_even else rounds):
                power = band.identify(rows[:, 0], after_s, rates)
                if power is None:
                    break
                if 0 < number < rounds - 1:
                    # What falls from round to round would go on falling for many more.
                    power = power * np.clip((power / band.power) ** 2, 0.1, 1.0)
                band.set_vibration(power)

    def learn(self, rows: Array, to_end: bool) -> list[SlowReading]:
        """Go ``through`` a record of which nothing is known yet."""
        for band, columns in zip((self.midships, self.local), COLUMNS, strict=True):
            band.assume_white(rows[:, columns])
        self.through(rows, to_end=to_end)
        self.identify(rows, TUNING.rounds)
        return self.through(rows, to_end=to_end)
