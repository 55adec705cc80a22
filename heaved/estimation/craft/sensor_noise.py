"""What shakes the readings of a craft's heave and pitch above the waves: learned from them, and taken out of them.

The bank of filters takes a reading for motion and white noise. A sensor's foot that vibrates adds a line, or a hum,
that neither explains: the filters then follow it, and publish a deviation that knows nothing of it. So a reading is
split first, by the conditional mean of a Gaussian process (Rasmussen & Williams 2006, eq. 2.23-2.24), with the readings
of the last seconds: slow motion of a smooth covariance wider than any craft's, white noise, and what vibrates, of the
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

from heaved.estimation.common.ring import RingBuffer
from heaved.estimation.craft.tuning import TUNING

Array = NDArray[np.float64]

MEDIAN_OF_SQUARE: Final = 0.4549
"""Of a standard normal value."""


class _Conditional(msgspec.Struct, frozen=True, eq=False, gc=False):
    """What readings tell about the next one."""

    weights: Array
    """(2, n): in the reading, and in what vibrates in it."""
    variance: float
    """Of the reading."""
    gain: float
    """Of what vibrates, on what was not expected of the reading."""
    left: tuple[float, float]
    """Variance of what vibrates, without and with the reading."""


class _Learned(msgspec.Struct, frozen=True, eq=False, gc=False):
    """Of one channel. The covariances are by the number of steps between two readings."""

    white: float
    """Variance of the white noise of a reading."""
    vibrates: Array
    """Covariance of what vibrates; 0 when nothing does."""
    moves: Array
    """Covariance of the slow motion."""
    conditional: _Conditional | None
    """With no reading missing; None: nothing vibrates."""


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
        self._ring: RingBuffer | None = None
        self._learned: list[_Learned | None] = [None, None]

    def step(self, t_s: float, readings: tuple[float, float]) -> tuple[tuple[float, float], tuple[float, float]]:
        """Readings without what vibrates, and the variances of their noise; nan: missing, stays so."""
        since_s, self._t_s = t_s - self._t_s, t_s
        if not 0.0 < since_s < TUNING.lost_s:
            self.forget()
            self._t_s = t_s
            return readings, self._configured
        if self._ring is None or not 0.3 < since_s / self._step_s < 50.0:
            # The rate is that of the first interval, and another one when it changes.
            self._step_s = max(since_s, TUNING.shortest_step_s)
            self._ring = RingBuffer(int(TUNING.record_s / self._step_s) + 1, 3)
            self._learned, self._learned_s = [None, None], t_s - TUNING.learn_every_s + TUNING.first_s
        steps = max(1, round(since_s / self._step_s))
        if steps == 1:
            self._step_s += TUNING.step_weight * (since_s - self._step_s)
        before_s = t_s - since_s
        for k in range(1, steps):
            between_s = t_s - since_s * (1.0 - k / steps)
            if before_s < between_s < t_s:
                self._ring.push((between_s, nan, nan))
                before_s = between_s
        (heave, heave_variance, kept), (pitch, pitch_variance, kept_pitch) = (
            self._split(channel, readings[channel]) for channel in (0, 1)
        )
        self._ring.push((t_s, kept, kept_pitch))
        if t_s - self._learned_s >= TUNING.learn_every_s:
            self._learned_s = t_s
            self._learn()
        return (heave, pitch), (heave_variance, pitch_variance)

    def _split(self, channel: int, reading: float) -> tuple[float, float, float]:
        """A reading without what vibrates, the variance of its noise, and what is kept of it."""
        learned = self._learned[channel]
        if learned is None:
            return reading, self._configured[channel], reading
        if learned.conditional is None or not isfinite(reading):
            return reading, learned.white + float(learned.vibrates[0]), reading
        assert self._ring is not None
        before, conditional = self._ring.last(learned.conditional.weights.shape[1])[:, 1 + channel], learned.conditional
        if len(before) < conditional.weights.shape[1] or not isfinite(float(before.sum())):
            before = before[-TUNING.most_with_holes :]
            there = np.flatnonzero(np.isfinite(before))
            found = _conditional(learned.white, learned.vibrates, learned.moves, len(before) - there)
            before = before[there]
            if found is None:
                return reading, learned.white + float(learned.vibrates[0]), reading
            conditional = found
        expected, vibrates = conditional.weights.dot(before).tolist()
        surprise = reading - expected
        if surprise * surprise > TUNING.gate_std**2 * conditional.variance:
            return reading - vibrates, learned.white + conditional.left[0], nan
        return reading - vibrates - conditional.gain * surprise, learned.white + conditional.left[1], reading

    # --- learning ----------------------------------------------------------------------------------------------------

    def _learn(self) -> None:
        assert self._ring is not None
        rows = self._ring.last(len(self._ring))
        for channel in (0, 1):
            values = _without_spikes(rows[:, 1 + channel])
            share = float(np.mean(np.isfinite(values)))
            filled = _completed(values, self._learned[channel]) if share < 1.0 else values
            self._learned[channel] = self._from(channel, filled, share) if filled is not None else None

    def _from(self, channel: int, values: Array, share: float) -> _Learned | None:
        rate_hz = 1.0 / self._step_s
        n = int(TUNING.segment_s * rate_hz)
        if len(values) < n or n < 8 or 0.5 * rate_hz <= 1.5 * TUNING.waves_end_hz:
            return None
        segments = np.lib.stride_tricks.sliding_window_view(values, n)[:: max(1, n // 2)]
        taper = np.hanning(n)
        centred = segments - segments.mean(axis=1, keepdims=True)
        spectra = np.abs(np.fft.rfft(centred * taper, axis=1)) ** 2 / (rate_hz * float(np.sum(taper**2)))
        power, f = spectra.mean(axis=0), np.fft.rfftfreq(n, self._step_s).astype(np.float64)
        above = f >= TUNING.waves_end_hz
        floor = float(np.median(power[above]))
        vibration = np.where(above & (power > TUNING.stands_out / share**2 * floor), power - floor, 0.0)
        # Readings put in between carry none of it.
        white = floor * rate_hz / share
        configured = self._configured[channel]
        white = white if white > TUNING.noisier * configured else configured
        lines = np.full(len(f), 2.0)
        lines[0] = 1.0
        strength = lines * vibration * (rate_hz / n)
        total = float(strength.sum())
        count = int(np.clip(TUNING.window_s * rate_hz, *TUNING.window))
        if total < TUNING.least_power * white:
            return _Learned(white, np.zeros(1), np.zeros(1), None)
        lag_s = np.arange(max(count + 1, TUNING.most_completed)) * self._step_s
        vibrates = np.cos(2.0 * pi * np.multiply.outer(lag_s, f)).dot(strength)
        vibrates *= np.exp(-0.5 * (lag_s / TUNING.coherent_s) ** 2)
        moves = TUNING.motion_std[channel] ** 2 * np.exp(-0.5 * (2.0 * pi * TUNING.motion_hz * lag_s) ** 2)
        conditional = _conditional(white, vibrates, moves, np.arange(count, 0, -1))
        return _Learned(white, vibrates, moves, conditional) if conditional is not None else None


def _conditional(white: float, vibrates: Array, moves: Array, ago: NDArray[np.intp]) -> _Conditional | None:
    """From readings so many steps ago (n,). None: they are too few."""
    if len(ago) < TUNING.fewest:
        return None
    covariance = vibrates + moves
    K = covariance[np.abs(np.subtract.outer(ago, ago))]
    K.flat[:: len(ago) + 1] += white
    factor, info = dpotrf(K, lower=1)
    if info != 0:
        return None
    sides = np.stack([covariance[ago], vibrates[ago]], axis=1)
    weights = dpotrs(factor, sides, lower=1)[0].T
    known = weights @ sides
    variance = float(covariance[0] + white - known[0, 0])
    left = max(float(vibrates[0] - known[1, 1]), 0.0)
    gain = float(vibrates[0] - known[0, 1]) / variance
    return _Conditional(np.ascontiguousarray(weights), variance, gain, (left, max(left - gain**2 * variance, 0.0)))


def _filled(values: Array) -> Array | None:
    """Values (n,) with straight lines where they are nan; None: most are."""
    known = np.isfinite(values)
    if np.count_nonzero(known) < TUNING.least_share * len(values):
        return None
    at = np.arange(len(values), dtype=np.float64)
    return np.asarray(np.interp(at, at[known], values[known]))


def _completed(values: Array, learned: _Learned | None) -> Array | None:
    """Values (n,) with what is expected where they are nan, from both sides; None: most are nan."""
    filled = _filled(values)
    if filled is None or learned is None or learned.conditional is None or len(values) > TUNING.most_completed:
        return filled
    known = np.isfinite(values)
    there, here = np.flatnonzero(known), np.flatnonzero(~known)
    covariance = learned.vibrates + learned.moves
    K = covariance[np.abs(np.subtract.outer(there, there))]
    K.flat[:: len(there) + 1] += learned.white
    factor, info = dpotrf(K, lower=1)
    if info == 0:
        across = covariance[np.abs(np.subtract.outer(here, there))]
        filled[here] = across.dot(dpotrs(factor, values[there], lower=1)[0])
    return filled


def _without_spikes(values: Array) -> Array:
    """Values (n,), nan where one stands out from both its neighbours more than they do from theirs."""
    square = np.zeros(len(values))
    square[1:-1] = (values[1:-1] - 0.5 * (values[:-2] + values[2:])) ** 2
    usual = square[np.isfinite(square)]
    if not usual.size:
        return values
    far = square > TUNING.spike_std**2 / MEDIAN_OF_SQUARE * float(np.median(usual))
    far[1:-1] &= ~(square[1:-1] < np.fmax(square[:-2], square[2:]))
    return np.where(far, nan, values)
