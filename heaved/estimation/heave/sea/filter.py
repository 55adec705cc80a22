"""The live filter of the sea model: one measurement of the vertical acceleration at a time.

A Kalman filter (on this linear model every set of sigma points reproduces it to rounding: the tests say so). While
samples come in their usual interval and the covariance has converged to that of the steady filter, within a 1e-8th of
each variance, the steady gain is used: the estimate then differs by less than 1e-9 of the heave from the full one. A
missing sample, a rejected one or a gap brings the covariance back, and it grows as it should.

Jitter of the sampling times is taken in exactly by the mean (F(T) times a Taylor series of the rest); the covariance
takes the usual interval for any within half of it: 5 % of jitter cost half a thousandth of the heave, which is far
below what is not known anyway.
"""

from __future__ import annotations

from math import isfinite, sqrt
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.heave.sea.model import SeaSystem, Steady, measurement_variance

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of the live filter."""

    steady: float = 1e-8
    """Relative difference of every variance below which the covariance counts as converged."""
    gate: float = 10.0
    """Innovations beyond this many standard deviations are not of the sea."""
    release: float = 4.0
    """After one that is not, the next ones within this are: what is expected grows unsure, and a step would slip in."""
    gate_memory: float = 0.02
    """Weight of one innovation in the variance that opens the gate for a sea that grows."""
    gate_lasts: int = 10
    """What is outside for that many samples on end is no outlier."""
    opening: float = 3.0
    """One innovation counts in that variance with at most as many standard deviations: a sea does not grow in a
    sample."""
    drift_s: float = 1.0
    """Innovations are averaged over this before they are held against the model: noise cancels, a wrong sea stays."""
    surprise_s: float = 5.0
    """Memory of how far they were off."""
    exact_delta_s: float = 1e-7
    """A shorter rest of the interval than this changes nothing."""
    longest_steps: int = 40
    """Gaps of up to so many intervals are whole steps and the same rest; the matrices of each are kept."""
    at_first: tuple[float, float, float] = (10.0, 0.05, 0.05)
    """Standard deviations of constant (m), scale and time (s) of an aiding laser: nothing, what makes a laser be taken
    for one at all, and what is left of latencies that have been given."""
    wanders: tuple[float, float, float] = (0.01, 1e-3, 1e-3)
    """How they wander, per root of a minute: a centimetre of tide, or of a target that gives way; little else."""
    nudge_terms: int = 5
    """Of the Taylor series of a longer one: at 25 ms and 0.6 Hz the next one is 1e-7."""


TUNING: Final = Tuning()


class State(NamedTuple):
    """A filter at one moment; its arrays are never written to."""

    t_s: float
    x: Array
    P: Array | None
    rejected: int
    surprise: float
    drift: float
    seen: float
    withheld: int
    burst_variance: float
    gauge: tuple[Array, Array, Array] | None
    rate: BiasRate | None


class BiasRate(NamedTuple):
    """At which the bias goes on: one more state of the filter, while there is a drift. Never written to."""

    value: float
    """m/s3"""
    V: float
    """Its variance."""
    c: Array
    """(n,) its covariance with the state of the sea."""
    walk_psd: float
    """Its own walk: variance per second."""


class GaugeError:
    """What an aiding laser is off by, three more states of the filter: its reading is

        constant + (1 + scale) heave + early velocity + noise.

    Scale and time are what laser and accelerometer differ by. Neither can say which of them is wrong, so both stay in
    what is published as not known (:meth:`left_open`), however well they are known here.

    Attributes:
        value: (3,) constant in m, scale, and early in s.
        V: (3, 3) its covariance.
        c: (n, 3) its covariance with the state of the sea.
    """

    def __init__(self, value: Array, V: Array, n: int) -> None:
        self.value, self.V = value, V
        self.c = np.zeros((n, 3))

    @classmethod
    def at_first(cls, constant_m: float, n: int) -> GaugeError:
        """Before anything is known but a guess of the constant."""
        return cls(np.array([constant_m, 0.0, 0.0]), np.diag(np.square(TUNING.at_first)), n)

    def wander(self, elapsed_s: float, constant_m: float = 0.0) -> None:
        """What the time since the last reading has taken of what was known.

        constant_m: how far the constant has been seen to wander, per root of a minute.
        """
        walks = np.square((max(constant_m, TUNING.wanders[0]), *TUNING.wanders[1:]))
        self.V = self.V + np.diag(walks) * (elapsed_s / 60.0)

    def left_open(self, system: SeaSystem) -> Array:
        """(n, n) covariance that the state has beside its own where scale and time are the accelerometer's error."""
        shown = np.maximum(np.square(self.value) - np.diag(self.V), 0.0)
        return np.asarray(shown[1] * system.stationary + shown[2] * system.stationary_rates)


class SeaFilter:
    """State and covariance at the time of the last sample.

    Attributes:
        t_s: that time.
        x: (n,) filtered state.
        P: (n, n) its covariance; None: the steady one.
        rejected: samples that the gate has kept out.
        steady_covariance: (n, n) of the state while samples come as usual.
        innovation: of the last sample, withheld or not, m/s2.
        innovation_variance: of that, as the model has it, (m/s2)2.
        withheld: samples on end, up to the last one, that the gate has kept out.
        burst_variance: of noise beside that of the model, for now, (m/s2)2.
        surprise: variance of averaged innovations over that of the model, in the last seconds; 1 when it is right.
        rate: at which the bias goes on; None: it wanders only.
        maybe_off: (n,) by which the state is off if what is not sure yet is so, beside its covariance; None: nothing.
    """

    def __init__(self, system: SeaSystem, steady: Steady, t_s: float, x: Array, P: Array | None) -> None:
        self.system, self.steady = system, steady
        self.t_s, self.x, self.P = t_s, x, P
        self.rejected = 0
        self.surprise = 1.0
        self._drift = 0.0
        self._R = measurement_variance(system.model.noise_psd, steady.dt_s)
        self.steady_covariance = steady.P - np.outer(steady.K, steady.K) * steady.S
        self._steady_variances = np.diag(self.steady_covariance).copy()
        rows = [steady.F]
        for i in range(1, TUNING.nudge_terms):
            rows.append(system.A.dot(rows[-1]) / i)
        self._taylor = np.concatenate(rows)  # One product gives all terms.
        self._steps = [(steady.F, steady.Q)]
        self._seen = self.innovation_variance = steady.S
        self.withheld = 0
        self.burst_variance = self.innovation = 0.0
        self.gauge: GaugeError | None = None
        self.rate: BiasRate | None = None
        self.maybe_off: Array | None = None

    def laser_innovation(self, row: Array, laser_m: float) -> tuple[float, float]:
        """Of a reading of the laser, with the sign of heave: its difference from what is expected, and the variance of
        that before the noise of the reading (m2).

        row: (n,) heave at the laser's time from the state at ``t_s``.
        """
        assert self.gauge is not None
        gauge = self.gauge
        seen, on = self._seen_by(gauge, row)
        expected_m = float(row.dot(self.x)) + float(gauge.value.dot(on))
        variance = float(seen.dot(self.covariance.dot(seen) + 2.0 * gauge.c.dot(on))) + float(on.dot(gauge.V).dot(on))
        return laser_m - expected_m, max(variance, 0.0)

    def aid(self, row: Array, laser_m: float, noise_m2: float) -> None:
        """Take a reading as in :meth:`laser_innovation`, with noise of that variance."""
        assert self.gauge is not None
        gauge, P = self.gauge, self.covariance
        y, variance = self.laser_innovation(row, laser_m)
        seen, on = self._seen_by(gauge, row)
        S = variance + noise_m2
        of_state, of_gauge = P.dot(seen) + gauge.c.dot(on), seen.dot(gauge.c) + gauge.V.dot(on)
        self.x, self.P = self.x + of_state * (y / S), P - np.outer(of_state, of_state) / S
        gauge.value = gauge.value + of_gauge * (y / S)
        gauge.c = gauge.c - np.outer(of_state, of_gauge) / S
        gauge.V = gauge.V - np.outer(of_gauge, of_gauge) / S

    def _seen_by(self, gauge: GaugeError, row: Array) -> tuple[Array, Array]:
        """A reading as row on the state (n,), and on constant, scale and time (3,)."""
        moving = row.dot(self.system.A)
        seen = (1.0 + gauge.value[1]) * row + gauge.value[2] * moving
        return seen, np.array([1.0, float(row.dot(self.x)), float(moving.dot(self.x))])

    @property
    def covariance(self) -> Array:
        """(n, n) of x."""
        return self.steady_covariance if self.P is None else self.P

    @property
    def published_covariance(self) -> Array:
        """(n, n) of x, with what laser and accelerometer differ by, and what is not sure yet."""
        P = self.covariance if self.gauge is None else self.covariance + self.gauge.left_open(self.system)
        return P if self.maybe_off is None else P + np.outer(self.maybe_off, self.maybe_off)

    @property
    def is_steady(self) -> bool:
        """Whether the covariance is that of the steady filter."""
        return self.P is None

    def step(self, t_s: float, a_mps2: float) -> tuple[float, float]:
        """Take a sample at ``t_s`` > the last one; (heave in m before it was taken in, innovation in m/s2 or 0)."""
        dt = t_s - self.t_s
        steady, H = self.steady, self.system.H
        steps = round(dt / steady.dt_s) if dt < (TUNING.longest_steps + 0.5) * steady.dt_s else 0
        x = self.x
        if steps > 0:
            F, Q = self.moves(steps)
            delta = dt - steps * steady.dt_s
            if abs(delta) <= TUNING.exact_delta_s:
                x = F.dot(x)
            elif self.P is not None:
                # What is still open must turn as the state does: a hundredth of it is more than is left soon after.
                F = self._move(steps, delta)
                x = F.dot(x)
            else:
                x = self._moved(x if steps == 1 else self._steps[steps - 2][0].dot(x), delta)
        else:
            F, Q = self.system.transition(dt)
            x = F.dot(x)
        R = self._R + self.burst_variance
        is_usual = steps == 1 and R == self._R
        P = self.P if is_usual and self.P is None else _symmetric(F.dot(self.covariance).dot(F.T) + Q)
        if self.gauge is not None:
            self.gauge.c = F.dot(self.gauge.c)
        if self.rate is not None and P is not None:
            x, P = self._drifted(self.rate, F, x, P, dt)
        self.t_s = t_s
        predicted_m = float(self.system.heave.dot(x))
        y = a_mps2 - float(H.dot(x))
        PH = None if P is None else P.dot(H)
        S = steady.S if PH is None else float(H.dot(PH)) + R
        self.innovation, self.innovation_variance = y, S
        self._compare(y, S)
        if self._is_outlier(y, S):
            self.rejected += 1
            self.x, self.P = x, steady.P if P is None else P
            return predicted_m, 0.0
        if self.withheld >= TUNING.gate_lasts:
            # It lasts, so it is true, and what was thought to be known is not.
            self.withheld = 0
            P = self.system.stationary
            if self.rate is not None:
                self.rate = self.rate._replace(c=np.zeros(len(H)))
            PH = P.dot(H)
            S = float(H.dot(PH)) + R
        if P is None or PH is None:
            self.x = x + steady.K * y
        else:
            self.x, self.P = x + PH * (y / S), P - np.outer(PH, PH) / S
            if self.gauge is not None:
                cross = H.dot(self.gauge.c)
                self.gauge.value = self.gauge.value + cross * (y / S)
                self.gauge.c = self.gauge.c - np.outer(PH, cross) / S
                self.gauge.V = self.gauge.V - np.outer(cross, cross) / S
            if (rate := self.rate) is not None:
                seen = float(H.dot(rate.c))
                self.rate = rate._replace(
                    value=rate.value + seen * (y / S), V=rate.V - seen * seen / S, c=rate.c - PH * (seen / S)
                )
            self._settle()
        return predicted_m, y

    @property
    def noise_variance(self) -> float:
        """Of one sample by the model, (m/s2)2."""
        return self._R

    def state(self) -> State:
        """All that :meth:`restore` needs to be here again; cheap: nothing is copied."""
        gauge = self.gauge
        kept = None if gauge is None else (gauge.value, gauge.V, gauge.c)
        return State(
            self.t_s, self.x, self.P, self.rejected, self.surprise, self._drift, self._seen, self.withheld,
            self.burst_variance, kept, self.rate,
        )  # fmt: skip

    def restore(self, state: State) -> None:
        """Go back to an earlier :meth:`state`."""
        self.t_s, self.x, self.P, self.rejected, self.surprise = state[:5]
        self._drift, self._seen, self.withheld, self.burst_variance = state[5:9]
        if self.gauge is not None and state.gauge is not None:
            self.gauge.value, self.gauge.V, self.gauge.c = state.gauge
        self.rate = state.rate

    def open_bias(self) -> None:
        """Nothing is known of the accelerometer's bias any more; of the waves as much as ever."""
        self.P = self.system.opened(self.covariance, bias=True)

    def open_rate(self, mean: Array, covariance: Array, walk: float) -> None:
        """The bias drifts: what the state lacks (n), and the rate (m/s3) as the last element, are of this ``mean``
        (n + 1,) and ``covariance`` (n + 1, n + 1). ``walk``: of the rate, m/s3 per root second.
        """
        self.x, self.P = self.x + mean[:-1], self.covariance + covariance[:-1, :-1]
        self.rate = BiasRate(float(mean[-1]), float(covariance[-1, -1]), covariance[:-1, -1].copy(), walk**2)

    def open_resonances(self) -> None:
        """Something has struck the hull: what rings may ring otherwise than it did."""
        self.P = self.system.opened(self.covariance, resonances=True)

    def is_sound(self) -> bool:
        """Whether state and covariance are still finite numbers and variances positive."""
        return isfinite(float(self.x.dot(self.x))) and (self.P is None or bool(np.all(np.diag(self.P) > 0.0)))

    def moves(self, steps: int) -> tuple[Array, Array]:
        """F and Q of so many usual intervals, at least one."""
        F, Q = self._steps[0]
        while len(self._steps) < steps:
            before, added = self._steps[-1]
            self._steps.append((F.dot(before), _symmetric(F.dot(added).dot(F.T) + Q)))
        return self._steps[steps - 1]

    def _moved(self, x: Array, delta_s: float) -> Array:
        """expm(A (dt + delta)) x, for a delta far below the periods of the model: F x and its Taylor series."""
        terms = self._taylor.dot(x).reshape(TUNING.nudge_terms, len(x))
        return np.asarray(np.dot([delta_s**i for i in range(TUNING.nudge_terms)], terms))

    def _move(self, steps: int, delta_s: float) -> Array:
        """The same as a matrix (n, n), of ``steps`` usual intervals and ``delta_s``."""
        n = len(self.x)
        powers = [delta_s**i for i in range(TUNING.nudge_terms)]
        one = np.tensordot(powers, self._taylor.reshape(TUNING.nudge_terms, n, n), axes=1)
        return np.asarray(one if steps == 1 else one.dot(self._steps[steps - 2][0]))

    def _drifted(self, rate: BiasRate, F: Array, x: Array, P: Array, dt: float) -> tuple[Array, Array]:
        """State and covariance ``dt`` later, the drift of the bias added."""
        x = x.copy()
        x[-1] += rate.value * dt
        c = F.dot(rate.c)
        P[-1] += dt * c
        P[:, -1] += dt * c
        P[-1, -1] += dt * dt * rate.V
        c[-1] += dt * rate.V
        self.rate = rate._replace(V=rate.V + rate.walk_psd * dt, c=c)
        return x, P

    def _is_outlier(self, y: float, S: float) -> bool:
        variance = max(S, self._seen)
        self._seen += TUNING.gate_memory * (min(y * y, TUNING.opening**2 * variance) - self._seen)
        if abs(y) <= (TUNING.release if self.withheld else TUNING.gate) * sqrt(variance):
            self.withheld = 0
        elif isfinite(y) and self.withheld >= TUNING.gate_lasts:
            return False
        else:
            self.withheld += 1
        return self.withheld > 0

    def _compare(self, y: float, S: float) -> None:
        """Hold an innovation of variance ``S`` against the model."""
        weight = self.steady.dt_s / TUNING.drift_s
        self._drift += weight * (min(max(y / sqrt(S), -TUNING.gate), TUNING.gate) - self._drift)
        ratio = self._drift**2 / (weight / (2.0 - weight))
        self.surprise += self.steady.dt_s / TUNING.surprise_s * (ratio - self.surprise)

    def _settle(self) -> None:
        assert self.P is not None
        if self.gauge is not None or self.rate is not None:
            return  # The laser knows more than the steady filter will ever, and of a drift less is known.
        if float(np.max(np.abs(np.diag(self.P) / self._steady_variances - 1.0))) < TUNING.steady:
            self.P = None


def _symmetric(P: Array) -> Array:
    return np.asarray(0.5 * (P + P.T))
