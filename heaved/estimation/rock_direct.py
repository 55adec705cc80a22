"""Rock prediction at the bound: direct regression of each horizon on geometrically spaced lags.

One linear regression per horizon, of the motion h later on means of the past over blocks that grow with their age
(:mod:`heaved.estimation.rock_lags`), learned with exponential forgetting. It is the finite-past Wiener predictor with
some 34 taps instead of 800, found from the record itself: no model of the ship is needed, and no recursion of one-step
predictions that would let its errors grow.

* What is fitted is the residual to a fading-memory extrapolation up to 0.5 s, to the latest block beyond.
* All features are differences to the latest block, and the slow mean is one of them. So every prediction moves with the
  level: a list, a change of draught or heading shifts nothing but the mean.
* Experts run side by side: regressions on 2, 10 and 40 s of lags (each learns once its own lags are filled), the
  extrapolation, hold and the mean. Per horizon the one with the least realised error is published.
* Work is in samples on an even grid (:mod:`heaved.estimation.rock_clock`); equations are taken every 0.2 s,
  and every few seconds they are summed and, some sets in turn, solved (:mod:`heaved.estimation.rock_learning`).

Missing samples are filled with the prediction; what else may be wrong with them is dealt with in
:mod:`heaved.estimation.rock_gate`. While the motion leaves its own range nothing is learned.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, inf, isfinite, nan
from typing import Annotated, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.rock_clock import SampleClock
from heaved.estimation.rock_experts import Switch
from heaved.estimation.rock_gate import JUDGED_S, Channel, Timing
from heaved.estimation.rock_lags import SampleWindow, curve_weights, fading_taps, lag_knots
from heaved.estimation.rock_learning import BATCH_S, EXPERT_SPANS_S, EXPERTS, Learner, first_choice
from heaved.estimation.rock_regressors import Regressors

Array = NDArray[np.float64]

BACKWARDS: Final = 20
"""Stamps in a row that are not later: the clock has been set back, begin anew."""


class Params(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The part of ``[rock]`` that the direct predictor reads."""

    horizons_s: tuple[Annotated[float, msgspec.Meta(ge=0.01, le=60.0)], ...] = (0.05, 0.10, 0.15, 0.5, 1.0, 2.0, 5.0)
    memory_s: Annotated[float, msgspec.Meta(ge=60.0, le=1800.0)] = 300.0
    """Of the regression on 40 s of lags; those on 10 and 2 s forget faster."""
    max_gap_s: Annotated[float, msgspec.Meta(ge=0.05, le=5.0)] = 2.0
    """Gaps up to this are filled with predictions; after longer ones the lags are filled anew."""
    choice_s: Annotated[float, msgspec.Meta(ge=0.1, le=4.0)] = 1.0
    """Predictions are scored and experts chosen so often: how soon a turn is noticed, and a good part of the cost."""


class DirectPredictor:
    """Predicts n channels at once; arrays published are (H, n), in the unit of the channels.

    ``values`` of a channel are nan until 2 s of it have been seen and after a gap longer than ``max_gap_s``;
    ``std`` and ``half_width`` (of the 95 % interval) until some errors are known. Both are against the *measured*
    value, so sensor noise is in them.
    """

    def __init__(self, channels: int, params: Params | None = None, *, rates: bool = False) -> None:
        """``rates``: the first derivative of every channel will be given with each sample."""
        self._params = params if params is not None else Params()
        self.horizons_s = tuple(sorted(set(self._params.horizons_s)))
        self._horizons = np.array(self.horizons_s)
        self._n = channels
        self._with_rates = rates
        self._no_rates = [0.0] * channels
        self._unknown_curve = np.full((len(self.horizons_s) + 1, channels), nan)
        self.restarts = 0
        """Times that the stream was begun anew."""
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._clock = SampleClock()
        self._t_s = -inf
        self._backwards = 0
        self._pending: list[tuple[float, Sequence[float], Sequence[float]]] = []
        self._built = False
        self._channels: list[Channel] = []
        self._switch = Switch(self._horizons, EXPERTS, self._n, first_choice(self._horizons))
        self.curve = self._unknown_curve
        """What is known of the latest sample (filled where it was missing) and of the horizons, (H + 1, n)."""
        self.values = self._unknown_curve[1:]

    @property
    def std(self) -> Array:
        """Standard deviation of the prediction errors, (H, n)."""
        return self._switch.std

    @property
    def half_width(self) -> Array:
        """Half-width of the 95 % interval, (H, n)."""
        return self._switch.half_width

    @property
    def rms_error(self) -> Array:
        """Rolling RMS of what was published, against what was measured then, (H, n)."""
        return self._switch.rms_error

    @property
    def coverage(self) -> Array:
        """Rolling share of measured values inside the published interval, (H, n)."""
        return self._switch.coverage

    @property
    def spikes(self) -> int:
        """Samples held back for good since the stream was begun."""
        return sum(channel.spikes for channel in self._channels)

    @property
    def level_steps(self) -> int:
        """Steps of the level since the stream was begun."""
        return sum(channel.level_steps for channel in self._channels)

    @property
    def experts(self) -> NDArray[np.intp]:
        """The expert in office, (H, n): 0, 1, 2 regressions by their lags, then extrapolation, hold, mean."""
        return self._switch.best

    def step(self, t_s: float, values: Sequence[float], rates: Sequence[float] | None = None) -> Array:
        """Take one sample of all channels (nan: not known) and predict from it, (H, n).

        A sample that is not later than the last one is ignored; twenty of them in a row begin everything anew.
        """
        if not t_s > self._t_s:
            self._backwards += t_s == t_s
            if self._backwards >= BACKWARDS:
                self._restart()
            return self.values
        self._backwards = 0
        self._t_s = t_s
        given = self._no_rates if rates is None else rates
        if not self._built:
            self._pending.append((t_s, tuple(values), tuple(given)))
            self._begin()
            return self.values
        steps = self._clock.step(t_s)
        late_s = self._clock.late_s
        if steps > self._longest_gap:
            for channel in self._channels:
                channel.lose()
            self._learner.forget(slice(None))
            steps = 1
        for _ in range(steps - 1):
            self._row(self._unmeasured, self._no_rates, 0.0)
        if steps > 0:
            self._row(values, given, late_s)
        if self._batch_due and self._clock.changed():
            self._restart()
        else:
            self._publish(late_s)
        return self.values

    def _restart(self) -> None:
        self.restarts += 1
        self.reset()

    def _begin(self) -> None:
        if not self._clock.start([t for t, _, _ in self._pending]):
            return
        self._build(self._clock.interval_s)
        index = np.rint((np.array([t for t, _, _ in self._pending]) - self._pending[-1][0]) / self._clock.interval_s)
        steps = np.diff(index, prepend=index[0] - 1.0).astype(int).tolist()
        for count, (_, values, rates) in zip(steps, self._pending, strict=True):
            for _ in range(count - 1):
                self._row(self._unmeasured, self._no_rates, 0.0)
            if count > 0:
                self._row(values, rates, 0.0)
        self._pending.clear()
        self._publish(self._clock.late_s)

    # -- geometry, for one sample interval -------------------------------------------------------------------------

    def _build(self, interval_s: float) -> None:
        """Everything whose shape depends on the sample interval."""
        self._built = True
        horizons, n = self._horizons, self._n
        count = len(horizons)
        knots = lag_knots(interval_s, EXPERT_SPANS_S[-1])
        taps = fading_taps(interval_s, np.append(horizons, [0.0, 1e-3]))
        settling = taps.shape[1]
        self._longest_gap = max(round(self._params.max_gap_s / interval_s), 3)
        judged = max(round(JUDGED_S / interval_s), 3)
        self._unmeasured, self._rates = [nan] * n, [0.0] * n

        keep = int(knots[-1]) + round((BATCH_S + 1.0) / interval_s) + judged + 8
        columns = 3 * n if self._with_rates else 2 * n
        self._window = SampleWindow(knots, columns, max(keep, settling))
        # Predictions by extrapolation, and the slope now.
        taps = np.concatenate([taps[:count], (taps[-1:] - taps[-2:-1]) / 1e-3])
        self._regressors = Regressors(self._window, n, taps, rates=self._with_rates)
        self._learner = Learner(
            horizons,
            interval_s,
            self._params.memory_s,
            self._params.choice_s,
            knots=knots,
            window=self._window,
            regressors=self._regressors,
            switch=self._switch,
        )
        self._until_row = self._learner.every
        self._batch_due = False

        # Interpolation of the predicted curve: one sample on, and its slope at each horizon.
        ahead_s = interval_s * np.arange(1, ceil(horizons[-1] / interval_s) + 2)
        gap_weights = curve_weights(horizons, ahead_s)
        self._one_step = gap_weights[:1]
        self._slopes = curve_weights(horizons, horizons, derivative=1)
        self._seen = np.zeros((n, count + 3, 1))
        self._curves, self._near = self._seen[:, :-2, 0], self._seen[:, -2:, 0]
        self._map = self._mapped()
        self._levels: list[float] = []
        timing = Timing(interval_s=interval_s, settling=settling, longest_gap=self._longest_gap, judged=judged)
        self._channels = [Channel(timing, gap_weights, curve) for curve in self._curves]

    def _mapped(self) -> Array:
        """(n, H + 3, width) from the vectors to the latest sample, the predictions, one step on, the slope."""
        regressors, n = self._regressors, self._n
        now, slope = (np.tile(row, (n, 1, 1)) for row in (regressors.sample, regressors.taps[-1]))
        curve = np.concatenate([now, self._learner.weights], axis=1)
        return np.concatenate([curve, self._one_step @ curve, slope], axis=1)

    # -- one sample ------------------------------------------------------------------------------------------------

    def _row(self, values: Sequence[float], rates: Sequence[float], late_s: float) -> None:
        """One step of the grid: take the sample, predict, learn when it is time."""
        window, channels = self._window, self._channels
        taken, known, means = [], [], []
        near = self._near.tolist()
        for c, channel in enumerate(channels):
            x, measured = channel.take(values[c], late_s, *near[c])
            if channel.since == 1:
                window.flatten(c, x)
                self._learner.forget(c)
            taken.append(x)
            known.append(measured)
            means.append(channel.mean)
        if self._with_rates:
            self._rates = [r if isfinite(r) else p for r, p in zip(rates, self._rates, strict=True)]
            taken += self._rates
        window.append(taken + means, known)
        if not all(known):
            for c, channel in enumerate(channels):
                if (instead := channel.judge()) is not None:
                    window.replace(c, instead)
        np.matmul(self._map, self._regressors.now()[:, :, None], out=self._seen)
        self._until_row -= 1
        self._batch_due = False
        if self._until_row == 0:
            self._until_row = self._learner.every
            if self._learner.keep(self._curves[:, 1:].T, channels):
                if self._learner.batch(channels):
                    self._map = self._mapped()
                self._batch_due = True

    def _publish(self, late_s: float) -> None:
        """The latest predictions as seen from ``late_s`` after their grid time."""
        levels = [channel.level if channel.ready else nan for channel in self._channels]
        if levels != self._levels:
            self._levels, self._level = levels, np.array(levels)
        self.curve = self._curves.T + self._level
        self.values = self.curve[1:]
        if abs(late_s) > 1e-5:
            self.values += late_s * (self._slopes @ self._curves.T)
