"""What every sample of the IMU passes first: of each reading whether it is one, in what sense, and of which moment.

Accelerations, angles and body rates are judged separately, since what fails mostly fails alone: a register that hangs,
an attitude solution that is lost, a sensor slower than its neighbour. Only a sample whose accelerations cannot be true
is refused whole: such bytes are of something else, and the rest of them too. What is no reading is nan from here on.
"""

from __future__ import annotations

from math import inf, isfinite, isnan, nan, sin
from typing import Final

import msgspec

from heaved.estimation.common.bounds import ANGLE_RATE_RADPS, HEAVE_ACCELERATION_MPS2
from heaved.estimation.imu.attitude import Attitude
from heaved.estimation.imu.gates import AngleGate, SpikeGate, wrapped
from heaved.estimation.imu.mounting import SignCheck, UnitsCheck
from heaved.estimation.imu.sensor_clock import SensorClock
from heaved.samples import GRAVITY_MPS2, Fault, ImuSample
from heaved.unchanged import OldReadings, StuckDetector


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What readings of an IMU may be, beside what their gates know."""

    sideways_mps2: float = 16.0
    """Specific force along the deck: of an acceleration as heave may have and of gravity at a heel of 55 degrees."""
    sways_mps2: float = 0.1
    """RMS of the acceleration along the deck from which the vessel moves, and its angles with it."""
    leans_mps2: float = 2.0
    """The acceleration along the deck is that near to gravity's part in it, but for the worst of seas."""
    constant_s: float = 1.0
    """What has never been another value for so long is no slow sensor: a constant, as on a level bench."""
    together_s: float = 0.1
    """Accelerations and angles no further apart are held against each other: a small part of a wave."""
    notes_every_s: float = 0.2
    """What there is to say is renewed so often."""
    old_share: float = 0.05
    """Readings of before that come again are spoken of from this share on: coarse registers make some by chance."""
    hangs_s: float = 5.0
    """A sensor that has not shown a second reading for so long hangs."""


TUNING: Final = Tuning()
UNLIKE: Final = 2.0**0.5
"""Weight of pitch in a sum that does not stay the same when both angles change by steps of one register."""


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


class _Channels:
    """Three channels that are measured together, and which of their readings are new."""

    def __init__(self) -> None:
        self.clock = SensorClock()
        self._a = self._b = self._c = nan
        self._first_s = self._changed_s = self._polled_s = nan

    def step(self, t_s: float, a: float, b: float, c: float) -> float:
        """When readings that are not all nan were measured; nan where they are those of before."""
        self._polled_s = t_s
        is_a, is_b, is_c = a != self._a, b != self._b, c != self._c
        # nan is unlike itself: a channel that is not there has not changed.
        is_new = (is_a and not isnan(a)) or (is_b and not isnan(b)) or (is_c and not isnan(c))
        if is_new:
            if isnan(self._first_s):
                self._first_s = t_s
            self._a, self._b, self._c, self._changed_s = a, b, c, t_s
        measured_s = self.clock.step(t_s, is_new, is_a and is_b and is_c)
        if isnan(measured_s) and self._changed_s == self._first_s and t_s - self._first_s > TUNING.constant_s:
            return t_s
        return measured_s

    @property
    def hangs(self) -> bool:
        """Whether a sensor whose repetitions are no readings has shown nothing new for too long."""
        if self.clock.is_slow:
            return self.clock.hangs
        return self._changed_s > self._first_s and self._polled_s - self._changed_s > TUNING.hangs_s

    def remark(self, name: str) -> str:
        """What there is to say of how often it is measured; empty: with every poll."""
        clock = self.clock
        if not clock.is_slow:
            return ""
        return f"{name} measured {1.0 / clock.period_s:.3g} times a second, polled {1.0 / clock.poll_s:.3g} times"


class _Accelerometer:
    """One axis: whether its readings repeat, jump, or cannot be."""

    def __init__(self, detector: StuckDetector, most_mps2: float, rest_mps2: float = 0.0) -> None:
        """``most_mps2``: no reading is further than this from ``rest_mps2``."""
        self.detector, self.gate = detector, SpikeGate(most_mps2)
        self._most, self._rest = most_mps2, rest_mps2

    def step(self, t_s: float, value: float) -> Fault:
        """What is wrong with a reading; nothing with one that is nan."""
        off = value - self._rest
        # A reading that repeats is not held against the last one: it is that.
        if self.detector.step(t_s, value, moves=False):
            return Fault.OUT_OF_RANGE if abs(off) > self._most else Fault.STUCK
        return Fault.OUT_OF_RANGE if isnan(self.gate.step(t_s, off)) and not isnan(value) else Fault.NONE


class Conditioner:
    """Judges the samples of one IMU, in order of time."""

    def __init__(self) -> None:
        self._forces, self._angles, self._rates = _Channels(), _Channels(), _Channels()
        self._old = OldReadings()
        # Without ax or ay the tilt is not removed: what is measured counts as measured otherwise.
        self._ax = _Accelerometer(StuckDetector(rests=True, by_chance=True), TUNING.sideways_mps2)
        self._ay = _Accelerometer(StuckDetector(rests=True, by_chance=True), TUNING.sideways_mps2)
        self._az = _Accelerometer(StuckDetector(must_live=True), HEAVE_ACCELERATION_MPS2, GRAVITY_MPS2)
        self._roll_stuck, self._pitch_stuck = StuckDetector(rests=True), StuckDetector(rests=True)
        self._both_stuck = StuckDetector(rests=True)
        self._rate_stuck = StuckDetector(rests=True)
        self._roll_gate, self._pitch_gate, self._yaw_gate = AngleGate(), AngleGate(), AngleGate(inf)
        self._units, self._signs = UnitsCheck(), SignCheck()
        self._notes, self._noted_s = NOTHING, -inf

    @property
    def spikes(self) -> int:
        """Readings refused because an acceleration jumped, or cannot be."""
        return sum(axis.gate.rejected for axis in (self._ax, self._ay, self._az))

    def step(self, sample: ImuSample) -> Conditioned:
        """Judge one sample, later than the last one."""
        t_s = sample.t_s
        if sample.fault is not Fault.NONE:
            return self._none(t_s, sample.fault, sample.fault)
        if self._is_old(sample):
            return self._none(t_s, Fault.STALE, Fault.STALE)
        force_t_s, ax, ay, az, fault = self._judge_forces(sample)
        if fault is Fault.OUT_OF_RANGE or self._units.reason:
            return self._none(t_s, Fault.NONE, Fault.OUT_OF_RANGE)
        attitude_t_s, roll, pitch, yaw = self._judge_angles(sample)
        if abs(force_t_s - attitude_t_s) < TUNING.together_s and isfinite(roll + pitch + ax + ay + az):
            self._signs.step(force_t_s, ax, ay, az, roll, pitch)
        if self._signs.certain:
            roll = pitch = nan
        gx, gy, gz = self._judge_rates(sample)
        attitude = None
        if isfinite(roll + pitch):
            attitude = Attitude(
                t_s=attitude_t_s,
                roll_rad=roll,
                pitch_rad=pitch,
                yaw_rad=yaw,
                roll_rate_radps=self._roll_gate.rate_radps,
                pitch_rate_radps=self._pitch_gate.rate_radps,
                roll_std_rad=self._roll_gate.std_rad,
                pitch_std_rad=self._pitch_gate.std_rad,
                measured_s=attitude_t_s,
            )
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
            force_std_s=self._forces.clock.uncertainty_s,
            attitude=attitude,
            attitude_std_s=self._angles.clock.uncertainty_s,
            attitude_is_slow=self._angles.clock.is_slow,
            notes=self._notes,
        )

    def _is_old(self, sample: ImuSample) -> bool:
        """Whether it has been read before."""
        forces = sample.ax_mps2, sample.ay_mps2, sample.az_mps2
        # Of fewer numbers a slam may come back to one that has been before.
        if not isfinite(sum(forces)):
            return False
        beside = sample.roll_rad, sample.pitch_rad, sample.gx_radps, sample.gy_radps
        return self._old.step(sample.t_s, forces, sample.az_mps2, tuple(v for v in beside if isfinite(v)))

    def _none(self, t_s: float, device_fault: Fault, fault: Fault) -> Conditioned:
        """A sample of which nothing is taken."""
        self._note(t_s)
        nothing, clock = ImuSample(t_s=t_s, fault=device_fault), self._angles.clock
        return Conditioned(nothing, fault, nan, 0.0, None, clock.uncertainty_s, clock.is_slow, self._notes)

    def _judge_forces(self, sample: ImuSample) -> tuple[float, float, float, float, Fault]:
        """When the specific force was measured (nan: there is none), what of it may be used, and what is wrong with the
        vertical one. OUT_OF_RANGE: with all of it.
        """
        t_s, ax, ay, az = sample.t_s, sample.ax_mps2, sample.ay_mps2, sample.az_mps2
        if isfinite(az):
            self._units.step(t_s, ax, ay, az)
        force_t_s, fault = nan, Fault.NONE
        if not (isnan(ax) and isnan(ay) and isnan(az)):
            force_t_s = self._forces.step(t_s, ax, ay, az)
        if not isnan(force_t_s):
            of_x, of_y = self._ax.step(force_t_s, ax), self._ay.step(force_t_s, ay)
            fault = self._az.step(force_t_s, az)
            if of_x is Fault.OUT_OF_RANGE or of_y is Fault.OUT_OF_RANGE:
                fault = Fault.OUT_OF_RANGE
            ax, ay = ax if of_x is Fault.NONE else nan, ay if of_y is Fault.NONE else nan
        elif self._forces.hangs:
            fault = Fault.STUCK
        if not isfinite(az):
            fault = Fault.NOT_FINITE
        if isnan(force_t_s) or fault is not Fault.NONE:
            return nan, nan, nan, nan, fault
        return force_t_s, ax, ay, az, fault

    def _judge_angles(self, sample: ImuSample) -> tuple[float, float, float, float]:
        """When roll, pitch and yaw were measured, and as far as they may be used."""
        roll, pitch, yaw = sample.roll_rad, sample.pitch_rad, sample.yaw_rad
        if isnan(roll) and isnan(pitch) and isnan(yaw):
            return nan, nan, nan, nan
        t_s = self._angles.step(sample.t_s, roll, pitch, yaw)
        if isnan(t_s):
            return nan, nan, nan, nan
        roll, pitch = wrapped(roll), wrapped(pitch)
        moves = max(self._ax.detector.spread, self._ay.detector.spread) > TUNING.sways_mps2
        # Through a coarse register either may rest at a crest for a second; both at once hardly do.
        both = self._both_stuck.step(t_s, roll + UNLIKE * pitch, moves=moves)
        roll = nan if self._roll_stuck.step(t_s, roll, moves=moves) or both else roll
        pitch = nan if self._pitch_stuck.step(t_s, pitch, moves=moves) or both else pitch
        # Gravity along the deck confirms a first reading.
        is_confirmed = (
            abs(sample.ax_mps2 - GRAVITY_MPS2 * sin(pitch)) < TUNING.leans_mps2
            and abs(sample.ay_mps2 - GRAVITY_MPS2 * sin(roll)) < TUNING.leans_mps2
        )
        trusts_roll = self._roll_gate.step(t_s, roll, is_confirmed=is_confirmed)
        trusts_pitch = self._pitch_gate.step(t_s, pitch, is_confirmed=is_confirmed)
        # One solution gives them together: what is wrong with one is not right in the others.
        if not (trusts_roll or isnan(roll)) or not (trusts_pitch or isnan(pitch)):
            return t_s, nan, nan, nan
        if not isfinite(yaw) or not self._yaw_gate.step(t_s, yaw, is_confirmed=is_confirmed):
            yaw = nan
        return t_s, roll, pitch, yaw

    def _judge_rates(self, sample: ImuSample) -> tuple[float, float, float]:
        """The body rates, or nothing."""
        gx, gy, gz = sample.gx_radps, sample.gy_radps, sample.gz_radps
        if not max(abs(gx), abs(gy), abs(gz)) <= ANGLE_RATE_RADPS:
            return nan, nan, nan
        t_s = self._rates.step(sample.t_s, gx, gy, gz)
        if isnan(t_s) or self._rate_stuck.step(t_s, gx):
            return nan, nan, nan
        return gx, gy, gz

    def _note(self, t_s: float) -> None:
        """Renew what there is to say, now and then; it is the same record while that does not change."""
        if t_s - self._noted_s < TUNING.notes_every_s:
            return
        self._noted_s = t_s
        both = self._both_stuck.is_stuck
        pairs = ("roll", self._roll_stuck), ("pitch", self._pitch_stuck)
        angles = [name for name, detector in pairs if both or detector.is_stuck]
        forces = [name for name, axis in (("ax", self._ax), ("ay", self._ay)) if axis.detector.is_stuck]
        found = [f"imu: {' and '.join(names)} stuck" for names in (angles, forces) if names]
        if not angles and self._angles.hangs:
            found.append("imu: attitude stuck")
        if (share := self._old.share) > TUNING.old_share:
            found.append(f"imu: {100.0 * share:.0f} % of the readings are old ones that come again")
        remarks = [r for r in (self._forces.remark("accelerations"), self._angles.remark("attitude")) if r]
        notes = Notes(
            unusable=self._units.reason,
            signs=self._signs.suspicion,
            are_signs_open=self._signs.is_open,
            remarks=tuple(found + remarks),
        )
        if notes != self._notes:
            self._notes = notes
