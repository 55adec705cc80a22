"""Lead and gain between the heave estimate and the laser.

Zhang et al. 2022, section 3.2: the lead phase of the inertial displacement comes from comparing it with the laser. The
cross-spectrum phase at the dominant frequency is taken in the time domain, as the regression of the laser on the
observer's position and velocity (its in-phase and quadrature parts): that needs no even sampling, so a laser that is
there only sometimes gives as sound an answer as one that never fails.

The sign of m in eq. (14) is explicit here: a positive lead means that the estimate is early and must be moved back.
"""

from __future__ import annotations

from math import atan2, exp, hypot, inf, pi, remainder
from typing import Annotated, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Params(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[heave.lead]``: the comparison of the observer with the laser."""

    enabled: bool = True
    window_s: Annotated[float, msgspec.Meta(ge=20, le=600)] = 60.0
    """Length of the comparison."""
    refresh_s: Annotated[float, msgspec.Meta(ge=1, le=600)] = 10.0
    min_laser_s: Annotated[float, msgspec.Meta(ge=5, le=600)] = 25.0
    """Seconds of laser that a comparison needs."""
    min_coherence: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.7
    """Share of the laser's variance that the observer explains; below it nothing is learned."""
    max_std_s: Annotated[float, msgspec.Meta(gt=0, le=1)] = 0.1
    """Standard error above which a comparison is not believed."""
    time_constant_s: Annotated[float, msgspec.Meta(ge=0, le=3600)] = 60.0
    """Of the first-order update; the first comparisons are averaged."""
    limit_s: Annotated[float, msgspec.Meta(gt=0, le=5)] = 1.0
    """Bound on what is learned, either sign; a laser that shows more is of the wrong sign, or of something else."""
    gain_limit: Annotated[float, msgspec.Meta(ge=0, le=0.5)] = 0.1
    """Bound on the scale error of the accelerometer that is learned; 0: none is."""


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What a comparison must be to be one of sensors."""

    still: float = 1e-9
    """Share of a reading below which its variation is the rounding of a constant: no laser resolves 12 nm at 12 m."""
    least_readings: int = 8
    """Of four unknowns."""
    worst_condition: float = 1e12
    """Of the normal equations; beyond, the estimate carries no motion."""
    gain_coherence: float = 0.98
    """A gain is learned only where the observer follows the laser that well: noise in the observer makes it look too
    large."""
    opposed_periods: float = 0.35
    """A laser of the wrong sign is half a period off; no sensor is a third of one late."""
    sensors_s: float = 0.5
    """A low-pass of 1 Hz makes a sensor 0.23 s late, a slow bus and its polling as much again: beyond is something
    else."""
    unlike: float = 2.0
    """Gain, either way, of no sensor: for an observer whose own gain is not exactly one."""
    least_gain_limit: float = 0.1
    """Where no scale is to be learned, one that is off by this is still that of a sensor."""
    surely: float = 2.0
    """Standard errors by which a gain must be beyond its bound."""
    alike: float = 0.1
    """A gain is that of a unit when it is as near to it."""


TUNING: Final = Tuning()
OPPOSED: Final = "it moves against the heave: sign?"
UNITS: Final = ((1000.0, "mm"), (100.0, "cm"), (39.37, "inches"), (3.281, "feet"))
"""What lasers show distances in, per metre."""


def of_gain(gain: float) -> str:
    """That a laser shows the heave with another scale, and what is likely."""
    unit = next((name for ratio, name in UNITS if abs(gain / ratio - 1.0) < TUNING.alike), "")
    shown = f"{gain:.0f}" if gain > 99.5 else f"{gain:.3g}"
    return f"it shows {shown} times the heave: {f'is it in {unit}?' if unit else 'scale?'}"


def of_lead(lead_s: float) -> str:
    """That a laser shows the heave of another moment, and what is likely."""
    return f"it is {abs(lead_s):.2g} s {'behind' if lead_s > 0.0 else 'ahead of'} the accelerometer: latency_ms?"


class Comparison(msgspec.Struct, frozen=True):
    """How the estimate stands to the laser over one window."""

    lead_s: float
    """Positive: the estimate is early."""
    lead_std_s: float
    gain: float
    """Laser over estimate."""
    coherence: float
    """0..1: share of the laser's variance that the shifted, scaled estimate explains."""
    omega_radps: float = 0.0
    """Where the phase was taken; 0: not known."""
    gain_std: float = inf

    def beyond(self, design_lead_s: float) -> float:
        """Lead that the chain's own design does not explain, s: a phase, known but for whole turns."""
        lead_s = self.lead_s - design_lead_s
        return remainder(lead_s, 2.0 * pi / self.omega_radps) if self.omega_radps > 0.0 else lead_s

    def is_opposed(self, design_lead_s: float = 0.0) -> bool:
        """Whether the laser moves down where the estimate moves up."""
        return abs(self.beyond(design_lead_s)) * self.omega_radps > 2.0 * pi * TUNING.opposed_periods


def compare(t_s: Array, heave_m: Array, velocity_mps: Array, laser_m: Array, omega_radps: float) -> Comparison | None:
    """Regress the laser (n,) on heave (n,) and velocity (n,), besides a constant and a slope.

    With laser = A heave + B velocity the gain is |A - j B omega| and the lead its phase over omega. The standard errors
    count one independent sample per half period, not one per reading: the residual is as narrow-banded as the sea.
    A laser that shows only the middle of the waves sees much of the velocity and little of the heave: each coefficient
    has its own.
    None: too few readings, or a window in which the estimate or the laser carries no motion.
    """
    n = len(t_s)
    if n < TUNING.least_readings:
        return None
    span = t_s[-1] - t_s[0]
    ramp = (t_s - np.mean(t_s)) / max(span, 1e-9)
    columns = np.column_stack((heave_m, velocity_mps / omega_radps, np.ones(n), ramp))
    normal = columns.T @ columns
    if np.linalg.cond(normal) > TUNING.worst_condition:
        return None
    coefficients = np.linalg.solve(normal, columns.T @ laser_m)
    residual = laser_m - columns @ coefficients
    background = columns[:, 2:]
    still = laser_m - background @ np.linalg.lstsq(background, laser_m, rcond=None)[0]
    total = float(still @ still)
    if total <= n * (TUNING.still * float(np.max(np.abs(laser_m)))) ** 2:
        return None
    A, B = float(coefficients[0]), float(coefficients[1])
    independent = max(2.0, span * omega_radps / pi)
    gain = max(hypot(A, B), 1e-9)
    # Of A and B, for a residual of which so few are independent, along the phasor (A, B) and across it.
    turned = np.zeros((4, 2))
    turned[:2] = np.array(((A, -B), (B, A))) / gain
    variances = np.einsum("ij,ij->j", turned, np.linalg.solve(normal, turned))
    along_std, across_std = np.sqrt(np.maximum(variances * float(residual @ residual) / independent, 0.0)).tolist()
    return Comparison(
        lead_s=atan2(-B, A) / omega_radps,
        lead_std_s=across_std / gain / omega_radps,
        gain=gain,
        coherence=max(0.0, 1.0 - float(residual @ residual) / total),
        omega_radps=omega_radps,
        gain_std=along_std,
    )


class LeadTracker:
    """The slow, bounded estimate of the lead that the chain's own design does not explain (sensor, bus, latency).

    Attributes:
        learned_std_s, gain_std: standard errors of lead and gain as they are in use; 0 before anything is learned. The
            windows overlap: an average is taken to be no surer than they are.
        refused: why the last comparison was not that of a laser that shows the heave, for people; else empty.
    """

    def __init__(self, params: Params) -> None:
        self._params = params
        self.learned_s = self.learned_std_s = 0.0
        self.gain, self.gain_std = 1.0, 0.0
        self.updates = 0
        self._gains = 0
        self.last: Comparison | None = None
        self.refused = ""
        self._weight = 1.0 - exp(-params.refresh_s / params.time_constant_s) if params.time_constant_s > 0.0 else 1.0

    def update(
        self,
        comparison: Comparison | None,
        design_lead_s: float,
        *,
        has_true_gain: bool = False,
        may_learn: bool = True,
        unsure: float = 0.0,
    ) -> bool:
        """Take a comparison of the unshifted observer; False when it is not good enough to learn from.

        has_true_gain: the observer's amplitude is that of its sensor, so that a gain which the laser shows is the
        sensor's. (The harmonic observer has a gain of its own.) may_learn: whether it is known where the laser is; a
        laser that shows something else than the heave is refused all the same. unsure: share of the heave that the
        laser's place may make of its own, steadily: what differs by no more from what is known is nothing to learn.
        """
        p = self._params
        self.last, self.refused = comparison, ""
        if comparison is None or comparison.coherence < p.min_coherence or comparison.lead_std_s > p.max_std_s:
            return False
        self.refused = self._misfit(comparison, design_lead_s, has_true_gain=has_true_gain)
        if self.refused or not may_learn:
            return False
        measured = comparison.beyond(design_lead_s)
        weight = max(self._weight, 1.0 / (1.0 + self.updates))
        if unsure == 0.0 or abs(measured - self.learned_s) * comparison.omega_radps > unsure:
            self.learned_s += weight * (measured - self.learned_s)
        self.learned_std_s += weight * (comparison.lead_std_s - self.learned_std_s)
        self.updates += 1
        if has_true_gain and comparison.coherence > TUNING.gain_coherence and p.gain_limit > 0.0:
            shown = min(max(comparison.gain, 1.0 - p.gain_limit), 1.0 + p.gain_limit)
            weight = max(self._weight, 1.0 / (1.0 + self._gains))
            if unsure == 0.0 or abs(shown - self.gain) > unsure:
                self.gain += weight * (shown - self.gain)
            self.gain_std += weight * (comparison.gain_std - self.gain_std)
            self._gains += 1
        return True

    def _misfit(self, shown: Comparison, design_lead_s: float, *, has_true_gain: bool) -> str:
        """Why a comparison is that of something else than the heave, or nothing."""
        p = self._params
        if shown.is_opposed(design_lead_s):
            return OPPOSED
        limit = 1.0 + max(p.gain_limit, TUNING.least_gain_limit) if has_true_gain else TUNING.unlike
        if (
            shown.gain - TUNING.surely * shown.gain_std > limit
            or shown.gain + TUNING.surely * shown.gain_std < 1.0 / limit
        ):
            return of_gain(shown.gain)
        measured = shown.beyond(design_lead_s)
        return of_lead(measured) if abs(measured) > p.limit_s else ""

    @property
    def remark(self) -> str:
        """For people: a lead beyond what sensors have, whether it is learned or refused."""
        if self.refused:
            return f"laser: {self.refused}"
        return f"laser: {of_lead(self.learned_s)}" if abs(self.learned_s) > TUNING.sensors_s else ""

    def error_std_m(self, heave_m: float, velocity_mps: float) -> float:
        """Standard deviation of what errors of gain and lead make of a heave: it grows and fades with the waves."""
        return hypot(self.gain_std * heave_m, self.learned_std_s * velocity_mps)

    def restore(self, learned_s: float, gain: float = 1.0) -> None:
        """Start from what an earlier run has learned; the next comparison outweighs half of it."""
        p = self._params
        self.learned_s = min(max(learned_s, -p.limit_s), p.limit_s)
        self.gain = min(max(gain, 1.0 - p.gain_limit), 1.0 + p.gain_limit)
        self.updates = self._gains = 1
