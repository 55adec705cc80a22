"""The comparison: each reading of an existing MRU against our motion at that very moment, and what comes of it.

Our frames are kept for some seconds, since a telegram is late, and every fifth of a second for as long as the window. A
reading that is of a moment after our last frame waits for the next.
"""

from __future__ import annotations

from collections import deque
from enum import StrEnum
from math import asin, cos, degrees, floor, hypot, inf, isfinite, nan, pi, radians, remainder, sin
from typing import Annotated, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common.ring import History, RingBuffer
from heaved.estimation.reference_mru.agreement import LAGS, STEP_S, Agreement, agree
from heaved.samples import Fault, HeaveState, MotionFrame, MruAgreement, MruComparison, MruSample

Array = NDArray[np.float64]


class HeavePositive(StrEnum):
    """Which way the MRU's heave and its velocity count."""

    UP = "up"
    DOWN = "down"


class RollConvention(StrEnum):
    """What the MRU calls roll on a pitched vessel."""

    TAIT_BRYAN = "tait_bryan"
    """The angle about the vessel's own longitudinal axis, after heading and pitch."""
    TSS = "tss"
    """The elevation of the transverse axis."""


class Params(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[reference_mru]``: what the MRU tells, and how well."""

    point: str = ""
    """Name of the monitoring point whose heave it tells; empty: the IMU."""
    heave_positive: HeavePositive = HeavePositive.UP
    roll_convention: RollConvention = RollConvention.TAIT_BRYAN
    window_s: Annotated[float, msgspec.Meta(ge=60, le=600)] = 300.0
    heave_error_m: Annotated[float, msgspec.Meta(gt=0, le=10)] = 0.05
    """Standard deviations that its maker promises: of the heave the greater of this"""
    heave_error_ratio: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.05
    """and this share of the heave,"""
    angle_error_deg: Annotated[float, msgspec.Meta(gt=0, le=45)] = 0.2
    """and of roll and pitch."""


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What is set by us, not by the user."""

    refresh_s: float = 1.0
    """Interval of the statistics, one quantity after the other: ten minutes of one take a millisecond."""
    compare_s: float = 0.1
    """At most so often is there a new comparison."""
    least_s: float = 60.0
    """Nothing is judged before: some seven waves."""
    longest_gap_s: float = 1.0
    """Between two frames; our motion further apart is no straight line, and not known."""
    kept_s: float = 4.0
    """Frames, for readings that come late: latency_ms may be a second, a gateway takes as much again."""
    most_frames_hz: float = 250.0
    most_waiting: int = 400
    """Readings that are of moments after our last frame: 100 a second, for as long as they are kept."""
    beyond: float = 2.0
    """A difference so many times as large as is explained is a divergence: over a minute of waves a standard deviation
    is known to some 20 %."""
    opposed: float = -0.5
    """Correlation from which it counts the other way,"""
    alike: float = 0.8
    """and below which delay and scale say nothing."""
    late_s: float = 0.1
    """A delay from which it is worth saying,"""
    off: float = 0.15
    """and a scale."""
    most: float = 1e5
    """Metres, m/s and radians beyond which a number is none, whatever its unit was meant to be."""
    still: float = 0.02
    """It stands still when it moves by less than that share of ours."""


TUNING: Final = Tuning()
_QUANTITIES: Final = ("heave", "heave_velocity", "roll", "pitch", "yaw")
_HEAVE, _VELOCITY, _ROLL, _PITCH, _YAW = range(len(_QUANTITIES))
_ANGLES: Final = (_ROLL, _PITCH, _YAW)
_USABLE: Final = (HeaveState.VALID, HeaveState.DEGRADED)
_N: Final = len(_QUANTITIES)
_NOTHING: Final = (nan,) * (_N + 1)


class ReferenceMru:
    """Compares.

    Attributes:
        comparison: the newest; None: none yet.
        is_awake: a reading has come; without one nothing is kept.
    """

    def __init__(self, params: Params) -> None:
        self._params = params
        self.comparison: MruComparison | None = None
        self.is_awake = False
        self._frames = History(round(TUNING.kept_s * TUNING.most_frames_hz))
        """(time, the quantities, standard deviation of the heave)."""
        self._last: tuple[float, ...] = (-inf, *_NOTHING)
        self._yaw_rad = nan
        """The last one that was known, turns counted."""
        rows = round(params.window_s / STEP_S) + 2 * LAGS + 2
        self._own = RingBuffer(rows, 1 + _N)
        """Ours, at multiples of STEP_S, none left out."""
        self._own_k = -1
        """Of the last one, in steps; -1: there is none."""
        self._pairs = RingBuffer(rows, 2 + 2 * _N)
        """(time, the reference, ours, standard deviation of our heave), no closer than STEP_S."""
        self._waiting: deque[MruSample] = deque(maxlen=TUNING.most_waiting)
        self._read_s = self._paired_s = -inf
        self._refreshed_s = nan
        self._turn = 0
        self._agreements = [Agreement()] * _N
        self._explained = [nan] * _N
        self._divergences = [""] * _N
        self._compared_s = 0.0
        self._warnings: tuple[str, ...] = ()

    # --- input -------------------------------------------------------------------------------------------------------

    def push(self, sample: MruSample) -> None:
        """A reading; one that is faulty, not later than the last, or of a moment far ahead is passed over."""
        is_first, latest_s = not self.is_awake, self._last[0] + TUNING.kept_s
        if sample.fault is not Fault.NONE or not self._read_s < sample.t_s < (inf if is_first else latest_s):
            return
        self.is_awake = True
        if is_first:
            return  # There is nothing of ours yet to compare it with.
        self._read_s = sample.t_s
        self._waiting.append(sample)
        self._serve()

    def push_frame(self, frame: MotionFrame) -> None:
        """Our own motion."""
        if not self.is_awake or not self._last[0] < frame.t_s < inf:
            return
        row = (frame.t_s, *self._motion(frame))
        before, self._last = self._last, row
        if row[0] - before[0] > TUNING.longest_gap_s:
            # Nothing is known between the two: a row of nothing keeps others from drawing a line.
            before = (0.5 * (max(before[0], row[0] - 2.0 * TUNING.longest_gap_s) + row[0]), *_NOTHING)
            self._frames.push(before)
        self._frames.push(row)
        self._keep(before, row)
        self._serve()
        if not row[0] - self._refreshed_s < TUNING.refresh_s:
            self._refreshed_s = row[0]
            self._refresh(row[0])

    def _motion(self, frame: MotionFrame) -> tuple[float, ...]:
        """Heave and velocity where the MRU tells them, at the frame's own time, angles, and the heave's deviation."""
        at = frame if frame.now is None else frame.now
        heave, velocity, std = at.heave_m, at.heave_velocity_mps, at.heave_std_m
        is_usable = frame.quality.heave in _USABLE and (frame.now is not None or frame.compensation_lead_s == 0.0)
        if self._params.point:
            point = next((one for one in at.points if one.name == self._params.point), None)
            is_usable &= point is not None and point.state in (None, *_USABLE)
            if point is not None:
                heave, velocity, std = point.heave_m, point.heave_velocity_mps, point.heave_std_m
        if not is_usable:
            heave = velocity = std = nan
        yaw = frame.yaw_rad
        if isfinite(yaw):
            if isfinite(self._yaw_rad):
                yaw = self._yaw_rad + remainder(yaw - self._yaw_rad, 2.0 * pi)
            self._yaw_rad = yaw
        return heave, velocity, frame.roll_rad, frame.pitch_rad, yaw, std

    def _keep(self, before: tuple[float, ...], row: tuple[float, ...]) -> None:
        """Ours at the multiples of STEP_S that lie after ``before`` and not after ``row``."""
        first, last = floor(before[0] / STEP_S) + 1, floor(row[0] / STEP_S)
        if first > last:
            return
        if len(self._own):
            if first - self._own_k > self._params.window_s / STEP_S:
                self._own.clear()
                self._own_k = first - 1
            for k in range(self._own_k + 1, first):
                self._own.push((k * STEP_S, *_NOTHING[:_N]))
        self._own_k = last
        for k in range(first, last + 1):
            share = (k * STEP_S - before[0]) / (row[0] - before[0])
            values = [(1.0 - share) * a + share * b for a, b in zip(before[1 : 1 + _N], row[1 : 1 + _N], strict=True)]
            self._own.push((k * STEP_S, *values))

    # --- one reading against ours ------------------------------------------------------------------------------------

    def _serve(self) -> None:
        """Compare the readings that are of moments up to our last frame."""
        while self._waiting and self._waiting[0].t_s <= self._last[0]:
            self._compare(self._waiting.popleft())

    def _compare(self, sample: MruSample) -> None:
        own = self._frames.at(sample.t_s)
        if own is None:
            return
        reference = self._as_ours(sample)
        for i in _ANGLES:
            # Alike but for whole turns.
            reference[i] = own[1 + i] + remainder(reference[i] - own[1 + i], 2.0 * pi) if isfinite(own[1 + i]) else nan
        t_s = sample.t_s
        if t_s - self._paired_s >= STEP_S:
            self._paired_s = t_s
            self._pairs.push((t_s, *reference, *own[1:]))
        if self.comparison is not None and t_s - self.comparison.t_s < TUNING.compare_s:
            return
        said = [self._said(i, reference[i], own[1 + i]) for i in range(_N)]
        self.comparison = MruComparison(
            t_s=t_s,
            compared_s=self._compared_s,
            warnings=self._warnings,
            **dict(zip(_QUANTITIES, said, strict=True)),
        )

    def _as_ours(self, sample: MruSample) -> list[float]:
        """In our signs and conventions."""
        sign = -1.0 if self._params.heave_positive is HeavePositive.DOWN else 1.0
        roll, pitch = sample.roll_rad, sample.pitch_rad
        is_tss = self._params.roll_convention is RollConvention.TSS
        if is_tss and abs(roll) < 0.5 * pi and abs(pitch) < 0.5 * pi:
            # sin(roll told) = sin(roll) cos(pitch); a pair that cannot be is left at its limit.
            roll = asin(min(max(sin(roll) / cos(pitch), -1.0), 1.0))
        told = (sign * sample.heave_m, sign * sample.heave_velocity_mps, roll, pitch, sample.yaw_rad)
        return [value if abs(value) < TUNING.most else nan for value in told]

    def _said(self, i: int, reference: float, own: float) -> MruAgreement:
        found = self._agreements[i]
        return MruAgreement(
            reference=reference,
            own=own,
            difference=reference - own,
            mean_difference=found.mean,
            std_difference=found.std,
            rms_difference=found.rms,
            explained=self._explained[i],
            correlation=found.correlation,
            delay_s=found.delay_s,
            scale=found.scale,
        )

    # --- all of the window -------------------------------------------------------------------------------------------

    def _refresh(self, t_s: float) -> None:
        """The statistics of the quantity whose turn it is, and what all of them say."""
        i, self._turn = self._turn, (self._turn + 1) % _N
        pairs, grid = self._pairs.since(t_s - self._params.window_s), self._own.last(len(self._own))
        found, self._compared_s = Agreement(), 0.0
        if len(pairs) and len(grid) > 2 * LAGS + 1:
            times = pairs[:, 0]
            self._compared_s = float(np.sum(np.minimum(np.diff(times), TUNING.longest_gap_s)))
            found = agree(pairs[:, 1 + i], pairs[:, 1 + _N + i], _moved(times, grid[:, 0], grid[:, 1 + i]))
        self._agreements[i] = found
        self._explained[i] = self._explained_of(i, found, pairs[:, 1 + 2 * _N])
        is_enough = found.pairs * self._compared_s >= TUNING.least_s * max(len(pairs), 1)
        self._divergences[i] = _divergence(i, found, self._explained[i], self._compared_s) if is_enough else ""
        self._warnings = tuple(text for text in self._divergences if text)

    def _explained_of(self, i: int, found: Agreement, stds_m: Array) -> float:
        """Standard deviation of a difference that the errors of both explain; nan: nobody says."""
        p = self._params
        if i == _HEAVE:
            known = stds_m[np.isfinite(stds_m)]
            own_m = float(np.sqrt(np.mean(known**2))) if len(known) else nan
            return hypot(own_m, max(p.heave_error_m, p.heave_error_ratio * found.own_std))
        return radians(p.angle_error_deg) if i in (_ROLL, _PITCH) else nan


def _moved(times: Array, grid_s: Array, values: Array) -> Array:
    """Ours (2 LAGS + 1, n) at ``times`` (n,) plus each lag, of ``values`` at ``grid_s``, STEP_S apart; nan outside."""
    place = (times - grid_s[0]) / STEP_S
    first = np.floor(place).astype(np.int64)
    share = place - first
    index = first + np.arange(-LAGS, LAGS + 1)[:, np.newaxis]
    is_inside = (index >= 0) & (index + 1 < len(grid_s))
    index = np.where(is_inside, index, 0)
    found: Array = np.where(is_inside, (1.0 - share) * values[index] + share * values[index + 1], nan)
    return found


def _divergence(i: int, found: Agreement, explained: float, compared_s: float) -> str:
    """What there is to say of a quantity; empty: it agrees within what is known."""
    if not found.std > TUNING.beyond * explained:
        return ""
    if i == _HEAVE:
        off, known = f"{found.std:.2f} m", f"{explained:.2f} m"
    else:
        off, known = f"{degrees(found.std):.2f}°", f"{degrees(explained):.2f}°"
    text = f"reference MRU: {_QUANTITIES[i]} differs by {off} RMS over {compared_s:.0f} s, both explain {known}"
    return f"{text}{_cause(i, found)}"


def _cause(i: int, found: Agreement) -> str:
    """What is likely."""
    is_heave, late_s = i == _HEAVE, found.delay_s
    if found.reference_std < TUNING.still * found.own_std:
        cause = "it stands still"
    elif found.own_std < TUNING.still * found.reference_std:
        cause = "ours stands still"
    elif found.correlation < TUNING.opposed:
        cause = f"it counts the other way ({'heave_positive' if is_heave else 'sign in its profile'}?)"
    elif not found.correlation > TUNING.alike:
        cause = "they do not move alike" + (" (point?)" if is_heave else "")
    elif abs(late_s) > TUNING.late_s:
        cause = f"it is {abs(late_s):.2g} s {'late' if late_s > 0.0 else 'early'} (latency_ms, or its own filter)"
    elif abs(found.scale - 1.0) > TUNING.off:
        cause = f"it moves {found.scale:.3g} times as much as ours"
    else:
        return ""
    return f": {cause}"
