"""Rock prediction: roll, pitch and yaw a fraction of a second ahead, by the maximum-likelihood method.

Source: Wei et al. 2019 (ship rock prediction). Each axis is taken as a damped oscillator with unknown coefficients,
hence X(k+1) = phi11 X(k) + phi12 V(k) over one step of 50 ms, where (phi11, phi12) are the least-squares estimate over
the last M points (eq. 6; its printed sums lost their dots: the second regressor is the velocity). X and V come from a
fading-memory polynomial filter (eq. 7, 8; ``fading.py``). Further steps feed each prediction back as if measured.

The paper works at 20 Hz. Here the step stays 50 ms at every sample rate, and everything else runs on the samples as
they come, with their own times:

* the filter state is a Taylor polynomial, moved by the true interval, so jitter and gaps cost nothing;
* its memory is held by the mean age of the weights, A = 50 ms theta/(1-theta), i.e. theta(dt) = A/(A+dt). At 20 Hz that
  is theta itself; at 100 Hz theta^(20/fs) would remember 16 % longer and pay for it (bias grows with age^4);
* each sample is regressed on the state of 50 ms before, moved by the remainder: at 100 Hz five times as many equations,
  over the same time;
* the regression is centred on the mean of the last ~30 s, with a constant that is free within the doubt about that
  mean (list, heading). The mean of the M points, less than a period long, would follow the motion itself: it doubles
  the error of a slow roll.

Which memory is best depends on the sensor's noise against the sea. A few run side by side; per axis and horizon the one
with the least realised error is published.
"""

from __future__ import annotations

from collections import Counter, deque
from math import exp, inf, nan, pi
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.rock.fading import gain_table, gains, pascal
from heaved.estimation.rock.limits import LIMITS, possible
from heaved.estimation.rock.params import STANDARD_HORIZONS_S, STEP_S, Params
from heaved.samples import RockPrediction, RockScore

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What this file is set to."""

    start_span_s: float = 40 * STEP_S
    """The end-point fit takes 41 points (Wei et al. 2019)."""
    gap_s: float = 0.25
    """Longer gaps start an axis anew, unless configured otherwise."""
    mean_settles_s: float = 10.0
    """About one period: the mean over T of a motion of deviation s wanders by s min(1, 10 s / T)."""
    holes_memory_s: float = 2.0
    holes_s: tuple[float, float] = (0.2, 0.1)
    """Seconds without the usual readings within that memory from which on an axis is left out, and up to which it stays
    so: its errors are others than those that its standard deviation comes from."""
    usual: float = 1.5
    """Usual intervals between readings that are no hole."""
    settled_s: float = 5.0
    """After a gap: until the regression sees nothing but what has come since. Before, deviations are..."""
    widened: float = 2.0
    """...so many times as large."""
    out_s: float = 3.0
    """An axis predicted beyond the bounds for so long, longer than a spike is seen, starts anew."""
    still_rad: float = 1e-9
    """Motion below this is arithmetic noise."""
    collinear: float = 1e-9
    """Least determinant of the regression, relative to that of uncorrelated regressors."""
    early: float = 2.0
    """While young the mean square error is that of the last half or so: what the start cost fades as 1/t^2."""
    enough_s: float = 5.0
    """Errors known for so long before their RMS is given out."""
    choice_s: float = 0.4
    """Errors known for so long, and renewed so often, to choose by them."""


TUNING: Final = Tuning()
YAW = 2
AXES = 3


def seen_later(predictions: tuple[RockPrediction, ...], by_s: float) -> tuple[RockPrediction, ...]:
    """The same predictions as seen from a moment ``by_s`` later, on straight lines through neighbouring horizons.

    For the moment between two samples, or of one that is late. Beyond one step of 50 ms nothing is claimed (nan).
    """
    if not 0.0 <= by_s <= STEP_S or len(predictions) < 2:
        return tuple(RockPrediction(horizon_s=p.horizon_s) for p in predictions)
    seen = []
    for i, p in enumerate(predictions):
        near, far = predictions[min(i, len(predictions) - 2) :][:2]
        share = (p.horizon_s + by_s - near.horizon_s) / (far.horizon_s - near.horizon_s)
        turn = (far.yaw_rad - near.yaw_rad + pi) % (2 * pi) - pi
        seen.append(
            RockPrediction(
                horizon_s=p.horizon_s,
                roll_rad=near.roll_rad + share * (far.roll_rad - near.roll_rad),
                pitch_rad=near.pitch_rad + share * (far.pitch_rad - near.pitch_rad),
                yaw_rad=(near.yaw_rad + share * turn) % (2 * pi),
                roll_std_rad=far.roll_std_rad,
                pitch_std_rad=far.pitch_std_rad,
                yaw_std_rad=far.yaw_std_rad,
            )
        )
    return tuple(seen)


class MaximumLikelihoodPredictor:
    """Predicts the three axes at once; arrays are (B, 3, ...): B memories by roll, pitch, yaw.

    What is published is what is known: an axis is nan until 2 s of it have been seen (``endpoint``) or the window is
    full (``zero``), and again after a gap longer than ``max_gap_s``. Shorter gaps are bridged by the filter's own
    extrapolation while they are few; an axis with many is left out. Below about 10 Hz a very quiet sensor gains little:
    its samples are too far apart for the polynomial. A reading that no ship has is none.

    Standard deviations are the exponentially weighted RMS of the realised errors against the *measured* angle, so
    sensor noise is in them; nan until 5 s of errors are known. The error of a horizon is taken from the prediction
    whose age is nearest to it (and at least one sample), evaluated at exactly that age.
    """

    def __init__(self, params: Params | None = None) -> None:
        self._params = p = params if params is not None else Params()
        self.horizons_s = tuple(sorted({*p.horizons_s, *STANDARD_HORIZONS_S}))
        self.begun_anew: Counter[str] = Counter()
        """By reason: how often an axis was begun anew for what it predicted."""
        self._horizons = np.array(self.horizons_s)
        self._grid = np.maximum(np.rint(self._horizons / STEP_S), 1.0).astype(np.intp)
        """Whole steps to each horizon; the remainder is bridged by the filter's polynomial."""

        # State: m+1 Taylor coefficients (in steps of 50 ms), the constant 1, the prediction that led to it.
        self._order = order = p.degree + 1
        self._one, self._x = order, order + 1
        self._powers = np.arange(order, dtype=np.float64)
        self._shift_factor, self._shift_power = np.eye(order + 2), np.zeros((order + 2, order + 2))
        binomial, power = pascal(p.degree)
        self._shift_factor[:order, :order], self._shift_power[:order, :order] = binomial.T, power.T
        # Angle some steps after a state's own time: the prediction there plus what the polynomial adds.
        self._beyond_factor = np.concatenate([[0.0], np.ones(p.degree), [0.0, 1.0]])
        self._beyond_power = np.concatenate([self._powers, [0.0, 0.0]])
        self._mean_age_s = STEP_S * np.array([theta / (1.0 - theta) for theta in p.thetas])
        self._gain_table = gain_table(p.degree)
        # A step of 50 ms whose measurement is the prediction x itself: z <- z feed + x feed_gain.
        self._feed_gain = self._state_gain(STEP_S)
        self._feed = self._state_shift(1.0) - self._state_shift(1.0)[:, :1] * self._feed_gain[:, None, :]
        self._remainder = self._beyond(self._horizons / STEP_S - self._grid)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        rows = (len(self._params.thetas), AXES)
        width = self._order + 2
        self._t_s = -inf
        self._interval_s = nan
        self._gain_interval_s = nan
        self._gain = self._feed_gain[:, None, :]
        self._z = np.zeros((*rows, width))
        self._z[..., self._one] = 1.0
        self._states: deque[tuple[float, Array]] = deque()
        self._axes = tuple(_Axis() for _ in range(AXES))
        self._yaw_reference_rad = nan
        self._yaw_rad = 0.0
        self._fitted_s = self._scored_s = -inf
        self._advance = np.full((len(self._grid), *rows, width, width), nan)
        keep_s = max(self._params.window_s, TUNING.start_span_s, self.horizons_s[-1]) + 1.0
        self._history = History(rows, (len(self._grid), *rows, width), keep_s)
        self._errors = RealisedErrors((len(self._grid), *rows), self._params.error_memory_s)
        self._latest = tuple(RockPrediction(horizon_s=h) for h in self.horizons_s)

    def step(
        self,
        t_s: float,
        angles_rad: tuple[float, float, float],
        rates_radps: tuple[float, float, float] = (nan, nan, nan),  # noqa: ARG002  # the method makes no use of them
    ) -> tuple[RockPrediction, ...]:
        """Take roll, pitch and yaw (nan: not known) and predict from them, one record per horizon, shortest first.

        A sample that is not later than the last one is ignored.
        """
        if not t_s > self._t_s:
            return self._latest
        roll_rad, pitch_rad, yaw_rad = angles_rad
        elapsed_s = t_s - self._t_s if self._t_s > -inf else STEP_S
        if self._t_s > -inf:
            typical_s = self._interval_s if self._interval_s > 0.0 else elapsed_s
            self._interval_s = typical_s + 0.05 * (min(elapsed_s, 1.0) - typical_s)
        self._t_s = t_s

        measured = np.array([possible(roll_rad), possible(pitch_rad), self._unwrapped(yaw_rad)])
        used = self._follow_axes(elapsed_s, measured)
        self._filter(elapsed_s, measured, used)
        row = self._history.push(t_s, measured)
        self._regressors(row, elapsed_s, measured, used)
        self._start_axes(row)
        self._states.append((t_s, self._z))

        if t_s - self._fitted_s > STEP_S - 0.5 * elapsed_s:
            self._fit()
        curve = (self._z[:, :, None, :] @ self._advance)[..., 0, :]
        self._history.curves[row] = curve
        for index, axis in enumerate(self._axes):
            if axis.is_holed:  # what is left out is not scored
                self._history.curves[row, :, :, index] = nan
            elif axis.is_slower:
                axis.is_slower = False
                self._errors.forget(index)
        since_s = t_s - self._scored_s if self._scored_s > -inf else elapsed_s
        if since_s > STEP_S - 0.5 * elapsed_s:  # errors closer together are hardly different ones
            self._score(row, min(since_s, max(STEP_S, elapsed_s)), elapsed_s, measured)
            self._scored_s = t_s
        self._latest = self._publish(curve)
        return self._latest

    def at(self, t_s: float) -> tuple[RockPrediction, ...]:
        """Predictions as seen from a moment without a sample, on straight lines through neighbouring horizons."""
        return seen_later(self._latest, t_s - self._t_s)

    def scores(self) -> tuple[RockScore, ...]:
        """No account is kept of how predictions have fared."""
        return ()

    @property
    def resets(self) -> Counter[tuple[str, str]]:
        """By (filter, reason): how often an axis was begun anew for what it predicted."""
        return Counter({("rock", reason): count for reason, count in self.begun_anew.items()})

    # -- one sample -----------------------------------------------------------------------------------------------

    def _unwrapped(self, yaw_rad: float) -> float:
        """Yaw relative to the first reading, without jumps."""
        if not -inf < yaw_rad < inf:
            return nan
        if self._yaw_reference_rad != self._yaw_reference_rad:
            self._yaw_reference_rad = yaw_rad
        self._yaw_rad += (yaw_rad - self._yaw_reference_rad - self._yaw_rad + pi) % (2 * pi) - pi
        return self._yaw_rad

    def _follow_axes(self, elapsed_s: float, measured: Array) -> list[bool]:
        """Begin, restart and centre each axis; which of the values go into the filter."""
        usual_s = self._interval_s if self._interval_s > 0.0 else STEP_S
        limit_s = max(self._params.max_gap_s or TUNING.gap_s, 3.5 * usual_s)
        used = []
        for index, (axis, value) in enumerate(zip(self._axes, measured.tolist(), strict=True)):
            if self._t_s - axis.seen_s > limit_s:
                axis.forget()
                self._forget(index)
            if known := -inf < value < inf:
                if axis.begun_s != axis.begun_s:
                    axis.begun_s = self._t_s
                    axis.running = self._params.mode == "zero"
                axis.read(self._t_s, limit_s)
                age_s = self._t_s - axis.begun_s + elapsed_s
                axis.mean += elapsed_s / min(age_s, self._params.mean_memory_s) * (value - axis.mean)
            used.append(known and axis.running)
        return used

    def _forget(self, axis: int) -> None:
        self._z = self._z.copy()
        self._z[:, axis, : self._order] = 0.0
        self._history.pairs[:, axis] = 0.0
        self._history.measured[:, axis] = nan
        self._history.curves[:, :, :, axis] = nan

    def _state_shift(self, steps: float) -> Array:
        """(m+3, m+3), to the right of a state: the polynomial moved on by ``steps``, the rest kept."""
        matrix: Array = self._shift_factor * steps**self._shift_power
        return matrix

    def _state_gain(self, interval_s: float) -> Array:
        theta = self._mean_age_s / (self._mean_age_s + interval_s)
        gain = np.zeros((len(theta), self._order + 2))
        gain[:, : self._order] = gains(self._gain_table, theta) * (interval_s / STEP_S) ** -self._powers
        return gain

    def _filter(self, elapsed_s: float, measured: Array, used: list[bool]) -> None:
        if not 0.8 * elapsed_s < self._gain_interval_s < 1.25 * elapsed_s:  # jitter needs no new gain, a gap does
            self._gain_interval_s = elapsed_s
            self._gain = self._state_gain(elapsed_s)[:, None, :]
        z = self._z @ self._state_shift(elapsed_s / STEP_S)
        innovation = measured - z[..., 0]
        gain = self._gain
        if not all(used):
            innovation = np.where(used, innovation, 0.0)
        if any(axis.waited_s > 1.25 * elapsed_s for axis in self._axes):  # a reading weighs for all since the last one
            gain = np.stack([self._state_gain(max(axis.waited_s, elapsed_s)) for axis in self._axes], axis=1)
        self._z = z + innovation[..., None] * gain

    def _regressors(self, row: int, elapsed_s: float, measured: Array, used: list[bool]) -> None:
        """One equation of the regression: this sample on position and velocity of one step before."""
        states = self._states
        lagged_s = self._t_s - STEP_S
        latest_s = lagged_s + 0.5 * elapsed_s
        while len(states) > 1 and states[1][0] <= latest_s:
            states.popleft()
        if not states or states[0][0] > latest_s:
            return
        then_s, z = states[0]
        pair = self._history.pairs[..., row]
        pair[..., :2] = z @ self._state_shift((lagged_s - then_s) / STEP_S)[:, :2]
        pair[..., 2] = 1.0
        pair[..., 3] = measured
        absent = [i for i, axis in enumerate(self._axes) if not (used[i] and axis.begun_s <= latest_s)]
        if absent:
            pair[:, absent] = 0.0

    def _start_axes(self, row: int) -> None:
        for index, axis in enumerate(self._axes):
            if axis.ready or axis.seen_s != self._t_s:
                continue
            waited_s = self._t_s - axis.begun_s + 0.5 * self._interval_s
            if self._params.mode == "zero":
                axis.ready = waited_s >= self._params.window_s - STEP_S
            elif waited_s >= TUNING.start_span_s:
                axis.ready = axis.running = self._fit_start(row, index)

    def _fit_start(self, row: int, axis: int) -> bool:
        """One polynomial through the first 2 s gives the state and all past positions, velocities and inputs.

        (Smoothed past outputs beside raw past inputs, as printed, would excite the repeated pole of the filter.)
        """
        history = self._history
        rows = np.arange(history.first, row + 1)
        rows = rows[np.isfinite(history.measured[rows, axis]) & (history.t_s[rows] >= self._axes[axis].begun_s)]
        powers = np.arange(self._order + 2)
        if len(rows) < len(powers) + 2:
            return False
        steps = (history.t_s[rows] - self._t_s) / STEP_S
        measured = history.measured[rows, axis]
        span = TUNING.start_span_s / STEP_S
        fit = np.linalg.lstsq((steps / span)[:, None] ** powers, measured, rcond=None)[0] / span**powers
        self._z = self._z.copy()
        self._z[:, axis, : self._order] = fit[: self._order]
        for then_s, state in self._states:
            state[:, axis] = self._z[:, axis] @ self._state_shift((then_s - self._t_s) / STEP_S)
        lagged = (steps - 1.0)[:, None] ** powers
        pairs = np.stack([lagged @ fit, lagged[:, :-1] @ (powers * fit)[1:], np.ones(len(rows)), measured], axis=1)
        history.pairs[:, axis, :, rows] = np.where(steps > steps[0] + 0.99, pairs.T, 0.0).T[:, None, :]
        self._fitted_s = -inf
        return True

    # -- prediction -----------------------------------------------------------------------------------------------

    def _fit(self) -> None:
        """(phi11, phi12) of eq. (6) and from them the matrices that carry a state to each horizon."""
        self._fitted_s = self._t_s
        phi = self._transition()
        step = self._feed[:, None] + phi[..., :, None] * self._feed_gain[:, None, None, :]
        step[..., self._x] = phi
        done, power = 1, step
        for i, n in enumerate(self._grid.tolist()):
            if n > done:
                power = power @ (step if n == done + 1 else np.linalg.matrix_power(step, n - done))
                done = n
            self._advance[i] = power
        blind = [index for index, axis in enumerate(self._axes) if not axis.ready]
        self._advance[:, :, blind] = nan

    def _transition(self) -> Array:
        """(B, 3, m+3): x(t + 50 ms) as a linear function of the state."""
        pairs = self._history.window(self._t_s - self._params.window_s + 0.5 * self._interval_s)
        moments = pairs @ pairs.swapaxes(-1, -2)
        about = []
        for axis in self._axes:
            age_s = min(self._t_s - axis.begun_s, self._params.mean_memory_s) if axis.ready else TUNING.mean_settles_s
            about.append((axis.mean, TUNING.mean_settles_s / max(age_s, TUNING.mean_settles_s)))
        found = np.array(
            [
                [regression(sums, mean, doubt) for sums, (mean, doubt) in zip(axes, about, strict=True)]
                for axes in moments.tolist()
            ]
        )
        phi = np.zeros((*found.shape[:2], self._order + 2))
        phi[..., :2] = found[..., :2]
        phi[..., self._one] = found[..., 2]
        return phi

    def _beyond(self, steps: Array) -> Array:
        """(H, m+3, 1) weights of a state that give the angle ``steps`` (H,) after its own time."""
        weights: Array = self._beyond_factor * steps[:, None] ** self._beyond_power
        return weights[:, :, None]

    def _score(self, row: int, weight_s: float, elapsed_s: float, measured: Array) -> None:
        history = self._history
        made_s = history.t_s[history.first : row]
        found = made_s.searchsorted(self._t_s - self._horizons + 0.5 * elapsed_s) - 1
        if found[0] < 0:
            return
        age_s = self._t_s - made_s[found]
        curve = history.curves[history.first + found, np.arange(len(found))]
        error = measured - (curve @ self._beyond(age_s / STEP_S - self._grid)[:, None])[..., 0]
        if found[-1] < 0:
            error[found < 0] = nan
        self._errors.update(self._t_s, weight_s, error)

    def _publish(self, curve: Array) -> tuple[RockPrediction, ...]:
        best, std = self._errors.of_best(curve)
        value = (best @ self._remainder)[..., 0]
        beyond = LIMITS.left_by(value, self.horizons_s)
        if beyond.any():
            value[np.logical_or.accumulate(beyond, axis=0)] = nan
        for index, axis in enumerate(self._axes):
            if beyond[:, index].any():
                if self._t_s - max(axis.within_s, axis.begun_s) > TUNING.out_s:
                    axis.forget()
                    self._forget(index)
                    self.begun_anew["out of bounds"] += 1
            else:
                axis.within_s = self._t_s
            if axis.is_holed:
                value[:, index] = nan
            elif self._t_s > axis.seen_s:  # deviations are those of horizons longer by the age of the reading
                std[:, index] = np.interp(self._horizons + self._t_s - axis.seen_s, self._horizons, std[:, index])
            if axis.is_young(self._t_s):
                std[:, index] *= TUNING.widened
        turned = value[:, YAW] + self._yaw_reference_rad
        value[:, YAW] = turned % (2 * pi)
        return tuple(
            RockPrediction(
                horizon_s=h,
                roll_rad=v[0],
                pitch_rad=v[1],
                yaw_rad=0.0 if v[2] >= 2 * pi else v[2],  # x % 2 pi may round up to 2 pi
                roll_std_rad=s[0],
                pitch_std_rad=s[1],
                yaw_std_rad=s[2],
            )
            for h, v, s in zip(self.horizons_s, value.tolist(), std.tolist(), strict=True)
        )


class _Axis:
    """What is known of one axis: since when, its mean, and how far its start has got."""

    def __init__(self) -> None:
        self.mean = 0.0
        self.begun_s = self.seen_s = nan
        self.usual_s = nan
        """Between readings."""
        self.within_s = -inf
        """When its predictions were last within the bounds."""
        self.is_slower = False
        """Its readings have come to be usual that were holes when it was left out: its errors are not known."""
        self._missing_s = 0.0
        self._left_usual_s = nan
        self._left_out = self._begun_again = False
        self.forget()

    def read(self, t_s: float, limit_s: float) -> None:
        """A reading has come; an interval longer than ``limit_s`` is a gap, after which the axis begins anew."""
        waited_s = self.waited_s = t_s - self.seen_s if self.seen_s == self.seen_s else 0.0
        self.seen_s = t_s
        if not 0.0 < waited_s <= limit_s:
            return
        if self.usual_s != self.usual_s:
            self.usual_s = waited_s
        self._missing_s *= exp(-waited_s / TUNING.holes_memory_s)
        if waited_s > TUNING.usual * self.usual_s:
            self._missing_s += waited_s - self.usual_s
        was_left_out, self._left_out = self._left_out, self._missing_s > TUNING.holes_s[1 if self._left_out else 0]
        if self._left_out and not was_left_out:
            self._left_usual_s = self.usual_s
        self.is_slower = was_left_out and not self._left_out and self.usual_s > TUNING.usual * self._left_usual_s
        self.usual_s += min(waited_s / TUNING.mean_settles_s, 1.0) * (waited_s - self.usual_s)

    @property
    def is_holed(self) -> bool:
        """Whether too much is missing for its predictions to be as good as usual."""
        return self._left_out

    def is_young(self, t_s: float) -> bool:
        """Whether it has begun anew, and its errors are larger than those that its standard deviation comes from."""
        return self._begun_again and t_s - self.begun_s < TUNING.settled_s

    def forget(self) -> None:
        self._begun_again = self._begun_again or self.begun_s == self.begun_s
        self.begun_s = nan
        self.seen_s = nan
        self.waited_s = 0.0
        """For the latest reading."""
        self.running = False
        """Its samples go into the filter."""
        self.ready = False
        """It is predicted."""


class History:
    """The last ``keep_s`` of samples and predictions: contiguous rows ``first..end``, moved to the front when full."""

    def __init__(self, rows: tuple[int, int], curve: tuple[int, ...], keep_s: float) -> None:
        capacity = 256
        self.keep_s = keep_s
        self.first = self.end = self._window = 0
        self.t_s = np.zeros(capacity)
        self.measured = np.full((capacity, rows[1]), nan)
        self.pairs = np.zeros((*rows, 4, capacity))
        """(B, 3, 4, row): position and velocity one step before, 1, measured angle; zero where there is none."""
        self.curves = np.full((capacity, *curve), nan)
        """(row, H, B, 3, m+3): the states predicted at that row."""

    def push(self, t_s: float, measured: Array) -> int:
        """A row for the sample at t_s; no regressors yet."""
        while self.t_s[self.first] < t_s - self.keep_s and self.first < self.end:
            self.first += 1
        if self.end == len(self.t_s):
            self._move_to_front()
        row = self.end
        self.t_s[row] = t_s
        self.measured[row] = measured
        self.pairs[..., row] = 0.0
        self.end += 1
        return row

    def window(self, since_s: float) -> Array:
        """What is remembered since then."""
        self._window = max(self._window, self.first)
        while self.t_s[self._window] < since_s:
            self._window += 1
        return self.pairs[..., self._window : self.end]

    def _move_to_front(self) -> None:
        live = slice(self.first, self.end)
        count = self.end - self.first
        capacity = len(self.t_s) * (2 if 2 * count > len(self.t_s) else 1)
        for name, axis in (("t_s", 0), ("measured", 0), ("pairs", 3), ("curves", 0)):
            old: Array = getattr(self, name)
            shape = list(old.shape)
            shape[axis] = capacity
            new = np.empty(shape)
            np.moveaxis(new, axis, 0)[:count] = np.moveaxis(old, axis, 0)[live]
            setattr(self, name, new)
        self._window = max(self._window - self.first, 0)
        self.first, self.end = 0, count


class RealisedErrors:
    """Exponentially weighted mean square of realised errors, shape (H, B, 3), and the memory that has the least."""

    def __init__(self, shape: tuple[int, int, int], memory_s: float) -> None:
        self._memory_s = memory_s
        self._seconds = np.zeros(shape)
        self._mean_square = np.zeros(shape)
        self._chosen_s = -inf
        horizon, axis = np.ogrid[: shape[0], : shape[2]]
        self._best: tuple[NDArray[np.intp], ...] = (horizon, np.full((shape[0], shape[2]), shape[1] // 2), axis)
        self._floor = np.full((shape[0], shape[2]), nan)

    def forget(self, axis: int) -> None:
        """Nothing is known of the errors of an axis."""
        self._seconds[:, :, axis] = 0.0
        self._floor[:, axis] = nan

    def update(self, t_s: float, elapsed_s: float, error: Array) -> None:
        """Errors that are not known are nan."""
        known = np.isfinite(error)
        self._seconds += elapsed_s * known
        memory_s = np.minimum(np.maximum(self._seconds, elapsed_s) / TUNING.early, self._memory_s)
        square = np.where(known, error * error, self._mean_square)
        self._mean_square += np.minimum(elapsed_s / memory_s, 1.0) * (square - self._mean_square)
        if t_s - self._chosen_s >= TUNING.choice_s:
            self._chosen_s = t_s
            seconds, middle = self._seconds[:, 0], self._seconds.shape[1] // 2
            best = np.where(seconds >= TUNING.choice_s, np.argmin(self._mean_square, axis=1), middle)
            self._best = (self._best[0], best, self._best[2])
            self._floor = np.where(seconds >= TUNING.enough_s, 0.0, nan)

    def of_best(self, values: Array) -> tuple[Array, Array]:
        """From ``values`` (H, B, 3, ...) the chosen memory's (H, 3, ...), and the RMS of its errors (H, 3).

        Until enough is known the memory is the middle one and the RMS nan.
        """
        return values[self._best], np.sqrt(self._mean_square[self._best]) + self._floor


def regression(moments: Sequence[Sequence[float]], mean: float, mean_doubt: float) -> tuple[float, float, float]:
    """Wei et al. 2019, eq. (6): least squares x' = phi_x x + phi_v v + c, as (phi_x, phi_v, c).

    Plain floats: a dozen 2 x 2 systems are no array.

    ``moments`` 4 x 4: sums of products of (x, v, 1, x'), x' the measured angle one step after x and v, in rad; v in
    rad per step. ``mean``: of the angle. ``mean_doubt``: its standard deviation over that of the motion.

    For an oscillator c = (1 - phi_x) mean. That is exact when the mean is known and costs nothing; a free c would
    waste information, a wrong mean would bend phi. So c is free within what the doubt allows: 1 - phi_x is near
    w^2/2 (w^2 = vv/xx, per step), so c has the prior deviation doubt * sqrt(xx/n) * w^2/2, against the residuals.
    Where the motion cannot tell (a still ship), x' = x.
    """
    (sum_xx, sum_xv, x, sum_xy), (_, vv, v, sum_vy), (_, _, count, y), (_, _, _, sum_yy) = moments
    n = max(count, 1.0)
    # About the mean.
    xx = sum_xx - mean * (2.0 * x - n * mean)
    xv = sum_xv - mean * v
    xy = sum_xy - mean * (x + y - n * mean)
    vy = sum_vy - mean * v
    yy = sum_yy - mean * (2.0 * y - n * mean)
    x, y = x - n * mean, y - n * mean

    def slopes(share: float) -> tuple[float, float]:
        """Slopes when that share of each product of sums is explained by the constant (0: none, 1/n: it is free)."""
        a, b, c = xx - share * x * x, xv - share * x * v, vv - share * v * v
        p, q = xy - share * x * y, vy - share * v * y
        determinant = a * c - b * b
        if min(a, c) <= n * TUNING.still_rad**2 or determinant <= TUNING.collinear * a * c:
            return 1.0, 0.0
        return (p * c - q * b) / determinant, (q * a - p * b) / determinant

    phi_x, phi_v = slopes(1.0 / n)
    explained = phi_x * (xy - x * y / n) + phi_v * (vy - v * y / n)
    residual = max(yy - y * y / n - explained, 0.0) / n
    prior = (mean_doubt * vv / 2.0) ** 2 / (xx * n) if xx > 0.0 else 0.0
    share = prior / (residual + n * prior) if prior > 0.0 else 0.0

    phi_x, phi_v = slopes(share)
    return phi_x, phi_v, mean * (1.0 - phi_x) + share * (y - phi_x * x - phi_v * v)
