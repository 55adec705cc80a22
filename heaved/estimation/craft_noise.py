"""What shakes the readings of a craft's heave and pitch above the waves: learned from them, and taken out of them.

The bank of filters takes a reading for motion and white noise. A sensor's foot that vibrates adds a line, or a hum, that
neither explains: the filters then follow it, and publish a deviation that knows nothing of it. So a reading is split
first, by the conditional mean of a Gaussian process (Rasmussen & Williams 2006, eq. 2.23-2.24), with the readings of the
last seconds: slow motion of a smooth covariance wider than any craft's, white noise, and what vibrates, of the
covariance that the record shows above the waves. What vibrates is taken out, and what is not known of it counts as
noise, beside the white noise that the record shows. Nothing is inferred about the band of the waves. While nothing
stands out above the waves and the noise is as configured, readings and noise remain what they are.
"""

from __future__ import annotations

from math import inf, isfinite, nan, pi
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotrs

from heaved.estimation.ring import Ring

Array = NDArray[np.float64]

WINDOW_S: Final = 2.0
"""Readings that one is split with ..."""
WINDOW: Final = (12, 200)
"""... but no fewer and no more than these."""
RECORD_S: Final = 26.0
"""Record that is learned from ..."""
LEARN_EVERY_S: Final = 5.0
"""... again and again."""
FIRST_S: Final = 8.0
"""Record from which on there is something to learn."""
SEGMENT_S: Final = 5.0
"""Of one periodogram; they overlap by half."""
WAVES_END_HZ: Final = 2.0
"""A craft does not follow waves above: at 18 m/s they are met at this frequency when they are 12 m long."""
MOTION_HZ: Final = 0.5
"""The slow motion's spectrum falls as a Gaussian of this width: by 35 dB at 2 Hz, by 78 dB at 3 Hz."""
MOTION_STD: Final = (2.0, 0.2)
"""Of heave (m) and pitch (rad), above any craft's."""
STANDS_OUT: Final = 4.0
"""Spectrum over its median above the waves from which on it is vibration: the mean of nine periodograms is that once in
a million times by chance."""
NOISIER: Final = 1.5
"""Variance over the configured one from which on the learned one is used."""
COHERENT_S: Final = 2.0
"""Standard deviation of the time over which a line keeps its phase."""
GATE_STD: Final = 6.0
"""A reading further than this from what those before it expect is not learned from."""
LEAST_SHARE: Final = 0.5
"""Of readings that must be there to learn, and to split one."""
LOST_S: Final = 1.0
"""Without a reading for so long, what vibrates is no longer known."""
SPIKE_STD: Final = 8.0
"""A reading further than this from the middle of its neighbours, in the usual distances, is not learned from either."""
MEDIAN_OF_SQUARE: Final = 0.4549
"""Of a standard normal value."""
STEP_MEMORY: Final = 0.02
"""Weight of an interval in the mean one."""


class _Learned(msgspec.Struct, frozen=True, eq=False, gc=False):
    """Of one channel."""

    white: float
    """Variance of the white noise of a reading."""
    power: float
    """Variance of what vibrates; 0: nothing does."""
    out: Array
    """(n,) weights of the newest n readings in what vibrates at the newest."""
    left: float
    """Variance of what these do not tell."""
    ahead: Array
    """(n,) weights of n readings in the next one, and in what vibrates then (2, n)."""
    ahead_std: float
    """Of the next one."""
    ahead_left: float
    """Variance of what vibrates then, not knowing the reading."""


class CraftNoise:
    """Takes heave and pitch together, in order of time."""

    def __init__(self, variances: tuple[float, float]) -> None:
        """``variances``: of heave (m2) and pitch (rad2) readings, as configured."""
        self._configured = variances
        self.forget()

    def forget(self) -> None:
        """All that was learned, and the record."""
        self._step_s = nan
        self._t_s = self._learned_s = -inf
        self._ring: Ring | None = None
        self._learned: list[_Learned | None] = [None, None]
        self._missing = [0, 0]

    def take(self, t_s: float, readings: tuple[float, float]) -> tuple[tuple[float, float], tuple[float, float]]:
        """Readings without what vibrates, and the variances of their noise; nan: missing, stays so."""
        since_s, self._t_s = t_s - self._t_s, t_s
        if not 0.0 < since_s < LOST_S:
            self.forget()
            self._t_s = t_s
            return readings, self._configured
        if self._ring is None or not 0.3 < since_s / self._step_s < 50.0:
            # The rate is that of the first interval, and another one when it changes.
            self._step_s = since_s
            self._ring = Ring(int(RECORD_S / since_s) + 1, 3)
            self._learned, self._learned_s = [None, None], t_s - LEARN_EVERY_S + FIRST_S
        steps = max(1, round(since_s / self._step_s))
        if steps == 1:
            self._step_s += STEP_MEMORY * (since_s - self._step_s)
        for k in range(1, steps):
            self._ring.push((t_s - since_s * (1.0 - k / steps), self._expected(0), self._expected(1)))
        split = [self._split(channel, readings[channel]) for channel in (0, 1)]
        self._ring.push((t_s, split[0][2], split[1][2]))
        if t_s - self._learned_s >= LEARN_EVERY_S:
            self._learned_s = t_s
            self._learn()
        return (split[0][0], split[1][0]), (split[0][1], split[1][1])

    def _expected(self, channel: int) -> float:
        """What is put in for a reading that is missing; nan: it is not known."""
        self._missing[channel] += 1
        learned, before = self._learned[channel], self._before(channel)
        if learned is None or before is None or self._missing[channel] * self._step_s > LOST_S:
            return nan
        return float(learned.ahead[0].dot(before))

    def _before(self, channel: int) -> Array | None:
        """(n,) the newest readings as far as they are split with; None: too many are not known."""
        assert self._ring is not None
        learned = self._learned[channel]
        if learned is None or len(self._ring) < len(learned.out):
            return None
        values = self._ring.last(len(learned.out))[:, 1 + channel]
        return values if isfinite(float(values.sum())) else _filled(values)

    def _split(self, channel: int, reading: float) -> tuple[float, float, float]:
        """A reading without what vibrates, the variance of its noise, and what is kept of it."""
        learned = self._learned[channel]
        if learned is None or learned.power == 0.0:
            variance = self._configured[channel] if learned is None else learned.white
            if isfinite(reading):
                self._missing[channel] = 0
                return reading, variance, reading
            return reading, variance, nan
        before = self._before(channel)
        if not isfinite(reading):
            return reading, learned.white + learned.power, self._expected(channel)
        if before is None:
            self._missing[channel] = 0
            return reading, learned.white + learned.power, reading
        expected, vibrates = learned.ahead.dot(before).tolist()
        if abs(reading - expected) > GATE_STD * learned.ahead_std:
            return reading - vibrates, learned.white + learned.ahead_left, self._expected(channel)
        self._missing[channel] = 0
        vibrates = float(learned.out[:-1].dot(before[1:])) + float(learned.out[-1]) * reading
        return reading - vibrates, learned.white + learned.left, reading

    # --- learning ----------------------------------------------------------------------------------------------------

    def _learn(self) -> None:
        assert self._ring is not None
        rows = self._ring.last(len(self._ring))
        for channel in (0, 1):
            values = _without_spikes(rows[:, 1 + channel])
            filled = _filled(values)
            share = float(np.mean(np.isfinite(values)))
            self._learned[channel] = self._from(channel, filled, share) if filled is not None else None

    def _from(self, channel: int, values: Array, share: float) -> _Learned | None:
        rate_hz = 1.0 / self._step_s
        n = int(SEGMENT_S * rate_hz)
        if len(values) < n or n < 8 or 0.5 * rate_hz <= 1.5 * WAVES_END_HZ:
            return None
        segments = np.lib.stride_tricks.sliding_window_view(values, n)[:: max(1, n // 2)]
        phase = 2.0 * pi * (np.arange(n) + 0.5) / n
        taper = 0.35875 - 0.48829 * np.cos(phase) + 0.14128 * np.cos(2.0 * phase) - 0.01168 * np.cos(3.0 * phase)
        centred = segments - segments.mean(axis=1, keepdims=True)
        spectra = np.abs(np.fft.rfft(centred * taper, axis=1)) ** 2 / (rate_hz * float(np.sum(taper**2)))
        power, f = spectra.mean(axis=0), np.fft.rfftfreq(n, self._step_s).astype(np.float64)
        above = f >= WAVES_END_HZ
        floor = float(np.median(power[above]))
        vibration = np.where(above & (power > STANDS_OUT * floor), power - floor, 0.0)
        # Readings put in between carry none of it.
        white = floor * rate_hz / share
        configured = self._configured[channel]
        white = white if white > NOISIER * configured else configured
        lines = np.full(len(f), 2.0)
        lines[0] = 1.0
        strength = lines * vibration * (rate_hz / n)
        total = float(strength.sum())
        count = int(np.clip(WINDOW_S * rate_hz, *WINDOW))
        if total == 0.0:
            nothing = np.zeros(count)
            return _Learned(white, 0.0, nothing, 0.0, np.zeros((2, count)), inf, 0.0)
        # Lag by lag, to one beyond the window: the next reading.
        lag_s = np.arange(count + 1) * self._step_s
        vibrates = np.cos(2.0 * pi * np.multiply.outer(lag_s, f)).dot(strength)
        vibrates *= np.exp(-0.5 * (lag_s / COHERENT_S) ** 2)
        moves = MOTION_STD[channel] ** 2 * np.exp(-0.5 * (2.0 * pi * MOTION_HZ * lag_s) ** 2)
        apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
        K = (vibrates + moves)[apart]
        K.flat[:: count + 1] += white
        factor, info = dpotrf(K, lower=1)
        if info != 0:
            return None
        newest, following = vibrates[:-1][::-1], (vibrates + moves)[1:][::-1]
        vibrates_next = vibrates[1:][::-1]
        out, ahead, ahead_vibrates = dpotrs(factor, np.stack([newest, following, vibrates_next], axis=1), lower=1)[0].T
        variance = total + MOTION_STD[channel] ** 2 + white - float(ahead.dot(following))
        return _Learned(
            white=white,
            power=total,
            out=np.ascontiguousarray(out),
            left=max(total - float(out.dot(newest)), 0.0),
            ahead=np.stack([ahead, ahead_vibrates]),
            ahead_std=max(variance, white) ** 0.5,
            ahead_left=max(total - float(ahead_vibrates.dot(vibrates_next)), 0.0),
        )


def _filled(values: Array) -> Array | None:
    """Values (n,) with straight lines where they are nan; None: most are."""
    known = np.isfinite(values)
    if np.count_nonzero(known) < LEAST_SHARE * len(values):
        return None
    at = np.arange(len(values), dtype=np.float64)
    return np.asarray(np.interp(at, at[known], values[known]))


def _without_spikes(values: Array) -> Array:
    """Values (n,), nan where one stands out from both its neighbours more than they do from theirs."""
    square = np.zeros(len(values))
    square[1:-1] = (values[1:-1] - 0.5 * (values[:-2] + values[2:])) ** 2
    usual = square[np.isfinite(square)]
    if not usual.size:
        return values
    far = square > SPIKE_STD**2 / MEDIAN_OF_SQUARE * float(np.median(usual))
    far[1:-1] &= ~(square[1:-1] < np.fmax(square[:-2], square[2:]))
    return np.where(far, nan, values)
