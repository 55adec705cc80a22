"""The direct predictor at a pace: fed some 20 times a second whatever the rate of the samples, predicting from each.

A regression on lags costs the same for every sample, and of a motion of seconds 20 samples a second tell all but the
sensor's noise. So blocks of samples become one: their mean, taken about the curve that was predicted for them, so that
missing samples, jitter and spikes leave no trace, and valid at the middle of the block. Predictions of the samples in
between are moved along the curve over the horizons and corrected by what came since (:mod:`.rock_carry`). Errors,
deviations and intervals are those of what is published, against the single samples.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import ceil, inf, isfinite, nan
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from heaved.estimation.rock_carry import CORRECTED_S, Carry
from heaved.estimation.rock_direct import BACKWARDS, DirectPredictor, Params
from heaved.estimation.rock_experts import Switch

Array = NDArray[np.float64]

PACE_HZ: Final = 20.0
SPARE: Final = 0.05
"""A rate of 99.9 Hz is one of 100 Hz."""
FIRST: Final = 11
"""Stamps before the interval is known."""
PHASE_GAIN, INTERVAL_GAIN = 0.1, 0.0025
"""Of the loop that follows phase and interval of the blocks: critically damped."""
DRIFT: Final = 1e-3
"""Relative change of the interval after which the places on the curve are worked out anew."""
CHANGED: Final = 0.2
"""Relative change of the usual interval that asks for other blocks."""
FINE_S: Final = 0.25
"""Up to here the curve has a node for each block: what is published soon lies between them at any phase."""
BATCH_S: Final = 1.0
SCORED: Final = 2
"""Every second block is scored, one phase after the other: errors closer together are hardly different ones."""


class PacedPredictor:
    """Predicts n channels at once; arrays are (H, n), in the unit of the channels, as those of DirectPredictor."""

    def __init__(self, channels: int, params: Params | None = None, *, rates: bool = False) -> None:
        """``rates``: the first derivative of every channel is given with each sample."""
        self._params = params if params is not None else Params()
        self._n, self._rates = channels, rates
        self.horizons_s = tuple(sorted(set(self._params.horizons_s)))
        self._unknown = np.full((len(self.horizons_s), channels), nan)
        self._restarts = 0
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.t_s = -inf
        """Of the last sample."""
        self._backwards = 0
        self._pending: list[tuple[float, list[float], Sequence[float] | None]] = []
        self._recent: deque[float] = deque(maxlen=4 * FIRST)
        self._until_check = 4 * FIRST
        self._samples = 0
        self.values = self._unknown
        self.fed: DirectPredictor | None = None
        """What predicts; None until the rate is known."""
        self._switch: Switch | None = None
        self._gated = 0

    # -- what is known of the errors -------------------------------------------------------------------------------

    @property
    def std(self) -> Array:
        """Standard deviation of the prediction errors."""
        source = self._switch or self.fed
        return source.std if source is not None else self._unknown

    @property
    def half_width(self) -> Array:
        """Half-width of the 95 % interval."""
        source = self._switch or self.fed
        return source.half_width if source is not None else self._unknown

    @property
    def rms_error(self) -> Array:
        """Rolling RMS of what was published against what was measured then."""
        source = self._switch or self.fed
        return source.rms_error if source is not None else self._unknown

    @property
    def coverage(self) -> Array:
        """Rolling share of measured values inside the published interval."""
        source = self._switch or self.fed
        return source.coverage if source is not None else self._unknown

    @property
    def restarts(self) -> int:
        """Times that the stream was begun anew."""
        return self._restarts + (self.fed.restarts if self.fed is not None else 0)

    @property
    def spikes(self) -> int:
        """Samples held back for good since the stream was begun."""
        return self._gated + (self.fed.spikes if self.fed is not None else 0)

    @property
    def level_steps(self) -> int:
        """Steps of the level since the stream was begun."""
        return self.fed.level_steps if self.fed is not None else 0

    # -- one sample ------------------------------------------------------------------------------------------------

    def step(self, t_s: float, values: list[float], rates: Sequence[float] | None = None) -> Array:
        """Take one sample of all channels (nan: not known) and predict from it.

        A sample that is not later than the last one is ignored; twenty of them in a row begin everything anew.
        """
        if not t_s > self.t_s:
            self._backwards += t_s == t_s
            if self._backwards >= BACKWARDS:
                self._restart()
            return self.values
        self._backwards = 0
        if self.t_s > -inf:
            self._recent.append(t_s - self.t_s)
        self.t_s = t_s
        fed = self.fed
        if fed is None:
            self._pending.append((t_s, values, rates))
            if len(self._pending) >= FIRST:
                self._begin()
            return self.values
        self._until_check -= 1
        if self._until_check <= 0 and self._rate_changed():
            self._restart()
            return self.values
        if not all(map(isfinite, values)):
            values = [value if isfinite(value) else nan for value in values]
        if self._samples == 1:
            self.values = fed.step(t_s, values, rates)
        else:
            self._take(t_s, values, rates)
        return self.values

    def at(self, t_s: float) -> Array:
        """Predictions as seen from a moment without a sample, a little after the last one."""
        if self.fed is None or not 0.0 <= t_s - self.t_s <= self._params.max_gap_s:
            return self._unknown
        curve = self.fed.curve
        if not np.isfinite(curve).any():
            return self._unknown
        origin_s = self._origin_s if self._samples > 1 else self.t_s
        nodes = np.append(0.0, self.fed.horizons_s)
        at_s = np.minimum(t_s - origin_s + np.array(self.horizons_s), nodes[-1])
        seen: Array = np.where(np.isfinite(curve).all(axis=0), CubicSpline(nodes, np.nan_to_num(curve))(at_s), nan)
        if self._samples > 1:
            seen[: self._short] += self._added
        return seen

    def _rate_changed(self) -> bool:
        self._until_check = len(self._recent)
        usual_s = float(np.median(self._recent))
        return abs(usual_s - self._interval_s) > CHANGED * self._interval_s

    def _restart(self) -> None:
        self._restarts = self.restarts + 1
        self.reset()

    def _begin(self) -> None:
        """The rate is known: build, and take what has waited."""
        interval_s = float(np.median(self._recent))
        stamps = np.array([t for t, _, _ in self._pending])
        whole = np.maximum(np.rint(np.diff(stamps) / interval_s), 1.0)
        self._interval_s = float(stamps[-1] - stamps[0]) / float(whole.sum())
        self._samples = max(1, int(1.0 / (PACE_HZ * self._interval_s) + SPARE))
        params = self._params
        if self._samples > 1:
            self._build()
            params = msgspec.structs.replace(params, horizons_s=self._nodes_s)
        fed = self.fed = DirectPredictor(self._n, params, rates=self._rates)
        for t, values, rates in self._pending:
            if self._samples == 1:
                self.values = fed.step(t, values, rates)
            else:
                self._take(t, values, rates)
        self._pending = []

    # -- blocks ----------------------------------------------------------------------------------------------------

    def _build(self) -> None:
        samples, interval_s, n = self._samples, self._interval_s, self._n
        block_s = self._block_s = samples * interval_s
        lag_s = self._lag_s = 0.5 * (samples - 1) * interval_s
        horizons = np.array(self.horizons_s)
        late_s = lag_s + block_s - interval_s
        fine = ceil((min(FINE_S, float(horizons[-1])) + late_s) / block_s - 1e-6)
        nodes = {i for i in range(1, fine + 1) if i * block_s <= FINE_S + 1e-6 or i == 1}
        for h in self.horizons_s:
            if h + late_s > FINE_S:  # near the middle of where it moves, or on both sides where little is lost
                first, last = (h + lag_s) / block_s, (h + late_s) / block_s
                nodes |= {int(first + 1e-6), ceil(last)} if h <= CORRECTED_S else {round(0.5 * (first + last))}
        self._nodes_s = tuple(float(i * block_s) for i in sorted(nodes))
        self._aim()
        self._short = short = int(np.count_nonzero(horizons <= CORRECTED_S))
        self._carry = Carry(samples - 1, short, n, block_s)
        self._switch = Switch(horizons, 1, n, np.zeros(len(horizons), dtype=np.intp))
        self._per_batch = max(SCORED, SCORED * round(BATCH_S / block_s / SCORED))
        # In blocks, even ones: those that are scored.
        self._delay = SCORED * np.ceil((samples + self._ahead + 1.0) / samples / SCORED).astype(np.intp)
        self._kept = self._per_batch + int(self._delay[-1]) + SCORED + 1
        self._measured = np.full((2 * self._kept, samples, n), nan)
        self._shown = np.full((2 * self._kept, len(horizons), n), nan)
        self._shown_half = np.full((2 * self._kept, len(horizons), n), nan)
        self._planned = np.full((2 * self._kept, samples + 1, len(horizons) + 1, n), nan)
        self._innovations = np.full((2 * self._kept, samples - 1, n), nan)
        self._row = self._kept
        self._since_batch = 0
        self._blocks = 0
        self._shown_phase = -1
        self._e = np.zeros((n, samples - 1, 1))
        self._none_added = np.zeros((short, n))
        self._gates: list[list[float]] = self._carry.gate.tolist()
        self._end_s = self._origin_s = -inf
        self._nothing = [nan] * n
        self._expected = [self._nothing] * (samples + 1)
        self._middle_now = self._nothing
        self._rates_in: list[Sequence[float]] = []
        self._empty()

    def _aim(self) -> None:
        """What follows from the interval, which the first stamps tell within some percent only."""
        self._aimed_s = interval_s = self._interval_s
        self._lag_s = 0.5 * (self._samples - 1) * interval_s
        horizons = np.array(self.horizons_s)
        # Curve for each sample of a block (0: when it is fed) now and at each horizon; then for its middle.
        times = (self._lag_s + interval_s * np.arange(self._samples + 1))[:, None] + np.append(0.0, horizons)
        nodes = np.append(0.0, self._nodes_s)
        spline = CubicSpline(nodes, np.eye(len(nodes)), axis=0)
        self._weights = spline(np.minimum(times, nodes[-1])).reshape(-1, len(nodes))
        self._middle = spline(min(self._samples * interval_s, nodes[-1]))
        self._ahead = horizons / interval_s

    def _take(self, t_s: float, values: list[float], rates: Sequence[float] | None) -> None:
        if self._end_s == -inf:
            self._end_s = t_s - self._interval_s
            self._origin_s = self._end_s - self._lag_s
        phase = round((t_s - self._end_s) / self._interval_s)
        if phase > self._samples:
            phase = self._catch_up(t_s)
        if phase < 1:
            return
        plan = self._planned[self._row, phase]
        expected = self._expected[phase]
        off = (t_s - self._end_s) / self._interval_s - phase
        if abs(off) > 0.02:
            plan = plan + off * (plan - self._planned[self._row, phase - 1])
            expected = plan[0].tolist()
        innovation = [value - curve for value, curve in zip(values, expected, strict=True)]
        self._values_in[phase - 1] = values
        self._e_in[phase - 1] = innovation
        if rates is not None:
            self._rates_in.append(rates)
        if phase == self._samples:
            self._end_s += self._block_s
            deviation_s = t_s - self._end_s
            self._end_s += PHASE_GAIN * deviation_s
            self._block_s += INTERVAL_GAIN * deviation_s
            self._interval_s = self._block_s / self._samples
            self._feed()
            self._publish(0, self._planned[self._row, 0])
            return
        gate = self._gates[phase - 1]
        self._e[:, phase - 1, 0] = [
            e if -limit <= e <= limit else 0.0 for e, limit in zip(innovation, gate, strict=True)
        ]
        self._added = (self._carry.gains[phase - 1] @ self._e)[:, :, 0].T
        self._publish(phase, plan)

    def _publish(self, phase: int, plan: Array) -> None:
        values = plan[1:].copy()
        if phase:
            values[: self._short] += self._added
        self.values = values
        if phase == self._shown_phase:
            self._shown[self._row] = values
            self._shown_half[self._row] = self.half_width

    def _catch_up(self, t_s: float) -> int:
        """Samples are missing at the end of a block: it is closed with what it has; the next ones have nothing."""
        if t_s - self._end_s > self._params.max_gap_s + self._block_s:
            blocks = int((t_s - self._end_s) / self._block_s)
            self._end_s += blocks * self._block_s
            self._origin_s = self._end_s - self._lag_s
            for ring in (self._measured, self._shown, self._planned, self._innovations):
                ring[:] = nan
            self._expected = [self._nothing] * (self._samples + 1)
            self._middle_now = self._nothing
            self.values = self._unknown
            self._empty()
        while round((t_s - self._end_s) / self._interval_s) > self._samples:
            self._end_s += self._block_s
            self._feed()
        return round((t_s - self._end_s) / self._interval_s)

    def _feed(self) -> None:
        """Close a block that ends at ``_end_s``: feed its mean, begin the next."""
        fed, row = self.fed, self._row
        if fed is None:
            return
        self._measured[row] = self._values_in
        self._innovations[row] = self._e_in[:-1]
        mean = [self._mean(c) for c in range(self._n)]
        rates = np.array(self._rates_in).mean(axis=0).tolist() if self._rates_in else None
        self._origin_s = self._end_s - self._lag_s
        fed.step(self._origin_s, mean, rates)
        if self._since_batch >= self._per_batch:
            self._batch()
        self._blocks += 1
        self._since_batch += 1
        self._row += 1
        if self._row == len(self._measured):
            for ring in (self._measured, self._shown, self._shown_half, self._planned, self._innovations):
                ring[: self._kept] = ring[self._row - self._kept :]
            self._row = self._kept
        self._shown[self._row] = nan
        self._shown_phase = self._blocks // SCORED % self._samples if self._blocks % SCORED == 0 else -1
        curve = fed.curve
        planned = self._planned[self._row]
        np.matmul(self._weights, curve, out=planned.reshape(-1, self._n))
        self._expected = planned[:, 0].tolist()
        self._middle_now = (self._middle @ curve).tolist()
        self._empty()

    def _empty(self) -> None:
        """A block without samples."""
        self._values_in = [self._nothing] * self._samples
        self._e_in = [self._nothing] * self._samples
        self._rates_in.clear()
        self._e[:] = 0.0
        self._added = self._none_added

    def _mean(self, channel: int) -> float:
        """Of a block, for its middle: about the curve, where there is one, and without what is far from it."""
        known = [e[channel] for e in self._e_in if isfinite(e[channel])]
        if not known:
            plain = [v[channel] for v in self._values_in if isfinite(v[channel])]
            return sum(plain) / len(plain) if plain else nan
        limit = self._gates[-1][channel]
        near = [e for e in known if -limit <= e <= limit]
        if len(near) < len(known) < 2 * len(near):
            self._gated += len(known) - len(near)
            known = near
            for phase, e in enumerate(self._e_in):  # What is no measurement teaches nothing and judges nobody.
                if not -limit <= e[channel] <= limit:
                    self._measured[self._row, phase, channel] = nan
                    if phase < self._samples - 1:
                        self._innovations[self._row, phase, channel] = nan
        return self._middle_now[channel] + sum(known) / len(known)

    def _batch(self) -> None:
        """Once a second: learn from what came true of the blocks whose targets are known, and score it."""
        self._since_batch = 0
        if abs(self._interval_s - self._aimed_s) > DRIFT * self._interval_s:
            self._aim()
        samples, short = self._samples, self._short
        flat = self._measured.reshape(-1, self._n)
        if short:
            rows = self._row - int(self._delay[short - 1]) - np.arange(self._per_batch)
            ahead = np.arange(1, samples)[:, None] + self._ahead[:short]
            # Row b holds the samples 1 ... n after its block was begun.
            later = _between(flat, samples * rows[:, None, None] + ahead - 1.0)
            self._carry.learn(self._innovations[rows], later - self._planned[rows, 1:-1, 1 : short + 1])
            self._gates = self._carry.gate.tolist()
        if self._switch is None:
            return
        back = self._blocks % SCORED + self._delay + SCORED * np.arange(self._per_batch // SCORED)[:, None]
        rows = self._row - back
        phase = (self._blocks - back) // SCORED % samples
        h = np.arange(len(self._delay))
        error = _between(flat, samples * rows + phase + self._ahead - 1.0) - self._shown[rows, h]
        self._switch.score(SCORED * self._block_s, error[:, :, None], error, self._shown_half[rows, h])
        self._switch.choose(np.ones((1, self._n), dtype=bool))


def _between(samples: Array, place: Array) -> Array:
    """Linear interpolation of ``samples`` (m, n) at fractional places; (..., n)."""
    whole = np.rint(place)
    place = np.where(np.abs(place - whole) < 0.02, whole, place)
    low = np.floor(place).astype(np.intp)
    share = (place - low)[..., None]
    here: Array = samples[low]
    if share.any():
        there = samples[np.minimum(low + 1, len(samples) - 1)]
        here = np.where(share > 0.0, here + share * (there - here), here)
    return here
