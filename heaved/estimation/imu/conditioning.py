"""What every sample of the IMU passes first: of each reading whether it is one, in what sense, and of which moment.

Accelerations, angles and body rates are judged separately, since what fails mostly fails alone: a register that hangs,
an attitude solution that is lost, a sensor slower than its neighbour. Only a sample whose accelerations cannot be true
is refused whole: such bytes are of something else, and the rest of them too. What is no reading is nan from here on.
"""

from __future__ import annotations

from math import inf, isfinite, nan, sin
from typing import Final

import msgspec

from heaved.estimation.common.bounds import ANGLE_RATE_RADPS, HEAVE_ACCELERATION_MPS2
from heaved.estimation.imu.attitude import Attitude
from heaved.estimation.imu.gates import AngleGate, SpikeGate, wrapped
from heaved.estimation.imu.measured_rate import MeasuredRate
from heaved.estimation.imu.mounting import SignWatch, UnitsWatch
from heaved.samples import GRAVITY_MPS2, Fault, ImuSample
from heaved.unchanged import StuckDetector

SIDEWAYS_MPS2: Final = 16.0
"""Specific force along the deck: that of HEAVE_ACCELERATION_MPS2 and of gravity at a heel of 55 degrees."""
SWAYS_MPS2: Final = 0.1
"""RMS of the acceleration along the deck from which the vessel moves, and its angles with it."""
UNLIKE: Final = 1.4142135623730951
"""Weight of pitch in a sum that does not stay the same when both angles change by steps of one register."""
LEANS_MPS2: Final = 2.0
"""The acceleration along the deck is that near to gravity's part in it, but for the worst of seas."""
CONSTANT_S: Final = 1.0
"""What has never been another value for so long is no slow sensor: a constant, as on a level bench."""
TOGETHER_S: Final = 0.1
"""Accelerations and angles no further apart are held against each other: a small part of a wave."""
NOTED_S: Final = 0.2
"""Reasons are renewed so often."""
STILL_STUCK_S: Final = 5.0
"""A sensor that has not shown a second reading for so long hangs."""


class Notes(msgspec.Struct, frozen=True, gc=False):
    """What there is to say of the IMU, beside the fault of a sample."""

    unusable: str = ""
    """Why nothing of it can be used."""
    signs: str = ""
    """What speaks against the signs of the angles."""
    are_signs_open: bool = False
    """It may still prove right."""
    remarks: tuple[str, ...] = ()
    """What people should know."""


NOTHING: Final = Notes()


class Conditioned(msgspec.Struct, frozen=True, gc=False):
    """A sample of the IMU after its readings have been judged."""

    sample: ImuSample
    """Roll and pitch are wrapped; what is no reading, or no new one, is nan. A fault of the device has no readings."""
    fault: Fault
    """Of the accelerations."""
    force_t_s: float
    """When the accelerations were measured; nan: there are none."""
    force_std_s: float
    """How well that is known."""
    attitude: Attitude | None
    """None: there is no new one."""
    attitude_std_s: float
    """How well it is known when it was measured."""
    attitude_is_slow: bool
    """Angles are measured more slowly than they are polled."""
    notes: Notes


class _Group:
    """Three channels that are measured together, and which of their readings are new."""

    def __init__(self) -> None:
        self.rate = MeasuredRate()
        self._a = self._b = self._c = nan
        self._first_s = self._changed_s = self._polled_s = nan

    def take(self, t_s: float, a: float, b: float, c: float) -> float:
        """When readings that are not all nan were measured; nan where they are those of before."""
        # nan is unlike itself: a channel that is not there has not changed.
        self._polled_s = t_s
        is_new = (a != self._a and a == a) or (b != self._b and b == b) or (c != self._c and c == c)
        is_whole = a != self._a and b != self._b and c != self._c
        if is_new:
            if self._first_s != self._first_s:
                self._first_s = t_s
            self._a, self._b, self._c, self._changed_s = a, b, c, t_s
        measured_s = self.rate.take(t_s, is_new, is_whole)
        if measured_s != measured_s and self._changed_s == self._first_s and t_s - self._first_s > CONSTANT_S:
            return t_s
        return measured_s

    @property
    def is_slow(self) -> bool:
        """Whether they are measured more slowly than they are polled."""
        return self.rate.period_s == self.rate.period_s

    @property
    def hangs(self) -> bool:
        """Whether a sensor whose repetitions are no readings has shown nothing new for too long."""
        if self.is_slow:
            return self.rate.hangs
        return self._changed_s > self._first_s and self._polled_s - self._changed_s > STILL_STUCK_S

    def remark(self, name: str) -> str:
        """What there is to say of how often it is measured; empty: with every poll."""
        period_s = self.rate.period_s
        if period_s != period_s:
            return ""
        return f"{name} measured {1.0 / period_s:.3g} times a second, polled {1.0 / self.rate.poll_s:.3g} times"


class Conditioner:
    """Judges the samples of one IMU, in order of time."""

    def __init__(self) -> None:
        self._forces, self._angles, self._rates = _Group(), _Group(), _Group()
        self._spikes = (
            SpikeGate(SIDEWAYS_MPS2),
            SpikeGate(SIDEWAYS_MPS2),
            SpikeGate(HEAVE_ACCELERATION_MPS2),
        )
        self._force_stuck = (
            # Without one of these the tilt is not removed: what is measured counts as measured otherwise.
            StuckDetector(rests=True, by_chance=True),
            StuckDetector(rests=True, by_chance=True),
            StuckDetector(must_live=True),
        )
        self._roll_stuck, self._pitch_stuck = StuckDetector(rests=True), StuckDetector(rests=True)
        self._both_stuck = StuckDetector(rests=True)
        self._rate_stuck = StuckDetector(rests=True)
        self._roll_gate, self._pitch_gate, self._yaw_gate = AngleGate(), AngleGate(), AngleGate(inf)
        self._units, self._signs = UnitsWatch(), SignWatch()
        self._notes, self._noted_s = NOTHING, -inf

    @property
    def spikes(self) -> int:
        """Readings refused because an acceleration jumped, or cannot be."""
        return sum(gate.rejected for gate in self._spikes)

    def take(self, sample: ImuSample) -> Conditioned:
        """Judge one sample, later than the last one."""
        t_s = sample.t_s
        if sample.fault is not Fault.NONE:
            return self._none(t_s, sample.fault, sample.fault)
        ax, ay, az = sample.ax_mps2, sample.ay_mps2, sample.az_mps2
        fault, force_t_s = Fault.NONE, nan
        if isfinite(az):
            self._units.take(t_s, ax, ay, az)
        if ax == ax or ay == ay or az == az:
            force_t_s = self._forces.take(t_s, ax, ay, az)
        if force_t_s == force_t_s:
            ax, ay, az, fault = self._judged_forces(force_t_s, ax, ay, az)
        elif self._forces.hangs:
            fault = Fault.STUCK
        if not isfinite(sample.az_mps2):
            fault = Fault.NOT_FINITE
        if fault is Fault.OUT_OF_RANGE or self._units.reason:
            return self._none(t_s, Fault.NONE, Fault.OUT_OF_RANGE)
        if fault is not Fault.NONE or az != az:
            force_t_s = nan
        if force_t_s != force_t_s:
            ax = ay = az = nan
        roll, pitch, yaw, attitude_t_s = self._judged_angles(t_s, sample)
        is_level = isfinite(roll + pitch)
        if is_level and abs(force_t_s - attitude_t_s) < TOGETHER_S and isfinite(ax + ay + az):
            self._signs.take(force_t_s, ax, ay, az, roll, pitch)
        if self._signs.certain:
            roll = pitch = nan
            is_level = False
        gx, gy, gz = self._judged_rates(t_s, sample)
        if t_s - self._noted_s >= NOTED_S:
            self._note(t_s)
        return Conditioned(
            sample=ImuSample(
                t_s=t_s,
                ax_mps2=ax,
                ay_mps2=ay,
                az_mps2=az,
                roll_rad=roll,
                pitch_rad=pitch,
                yaw_rad=yaw,
                gx_radps=gx,
                gy_radps=gy,
                gz_radps=gz,
            ),
            fault=fault,
            force_t_s=force_t_s,
            force_std_s=self._forces.rate.uncertainty_s,
            attitude=Attitude(
                attitude_t_s,
                roll,
                pitch,
                yaw,
                self._roll_gate.rate_radps,
                self._pitch_gate.rate_radps,
                self._roll_gate.std_rad,
                self._pitch_gate.std_rad,
                attitude_t_s,
            )
            if is_level
            else None,
            attitude_std_s=self._angles.rate.uncertainty_s,
            attitude_is_slow=self._angles.is_slow,
            notes=self._notes,
        )

    def _none(self, t_s: float, device_fault: Fault, fault: Fault) -> Conditioned:
        """A sample of which nothing is taken."""
        if t_s - self._noted_s >= NOTED_S:
            self._note(t_s)
        nothing, angles = ImuSample(t_s=t_s, fault=device_fault), self._angles
        return Conditioned(nothing, fault, nan, 0.0, None, angles.rate.uncertainty_s, angles.is_slow, self._notes)

    def _judged_forces(self, t_s: float, ax: float, ay: float, az: float) -> tuple[float, float, float, Fault]:
        """What may be used of the specific force, and what is wrong with the vertical one. OUT_OF_RANGE: with all."""
        stuck_x, stuck_y, stuck_z = self._force_stuck
        gate_x, gate_y, gate_z = self._spikes
        # A reading that repeats is not held against the last one: it is that.
        is_stuck = stuck_z.step(t_s, az)
        x = nan if stuck_x.step(t_s, ax, moves=False) else gate_x.step(t_s, ax)
        y = nan if stuck_y.step(t_s, ay, moves=False) else gate_y.step(t_s, ay)
        z = nan if is_stuck else gate_z.step(t_s, az - GRAVITY_MPS2)
        up = az - GRAVITY_MPS2
        is_wild = abs(up) > HEAVE_ACCELERATION_MPS2 or abs(ax) > SIDEWAYS_MPS2 or abs(ay) > SIDEWAYS_MPS2
        if is_wild or _is_refused(x, ax, stuck_x) or _is_refused(y, ay, stuck_y) or _is_refused(z, az, stuck_z):
            return nan, nan, nan, Fault.OUT_OF_RANGE
        return x, y, nan if is_stuck else az, Fault.STUCK if is_stuck else Fault.NONE

    def _judged_angles(self, t_s: float, sample: ImuSample) -> tuple[float, float, float, float]:
        """Roll, pitch and yaw as far as they may be used, and when they were measured."""
        roll, pitch, yaw = sample.roll_rad, sample.pitch_rad, sample.yaw_rad
        if roll != roll and pitch != pitch and yaw != yaw:
            return nan, nan, nan, nan
        t_s = self._angles.take(t_s, roll, pitch, yaw)
        if t_s != t_s:
            return nan, nan, nan, nan
        roll, pitch = wrapped(roll), wrapped(pitch)
        along, across, _ = self._force_stuck
        moves = along.spread > SWAYS_MPS2 or across.spread > SWAYS_MPS2
        # Through a coarse register either may rest at a crest for a second; both at once hardly do.
        is_roll, is_pitch = (
            self._roll_stuck.step(t_s, roll, moves=moves),
            self._pitch_stuck.step(t_s, pitch, moves=moves),
        )
        both = self._both_stuck.step(t_s, roll + UNLIKE * pitch, moves=moves)
        roll, pitch = nan if is_roll or both else roll, nan if is_pitch or both else pitch
        # One solution gives them together: what is wrong with one is not right in the others.
        leans_x, leans_y = GRAVITY_MPS2 * sin(pitch), GRAVITY_MPS2 * sin(roll)
        # Gravity along the deck confirms a first reading.
        is_confirmed = abs(sample.ax_mps2 - leans_x) < LEANS_MPS2 and abs(sample.ay_mps2 - leans_y) < LEANS_MPS2
        trusts_roll = self._roll_gate.step(t_s, roll, is_confirmed=is_confirmed)
        trusts_pitch = self._pitch_gate.step(t_s, pitch, is_confirmed=is_confirmed)
        if (roll == roll and not trusts_roll) or (pitch == pitch and not trusts_pitch):
            return nan, nan, nan, t_s
        if not isfinite(yaw) or not self._yaw_gate.step(t_s, yaw, is_confirmed=is_confirmed):
            yaw = nan
        return roll, pitch, yaw, t_s

    def _judged_rates(self, t_s: float, sample: ImuSample) -> tuple[float, float, float]:
        """The body rates, or nothing."""
        gx, gy, gz = sample.gx_radps, sample.gy_radps, sample.gz_radps
        if not max(abs(gx), abs(gy), abs(gz)) <= ANGLE_RATE_RADPS:
            return nan, nan, nan
        t_s = self._rates.take(t_s, gx, gy, gz)
        if t_s != t_s or self._rate_stuck.step(t_s, gx):
            return nan, nan, nan
        return gx, gy, gz

    def _note(self, t_s: float) -> None:
        """Renew what there is to say; it is the same record while that does not change."""
        self._noted_s = t_s
        gates = ("roll", self._roll_stuck), ("pitch", self._pitch_stuck)
        angles = [name for name, gate in gates if gate.is_stuck or self._both_stuck.is_stuck]
        forces = [axis for axis, gate in zip(("ax", "ay"), self._force_stuck, strict=False) if gate.is_stuck]
        found = [f"imu: {' and '.join(names)} stuck" for names in (angles, forces) if names]
        if not angles and self._angles.hangs:
            found.append("imu: attitude stuck")
        remarks = [r for r in (self._forces.remark("accelerations"), self._angles.remark("attitude")) if r]
        notes = Notes(
            unusable=self._units.reason,
            signs=self._signs.suspicion,
            are_signs_open=self._signs.is_open,
            remarks=tuple(found + remarks),
        )
        if notes != self._notes:
            self._notes = notes


def _is_refused(passed: float, value: float, stuck: StuckDetector) -> bool:
    """Whether a reading was there, was no repetition, and was not passed."""
    return passed != passed and value == value and not stuck.is_stuck
