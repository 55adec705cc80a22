"""The crane: how it stands and moves at any moment, from readings that come when they come."""

from __future__ import annotations

from collections import Counter
from math import inf, isfinite, nan, radians
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.estimation.crane.geometry import JOINTS, Params, Vector, needed, tip
from heaved.estimation.crane.joint import Joint
from heaved.samples import CraneSample, Fault, HeaveState

if TYPE_CHECKING:
    from collections.abc import Sequence

_ANGLES: Final = 3
_LINE: Final = 3
"""Index in :data:`JOINTS`; before it the angles."""
NAMES: Final = ("slew angle", "boom angle", "jib angle", "line out")


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What is set by us, not by the user."""

    late_periods: float = 2.5
    """Readings older than so many of their usual intervals are late: one that is lost is none yet,"""
    late_s: float = 0.25
    """nor are readings younger than this."""
    period_memory: float = 0.1
    """Weight of one interval in the usual one."""
    longest_period_s: float = 2.0
    """Further apart is no usual interval."""


TUNING: Final = Tuning()


class Place(msgspec.Struct, frozen=True, gc=False):
    """A place on the crane at one moment: metres in the axes of ``[crane] frame``, from where a point is measured."""

    at_m: Vector
    velocity_mps: Vector
    """Against the ship."""
    spread_m: tuple[Vector, ...]
    """One standard deviation of each joint, in what it does to the place."""
    hang_m: float = 0.0
    """It hangs so much plumb below that,"""
    hang_velocity_mps: float = 0.0
    """and so fast further down."""


class Worth(msgspec.Struct, frozen=True, gc=False):
    """What a place on the crane is worth; ``state`` None: nothing is wrong."""

    state: HeaveState | None = None
    reasons: tuple[str, ...] = ()


GOOD: Final = Worth()


class CraneEstimator:
    """Feed it every sample; it has its own clock of validity, that of the samples."""

    def __init__(self, params: Params) -> None:
        self._params = params
        angle_std, luff = radians(params.angle_std_deg), radians(params.max_luff_degps)
        slew = Joint(std=angle_std, fastest=radians(params.max_slew_degps), turns=True)
        boom, jib = (Joint(std=angle_std, fastest=luff, turns=True) for _ in range(2))
        line = Joint(std=params.line_std_m, fastest=params.max_hoist_mps * params.falls, turns=False)
        self._joints = (slew, boom, jib, line)
        zeros_deg = (params.slew_zero_deg, params.boom_zero_deg, params.jib_zero_deg)
        self._zeros = (*map(radians, zeros_deg), 0.0)
        self._fixed = tuple(nan if fixed is None else radians(fixed) for fixed in params.fixed_deg)
        self._needed = {hook: needed(params, hook=hook) for hook in (False, True)}
        self._moving = self._needed[True]
        self._t_s = nan
        self._period_s = nan

    def push(self, sample: CraneSample) -> None:
        """Take what the encoders say; a sample with a fault says nothing."""
        if sample.fault is not Fault.NONE:
            return
        readings = (sample.slew_rad, sample.boom_rad, sample.jib_rad, sample.line_out_m)
        for i in self._moving:
            self._joints[i].step(sample.t_s, readings[i] - self._zeros[i])
        interval_s = sample.t_s - self._t_s
        if interval_s <= 0.0:
            return
        self._t_s = sample.t_s
        if interval_s <= TUNING.longest_period_s:
            usual_s = self._period_s if isfinite(self._period_s) else interval_s
            self._period_s = usual_s + TUNING.period_memory * (interval_s - usual_s)

    def worth(self, t_s: float, *, hook: bool) -> Worth:
        """What the tip, or the hook, is worth at ``t_s``."""
        of_interest = self._needed[hook]
        ages_s = [t_s - self._joints[i].seen_s for i in of_interest]
        missing = [NAMES[i] for i, age_s in zip(of_interest, ages_s, strict=True) if not isfinite(age_s)]
        if missing:
            is_all = len(missing) == len(of_interest)
            told = "no reading of the crane yet" if is_all else f"no {', no '.join(missing)} from the crane"
            return Worth(HeaveState.INVALID, (told,))
        age_s = max(ages_s, default=-inf)
        period_s = self._period_s if isfinite(self._period_s) else 0.0
        if age_s <= max(TUNING.late_s, TUNING.late_periods * period_s):
            return GOOD
        are_as_old = max(ages_s) - min(ages_s) <= TUNING.late_s
        told = "crane angles" if are_as_old else NAMES[of_interest[ages_s.index(age_s)]]
        state = HeaveState.DEGRADED if age_s <= self._params.max_age_s else HeaveState.INVALID
        return Worth(state, (f"{told} {age_s:.1f} s old",))

    def places(self, t_s: float, offsets_m: Sequence[tuple[Vector, bool]]) -> tuple[Place, ...]:
        """Where some points are at ``t_s``, which may lie ahead: (outward, left, up) of the tip, or of the hook, that
        is whether it is of the hook. nan where a reading that it takes has never been.
        """
        states = [self._joint(i, t_s) for i in range(_ANGLES)]
        (slew, slew_rate, slew_std), (boom, boom_rate, boom_std), (jib, jib_rate, jib_std) = states
        line, line_rate, _ = self._joints[_LINE].at(t_s)
        falls = self._params.falls
        found = []
        for offset, is_hook in offsets_m:
            # The hook does not lean with the deck: what lies above it lies plumb above it.
            made = tip(self._params, slew, boom, jib, (0.0, 0.0, 0.0) if is_hook else offset)
            velocity = _sum(made.by_slew, slew_rate, made.by_boom, boom_rate, made.by_jib, jib_rate)
            spread = tuple([
                (x * std, y * std, z * std)
                for (x, y, z), std in ((made.by_slew, slew_std), (made.by_boom, boom_std), (made.by_jib, jib_std))
                if std > 0.0
            ])  # fmt: skip
            hang_m = line / falls + self._params.hook_below_m - offset[2] if is_hook else 0.0
            found.append(Place(made.at_m, velocity, spread, hang_m, line_rate / falls if is_hook else 0.0))
        return tuple(found)

    def _joint(self, i: int, t_s: float) -> tuple[float, float, float]:
        """Position, rate, standard deviation; one that is fixed is where it is, and a jib that is not there nowhere."""
        if isfinite(fixed := self._fixed[i]):
            return fixed, 0.0, 0.0
        return self._joints[i].at(t_s) if i in self._needed[False] else (0.0, 0.0, 0.0)

    @property
    def resets(self) -> Counter[tuple[str, str]]:
        """By (filter, reason): joints begun anew because their readings jumped, readings that were kept out."""
        found: Counter[tuple[str, str]] = Counter()
        for name, joint in zip(JOINTS, self._joints, strict=True):
            found["crane", f"{name} jumped"] += joint.jumps
            found["crane", "spike"] += joint.spikes
        return +found


def _sum(a: Vector, by_a: float, b: Vector, by_b: float, c: Vector, by_c: float) -> Vector:
    return (
        a[0] * by_a + b[0] * by_b + c[0] * by_c,
        a[1] * by_a + b[1] * by_b + c[1] * by_c,
        a[2] * by_a + b[2] * by_b + c[2] * by_c,
    )
