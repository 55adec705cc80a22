"""Heave near the last sample, as the filter in use has it, and how far that can be trusted.

A sample's own heave, what it is for a compensator some tenths of a second later, and the forecasts are all the filter's
state moved in time (:mod:`heaved.estimation.heave.sea.propagate`). The filter steps once per mean of some samples. What
does not change before it steps again is made ready once: for each moment that is always asked for, the series that
reaches from the filter's time to any sample before its next step, and the standard deviation, to the next half of a
step. A sample then costs the series at its own age. For any other moment all of it is worked out.
"""

from __future__ import annotations

from functools import cached_property
from math import exp, hypot, inf, isfinite, log, nan, sqrt
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.heave.observer import UNKNOWN, Motion, foretold, nothing_foretold
from heaved.estimation.heave.sea import batch_filter
from heaved.estimation.heave.sea.missed import MissedInnovations
from heaved.estimation.heave.sea.mistakes import TUNING as MISTAKES
from heaved.estimation.heave.sea.propagate import ORDER, Propagation, along
from heaved.samples import HeaveForecast

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.estimation.heave.sea.filter import SeaFilter
    from heaved.estimation.heave.sea.joint import JointCorrection
Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of what is published."""

    stale_s: float = 1.0
    """Samples that come without a step of the filter for this long are not in the heave any more."""
    margin_s: float = 3.0
    """Beyond the longest horizon: how early a sensor may be, and the age of the state."""
    converged: float = batch_filter.TUNING.unsure
    """The covariance has converged when the error of the heave is within this factor of that of the steady filter."""
    sure: float = 1.25
    """Up to this factor roll and pitch correct the heave: a single reading that is missing, or some tenths of a second,
    do not end that for a minute."""
    time_s: float = 1.5
    """Time constant T of the change from one model to the next."""
    least_m: float = 1e-5
    """It is over when less than that is left."""
    response_s: float = 400.0
    """Of the filter's answer to an impulse: nothing is left of it then."""
    foretells: float = 1.5
    """A forecast whose standard deviation is more than so many of the heave itself foretells nothing: to know the sea
    alone is more. It is left out, if it is more than this, too."""
    little_m: float = 0.05
    recovering: float = 0.2
    """Share of the heave that its error is more than while the filter finds its way back after a gap."""


TUNING: Final = Tuning()
IMPULSE_BLOCK: Final = 64
"""Samples of an impulse's answer that are taken together."""


class BumplessTransfer:
    """From one model to the next without a jump: the difference between the two at the change is faded out.

    Heave and velocity differ by h and v at the change; with e the time since,

        d(e) = (h + (v + h/T) e) exp(-e/T),

    critically damped, takes both to zero without an edge in either.

    Attributes:
        until_s: from then on it is nothing.
    """

    def __init__(self, heave_m: float, velocity_mps: float, since_s: float) -> None:
        """A difference of heave (m) and velocity (m/s) at ``since_s``."""
        self._heave_m, self._slope_mps = heave_m, velocity_mps + heave_m / TUNING.time_s
        self._since_s = since_s
        lasts = 1.0  # time constants, from (|h| + |v + h/T| e) exp(-e/T) = least_m
        for _ in range(20):
            most_m = abs(heave_m) + abs(self._slope_mps) * TUNING.time_s * lasts
            lasts = log(max(most_m / TUNING.least_m, 1.0)) if most_m < inf else 0.0
        self.until_s = since_s + lasts * TUNING.time_s

    def at(self, t_s: float) -> tuple[float, float]:
        """What is left at ``t_s``: heave and velocity."""
        if not t_s < self.until_s:
            return 0.0, 0.0
        elapsed_s = max(t_s - self._since_s, 0.0)
        left_m, fade = self._heave_m + self._slope_mps * elapsed_s, exp(-elapsed_s / TUNING.time_s)
        return left_m * fade, (self._slope_mps - left_m / TUNING.time_s) * fade


NO_TRANSFER: Final = BumplessTransfer(0.0, 0.0, -inf)


class Stds(msgspec.Struct, frozen=True, eq=False):
    """Standard deviations of the heave's error by the model, at some age of the state."""

    ahead_m: list[float]
    """(H,) of the forecasts."""
    near_m: list[float]
    """Now, and after the lead."""


class SeaHeave:
    """Heave from one model's filter. Say :meth:`moved` whenever the state of that has changed.

    Attributes:
        filter: whose state it is.
        scale: published over modelled standard deviation.
        transfer: from the model before.
        joint, joint_weight: what roll and pitch add, if anything, and how much of that is taken.
        joint_shown: standard deviation with them over that without, as it was of late; infinite: they are not trusted,
            and what they add fades out.
        steady_std_m: standard deviation of the error of its heave once the filter is steady.
        sea_std_m: standard deviation of the heave of the fitted sea.
        omega_radps: mean frequency of the heave, standard deviation of its velocity over that of itself.
    """

    def __init__(self, f: SeaFilter, horizons_s: tuple[float, ...], lead_s: float) -> None:
        """``horizons_s``, ``lead_s``: the moments after a sample that are always asked for."""
        system = f.system
        self.filter = f
        self.scale = 1.0
        self.transfer = NO_TRANSFER
        self.joint: JointCorrection | None = None
        self._missed: MissedInnovations | None = None
        self.joint_weight = 0.0
        self.joint_shown = 1.0
        self.sea_std_m = _std(system.heave, system.stationary)
        self.omega_radps = _std(system.velocity, system.stationary) / self.sea_std_m
        self._propagation = Propagation(system, max((*horizons_s, lead_s, 0.0)) + TUNING.margin_s)
        self._steady_stds: list[float] = self._propagation.stds(f.steady_covariance).tolist()
        self.steady_std_m = _std(system.heave, f.steady_covariance)
        self._horizons_s, self._count = horizons_s, len(horizons_s)
        self._unknown = nothing_foretold(horizons_s)
        self._shifts_s = (*horizons_s, 0.0, lead_s)
        self._places = {0.0: 0, lead_s: 1}
        self._plain_row = self._propagation.derivatives((0.0,))[0]
        self._steady_by_age: dict[int, Stds] = {}
        self._learned_s = nan
        self._disturbed_m2 = 0.0
        self._mistaken_m2 = 0.0
        self._response: tuple[Array, Array] = (np.empty(0), np.empty(0))
        self.moved()

    def moved(self) -> None:
        """The filter's state has changed, and with it all that was made ready."""
        self._near: list[list[float]] = []
        self._unshifted: list[float] = []
        self._state_series: Array | None = None
        self._by_age: dict[int, Stds] = {}

    def set_lead(self, learned_s: float) -> None:
        """How early the sensor has been found to be, which is taken out of :meth:`at` and :meth:`forecast`."""
        if learned_s != self._learned_s:
            self._learned_s = learned_s
            rows = self._propagation.derivatives([shift - learned_s for shift in self._shifts_s])
            self._rows = rows.reshape(-1, rows.shape[2])
            self._steady_by_age = {}
            self.moved()

    def disturb(self, f_hz: Array, psd: Array) -> None:
        """The acceleration has noise that the model knows nothing of, of one-sided density ``psd`` (n,), (m/s2)2/Hz, at
        ``f_hz`` (n,), evenly spaced: what the steady filter makes of it is in every standard deviation from now on.
        """
        if not np.array_equal(f_hz, self._response[0]):
            self._response = f_hz, _power_response(self.filter, f_hz)
        self._disturbed_m2 = float((f_hz[1] - f_hz[0]) * psd @ self._response[1])
        self._steady_by_age, self._by_age = {}, {}

    @cached_property
    def answer(self) -> Array:
        """(n,) heave that the steady filter makes of an acceleration of 1 m/s2 that lasted for a row, so many rows ago
        (:mod:`heaved.estimation.heave.sea.mistakes`).
        """
        within, starts = _impulse(self.filter)
        dt_s, row_s = self.filter.steady.dt_s, MISTAKES.row_s
        until = np.append(0.0, np.cumsum(np.array(starts) @ np.array(within).T))
        return np.diff(np.interp(np.arange(0.0, MISTAKES.reach_s, row_s), dt_s * np.arange(len(until)), until))

    @property
    def mistaken_m2(self) -> float:
        """Mean square of what errors of the acceleration, whose shape is known, make of the heave now."""
        return self._mistaken_m2

    @mistaken_m2.setter
    def mistaken_m2(self, square_m2: float) -> None:
        # A laser that aids takes it out.
        square_m2 = square_m2 if self.filter.gauge is None else 0.0
        if square_m2 != self._mistaken_m2:
            self._mistaken_m2 = square_m2
            self._steady_by_age, self._by_age = {}, {}

    # --- heave -------------------------------------------------------------------------------------------------------

    def at(self, t_s: float, shift_s: float) -> Motion:
        """Heave ``shift_s`` after a sample at ``t_s``; nan when the filter has not stepped for too long."""
        late = t_s - self.filter.t_s
        if not late <= TUNING.stale_s:
            return UNKNOWN
        place = self._places.get(shift_s)
        if place is not None:
            motion = along((self._near or self._made_ready())[place], late)
        else:
            if self._state_series is None:
                self._state_series = self._propagation.series(self.filter.x)
            motion = self._propagation.along(self._state_series, shift_s - self._learned_s + late)
        if self.joint is not None and self.joint_weight > 0.0:
            motion = self._joined(motion, shift_s - self._learned_s + late)
        if t_s < self.transfer.until_s:
            heave_m, velocity_mps = self.transfer.at(t_s + shift_s)
            motion = Motion(motion.heave_m + heave_m, motion.velocity_mps + velocity_mps)
        return motion

    def join(self, joint: JointCorrection) -> None:
        """From now on with what roll and pitch add by that."""
        self.joint = joint
        self._missed = MissedInnovations(self.filter.steady, self.filter.system.H, joint.amended)

    def push_joint(self, t_s: float, missed: int, innovation: float, angles_rad: Sequence[float]) -> None:
        """Tell it of a sample: innovation (m/s2), roll and pitch; ``missed`` before it were not there."""
        if self.joint is None or self._missed is None:
            return
        dt_s = self.filter.steady.dt_s
        for i in range(missed, 0, -1):
            self.joint.push(t_s - i * dt_s, 0.0, nan, nan)
        self._missed.miss(missed)
        self.joint.push(t_s, innovation, *angles_rad)
        amended = self._missed.step(innovation)
        if len(amended):
            self.joint.amend(amended)

    def _joined(self, motion: Motion, tau_s: float) -> Motion:
        """With what roll and pitch add ``tau_s`` after the filter's state."""
        if self.joint is None or self.joint_weight == 0.0:
            return motion
        more_m, more_mps = self.joint.at(tau_s)
        weight = self.joint_weight
        return Motion(motion.heave_m + weight * more_m, motion.velocity_mps + weight * more_mps)

    def _joined_std(self, std_m: float, tau_s: float) -> float:
        """What that is of the heave with roll and pitch, ``tau_s`` after the filter's state."""
        if self.joint is None or self.joint_weight == 0.0:
            return std_m
        if self.joint_shown == inf:
            return hypot(std_m, self.joint_weight * self.joint.at(tau_s)[0])
        # They tell as much as ever: what less is known of the state than when it is steady is not less for them.
        usual = 1.0 if self.filter.is_steady else min((self.steady_std_m / self.state_std_m) ** 2, 1.0)
        ratio = sqrt(1.0 - usual * (1.0 - self.joint.ratio(tau_s, self.joint_shown) ** 2))
        std_m *= 1.0 - self.joint_weight * (1.0 - ratio)
        more_m = self.joint.at(tau_s)[0]
        doubted = self.joint.doubted(tau_s)
        return hypot(std_m, doubted * self.joint_weight * more_m) if doubted else std_m

    def unshifted(self, t_s: float, unaided: SeaFilter | None = None) -> Motion:
        """What the laser is compared with: nothing learned taken out, nothing left of another model. ``unaided``: the
        filter of the same model that no laser aids, if that is another one.
        """
        if unaided is not None:
            return along(self._plain_row.dot(unaided.x).tolist(), t_s - unaided.t_s)
        if not self._unshifted:
            self._unshifted = self._plain_row.dot(self.filter.x).tolist()
        late_s = t_s - self.filter.t_s
        return self._joined(along(self._unshifted, late_s), late_s)

    def forecast(self, t_s: float, scale: float = 1.0, gain: float = 1.0) -> tuple[HeaveForecast, ...]:
        """:meth:`at` and ``scale`` times :meth:`std_m` for all the horizons, both times ``gain``."""
        d = t_s - self.filter.t_s
        if not d <= TUNING.stale_s:
            return self._unknown
        if not self._near:
            self._made_ready()
        transfer = self.transfer if t_s < self.transfer.until_s else None
        modelled, whole = self.scale, gain * scale
        joint = self.joint if self.joint_weight > 0.0 else None
        most_m = max(TUNING.foretells * self.sea_std_m, TUNING.little_m)
        found = []
        for h, (c0, c1, c2, c3, c4, c5), modelled_m in zip(
            self._horizons_s, self._ahead, self._stds(d).ahead_m, strict=True
        ):
            heave_m = ((((c5 * d + c4) * d + c3) * d + c2) * d + c1) * d + c0
            left_m = 0.0 if transfer is None else transfer.at(t_s + h)[0]
            if joint is not None:
                tau_s = h - self._learned_s + d
                heave_m += self.joint_weight * joint.at(tau_s)[0]
                std_m = whole * hypot(self._joined_std(modelled * modelled_m, tau_s), left_m)
            else:
                std_m = whole * hypot(modelled * modelled_m, left_m)
            if std_m > most_m:
                found.append(HeaveForecast(horizon_s=h))
                continue
            found.append(foretold(h, gain * (heave_m + left_m), std_m))
        return tuple(found)

    def _made_ready(self) -> list[list[float]]:
        made: list[list[float]] = self._rows.dot(self.filter.x).reshape(-1, ORDER).tolist()
        self._ahead, self._near = made[: self._count], made[self._count :]
        return self._near

    # --- how far it can be trusted -----------------------------------------------------------------------------------

    def std_m(self, t_s: float, shift_s: float) -> float:
        """Standard deviation of the error of :meth:`at`: from the covariance of the filter, times :attr:`scale`."""
        late_s = t_s - self.filter.t_s
        if not late_s <= TUNING.stale_s:
            return nan
        place = self._places.get(shift_s)
        if place is not None:
            std_m = self._stds(late_s).near_m[place] * self.scale
        else:
            std_m = self._modelled_m(late_s, (shift_s,))[0] * self.scale
        if self.joint_weight > 0.0:
            std_m = self._joined_std(std_m, shift_s + late_s - (self._learned_s if isfinite(self._learned_s) else 0.0))
        if t_s < self.transfer.until_s:
            std_m = hypot(std_m, self.transfer.at(t_s + shift_s)[0])
        return std_m

    def _stds(self, late_s: float) -> Stds:
        """For what is always asked for, to the next half of the filter's step: nearer than that they are not known."""
        half_s = 0.5 * self.filter.steady.dt_s
        age = round(late_s / half_s)
        by_age = self._steady_by_age if self.filter.is_steady else self._by_age
        found = by_age.get(age)
        if found is None:
            modelled_m = self._modelled_m(age * half_s, self._shifts_s)
            found = by_age[age] = Stds(modelled_m[: self._count], modelled_m[self._count :])
        return found

    def _modelled_m(self, late_s: float, shifts_s: Sequence[float]) -> list[float]:
        """Standard deviation by the model, ``late_s`` after the state and so much later."""
        early_s = self._learned_s if isfinite(self._learned_s) else 0.0
        taus = [shift + late_s - early_s for shift in shifts_s]
        if self.filter.is_steady:
            stds_m = self._propagation.between(self._steady_stds, taus)
        else:
            stds_m = self._propagation.stds_at(self.filter.published_covariance, taus)
        more_m2 = max(self._disturbed_m2, self._mistaken_m2)
        return [sqrt(std_m * std_m + more_m2) for std_m in stds_m] if more_m2 else stds_m

    @property
    def disturbed_m(self) -> float:
        """Standard deviation of what noise makes of the heave that the model knows nothing of."""
        return sqrt(self._disturbed_m2)

    @property
    def state_std_m(self) -> float:
        """Standard deviation of the heave of the state itself, by the covariance alone."""
        return self.steady_std_m if self.filter.is_steady else _std(self.filter.system.heave, self.filter.covariance)

    @property
    def is_converged(self) -> bool:
        """Whether the covariance of the heave is near what it will be, and was before the last sample was taken in."""
        f = self.filter
        return f.innovation_variance <= TUNING.converged**2 * f.steady.S and self._is_within(TUNING.converged)

    @property
    def is_sure(self) -> bool:
        """Whether the covariance of the heave is so near what it will be that weights for the steady filter serve."""
        return self._is_within(TUNING.sure)

    def _is_within(self, factor: float) -> bool:
        return self.filter.is_steady or self.state_std_m < factor * self.steady_std_m

    @property
    def is_recovering(self) -> bool:
        """Whether a gap has cost so much of what was known that people should be told."""
        return not self.is_converged and self.state_std_m > TUNING.recovering * self.sea_std_m

    def row(self, t_s: float) -> tuple[Array, float]:
        """(n,) heave at ``t_s`` from the filter's state, and the variance (m2) that this misses of an earlier one."""
        tau_s = t_s - self.filter.t_s
        return self._propagation.row(tau_s), self._propagation.missed(tau_s)


def _power_response(f: SeaFilter, f_hz: Array) -> Array:
    """(n,) |heave|^2 that the steady filter makes of an acceleration of 1 m/s2 at each frequency: the transform of its
    answer to an impulse, heave L^k K with L = (I - K H) F, taken in two stages, within blocks and of them.
    """
    within, starts = _impulse(f)
    turns = -2j * np.pi * f.steady.dt_s * f_hz
    each = np.exp(np.outer(turns, np.arange(len(within)))) @ np.array(within)
    each *= np.exp(np.outer(turns, IMPULSE_BLOCK * np.arange(len(starts)))) @ np.array(starts)
    return np.asarray(np.abs(each.sum(axis=1)) ** 2)


def _impulse(f: SeaFilter) -> tuple[list[Array], list[Array]]:
    """The answer of the steady filter to an impulse: of the products of each of the second with each of the first."""
    steady, system = f.steady, f.system
    loop = steady.F - np.outer(steady.K, system.H @ steady.F)
    within, starts = [steady.K], [system.heave]
    for _ in range(1, IMPULSE_BLOCK):
        within.append(loop @ within[-1])
    block = np.linalg.matrix_power(loop, IMPULSE_BLOCK)
    for _ in range(round(TUNING.response_s / steady.dt_s / IMPULSE_BLOCK)):
        starts.append(starts[-1] @ block)
    return within, starts


def _std(row: Array, P: Array) -> float:
    return sqrt(max(float(row.dot(P).dot(row)), 0.0))
