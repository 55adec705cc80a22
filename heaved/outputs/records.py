"""What the stream says: a record for each class of line, ``class`` first.

What is not known is left out, never ``null`` or ``NaN``; angles are in degrees, times ISO 8601 UTC, signs those of
:mod:`heaved.samples`. Which of their numbers come from which record inside, and how they are rounded, says the table in
:mod:`heaved.outputs.fields`.
"""

from __future__ import annotations

from typing import Final

import msgspec

from heaved.samples import CorrectionState, HeaveState, Quality, Vibration

PROTO_MAJOR: Final = 1
PROTO_MINOR: Final = 5


class VersionRecord(msgspec.Struct, frozen=True, kw_only=True, tag_field="class", tag="VERSION"):
    """First line of every connection, and the answer to ``?VERSION``."""

    release: str
    proto_major: int = PROTO_MAJOR
    """Changes when an old client would misread the stream."""
    proto_minor: int = PROTO_MINOR
    """Changes when fields or classes are added."""


class ErrorRecord(msgspec.Struct, frozen=True, kw_only=True, tag_field="class", tag="ERROR"):
    """What was wrong with a request, or why the connection ends."""

    message: str


class RockRecord(msgspec.Struct, frozen=True, gc=False, omit_defaults=True):
    """Attitude predicted for ``horizon_s`` after the time of validity; standard deviations of the prediction error, and
    half-widths of the interval that holds 95 % of what is measured then.
    """

    horizon_s: float
    roll_deg: float | None = None
    pitch_deg: float | None = None
    yaw_deg: float | None = None
    roll_std_deg: float | None = None
    pitch_std_deg: float | None = None
    yaw_std_deg: float | None = None
    roll_interval_deg: float | None = None
    pitch_interval_deg: float | None = None
    yaw_interval_deg: float | None = None


class ForecastRecord(msgspec.Struct, frozen=True, gc=False, omit_defaults=True):
    """Heave predicted for ``horizon_s`` after the time of validity."""

    horizon_s: float
    heave_m: float | None = None
    std_m: float | None = None


class PointRecord(msgspec.Struct, frozen=True, gc=False, omit_defaults=True):
    """A monitoring point, as configured."""

    name: str
    heave_m: float | None = None
    heave_std_m: float | None = None
    heave_velocity_mps: float | None = None
    heave_acceleration_mps2: float | None = None
    own_height_m: float | None = None
    """Over the IMU on the level ship, and how fast the crane changes that; it is not in the heave."""
    own_velocity_mps: float | None = None
    forecast: tuple[ForecastRecord, ...] = ()
    state: HeaveState | None = None
    """Absent: that of the heave."""
    reasons: tuple[str, ...] = ()


class MotionRecord(
    msgspec.Struct, frozen=True, gc=False, kw_only=True, omit_defaults=True, tag_field="class", tag="MOTION"
):
    """One frame. ``age_s`` and ``dropped`` are last, because :func:`motion_tail` writes them."""

    seq: int
    """Counts the frames of the daemon since its start."""
    time: str
    """UTC of validity, microseconds."""
    mono_s: float
    """The daemon's monotonic clock at validity."""
    heave_m: float | None = None
    heave_std_m: float | None = None
    heave_velocity_mps: float | None = None
    heave_acceleration_mps2: float | None = None
    observer_m: float | None = None
    correction_m: float | None = None
    lead_s: float | None = None
    reference_m: float | None = None
    roll_deg: float | None = None
    pitch_deg: float | None = None
    yaw_deg: float | None = None
    roll_rate_degps: float | None = None
    pitch_rate_degps: float | None = None
    yaw_rate_degps: float | None = None
    surge_acceleration_mps2: float | None = None
    """Forward and to port, in the level frame that turns with the heading."""
    sway_acceleration_mps2: float | None = None
    crane_roll_deg: float | None = None
    """Attitude of the crane base, once the hull's deformation has converged."""
    crane_pitch_deg: float | None = None
    crane_yaw_deg: float | None = None
    compensation_lead_s: float | None = None
    """Heave, its standard deviation and velocity, and the points are for this long after ``time``; absent: 0."""
    points: tuple[PointRecord, ...] = ()
    rock: tuple[RockRecord, ...] = ()
    forecast: tuple[ForecastRecord, ...] = ()
    quality: Quality
    age_s: float | None = None
    """From validity to the moment the line was given to the socket."""
    dropped: int | None = None
    """Frames that this client lost just before this one, because it did not keep up."""


class WaveSystemRecord(msgspec.Struct, frozen=True, kw_only=True):
    """One peak of the heave spectrum."""

    kind: str
    significant_height_m: float
    peak_period_s: float


class SeaRecord(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag_field="class", tag="SEA"):
    """The sea as the heave shows it, and what the accelerometer shows beside it, with each refit."""

    time: str
    """UTC of the end of the record that it comes from."""
    significant_height_m: float
    peak_period_s: float
    mean_period_s: float
    is_still: bool
    systems: tuple[WaveSystemRecord, ...]
    """Swell and wind sea, longest waves first."""
    frequencies_hz: tuple[float, ...]
    spectrum_m2phz: tuple[float, ...]
    """One-sided heave spectrum."""
    model: str
    window_s: float
    """Length of the record that it was fitted to."""
    vibration: tuple[Vibration, ...]
    """What shakes the hull, strongest first."""
    noise_mps2_rthz: float | None = None
    """One-sided density of the accelerometer's white noise, as the record shows it."""
    bias_walk_mps2_rts: float | None = None
    """Random walk of its bias, likewise."""


class DelayedRecord(msgspec.Struct, frozen=True, kw_only=True, tag_field="class", tag="DELAYED"):
    """Delayed heave: exact, and old."""

    time: str
    """UTC of validity."""
    mono_s: float
    heave_m: float
    std_m: float


class HullRecord(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag_field="class", tag="HULL"):
    """Deformation between the IMUs amidships and at the crane base: ``v_local = R3(z) R2(y) R1(x) v_midships``."""

    time: str
    """UTC of validity."""
    mono_s: float
    state: str
    """"starting", "converging", "converged", "weak" or "holding"."""
    x_deg: float | None = None
    """Total: static, mounting and flexure."""
    y_deg: float | None = None
    z_deg: float | None = None
    static_x_deg: float | None = None
    static_y_deg: float | None = None
    static_z_deg: float | None = None
    dynamic_x_deg: float | None = None
    """Flexure about the hull's axes."""
    dynamic_y_deg: float | None = None
    dynamic_z_deg: float | None = None
    x_std_arcsec: float | None = None
    """Of the total, about the hull's axes."""
    y_std_arcsec: float | None = None
    z_std_arcsec: float | None = None
    x_reachable_std_arcsec: float | None = None
    """What the motion at hand would give in the end; absent: nothing."""
    y_reachable_std_arcsec: float | None = None
    z_reachable_std_arcsec: float | None = None
    delay_s: float | None = None
    """By which the second IMU is late, its configured latency included already."""
    delay_std_s: float | None = None
    refits: int
    resets: int
    warnings: tuple[str, ...] = ()


class AttitudeRecord(msgspec.Struct, frozen=True, kw_only=True, tag_field="class", tag="ATTITUDE"):
    """Fused heave (about the trim, up) and pitch (bow up) of a craft."""

    time: str
    """UTC of validity."""
    mono_s: float
    heave_m: float
    heave_std_m: float
    heave_velocity_mps: float
    heave_velocity_std_mps: float
    pitch_deg: float
    pitch_std_deg: float
    pitch_rate_degps: float
    pitch_rate_std_degps: float
    probabilities: tuple[float, ...]
    """Of the filters."""
    switches: int
    resets: int
    cautions: tuple[str, ...]


class HeaveAgreementRecord(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """How the heave of the reference MRU stands to ours: the latest at the time of the record, the others over the
    window.
    """

    reference_m: float | None = None
    """Latest, in our signs."""
    own_m: float | None = None
    """Ours at that moment."""
    difference_m: float | None = None
    """Reference minus ours."""
    mean_difference_m: float | None = None
    """Of no meaning: heave has no zero of its own."""
    std_difference_m: float | None = None
    """Without that mean."""
    rms_difference_m: float | None = None
    explained_m: float | None = None
    """Standard deviation of the difference that the errors of both explain."""
    correlation: float | None = None
    """At its greatest within a second either way."""
    delay_s: float | None = None
    """Of the reference, there; absent: more than a second, or not known."""
    scale: float | None = None
    """Reference over ours, there."""


class VelocityAgreementRecord(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Likewise of the heave velocity."""

    reference_mps: float | None = None
    own_mps: float | None = None
    difference_mps: float | None = None
    mean_difference_mps: float | None = None
    std_difference_mps: float | None = None
    rms_difference_mps: float | None = None
    explained_mps: float | None = None
    correlation: float | None = None
    delay_s: float | None = None
    scale: float | None = None


class AngleAgreementRecord(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Likewise of roll, pitch or yaw; the mean difference is how differently the two are mounted."""

    reference_deg: float | None = None
    own_deg: float | None = None
    difference_deg: float | None = None
    mean_difference_deg: float | None = None
    std_difference_deg: float | None = None
    rms_difference_deg: float | None = None
    explained_deg: float | None = None
    correlation: float | None = None
    delay_s: float | None = None
    scale: float | None = None


class ReferenceRecord(
    msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag_field="class", tag="REFERENCE"
):
    """An existing MRU beside ours, up to ten times a second; what it does not tell is absent."""

    time: str
    """UTC of validity of its reading, and of ours that it is compared with."""
    mono_s: float
    heave: HeaveAgreementRecord | None = None
    heave_velocity: VelocityAgreementRecord | None = None
    roll: AngleAgreementRecord | None = None
    pitch: AngleAgreementRecord | None = None
    yaw: AngleAgreementRecord | None = None
    compared_s: float | None = None
    """Length of what was compared, within the window."""
    warnings: tuple[str, ...] = ()
    """Where the two diverge by more than is explained. Which of them is wrong they do not say."""


class QuietRecord(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag_field="class", tag="QUIET"):
    """The next quiet window, once a second; without one, ``is_expected`` is false and its fields are absent."""

    time: str
    """UTC at which it was foreseen."""
    mono_s: float
    is_expected: bool
    start: str | None = None
    """UTC of its beginning."""
    start_s: float | None = None
    """The same, from ``time`` on."""
    length_s: float | None = None
    confidence: float | None = None
    """Probability that it is quiet for the time that was asked for."""
    best_confidence: float | None = None
    """Of the surest window within the look-ahead; absent while nothing has been learned."""


class RockStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """How the predictions of an axis for a horizon have fared over the last minutes."""

    axis: str
    horizon_s: float
    error_deg: float | None = None
    """RMS."""
    coverage: float | None = None
    """Share of the measured angles within their 95 % interval."""


class QuietStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """As the QUIET record has it."""

    is_expected: bool
    start_s: float | None = None
    length_s: float | None = None
    confidence: float | None = None
    best_confidence: float | None = None


class HeaveStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The last frame, so that a status line is complete even when no frame flows."""

    heave_m: float | None = None
    heave_std_m: float | None = None
    age_s: float | None = None
    """Age of the last frame when the status was made."""


class DeviceStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A configured device."""

    name: str
    role: str
    up: bool
    link: str = ""
    rate_hz: float | None = None
    """Good samples a second, measured."""
    wanted_rate_hz: float | None = None
    results: dict[str, int] = {}
    """Polls since the start, counted by :class:`heaved.samples.Fault` value (``none`` is a good one)."""
    last_fault: str | None = None
    last_fault_age_s: float | None = None
    detail: str = ""
    """What is wrong and what to do, for a person."""


class OutputStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A configured output beside the stream."""

    name: str
    kind: str
    """What it speaks."""
    link: str
    up: bool
    sent: int = 0
    """Messages since the start, or since its configuration has changed."""
    lost: dict[str, int] = {}
    """That did not go out, by reason: ``down``, ``slow``, ``not known``, ..."""
    detail: str = ""
    """What is wrong and what to do, for a person."""


class ObserverStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The observer of the heave."""

    name: str
    """As ``[heave] observer`` has it."""
    frequencies_hz: tuple[float, ...] = ()
    """Centre frequencies of the sea model in use."""
    fit_age_s: float | None = None
    resets: int = 0
    vibration: tuple[Vibration, ...] = ()
    """These three as the SEA record has them."""
    noise_mps2_rthz: float | None = None
    bias_walk_mps2_rts: float | None = None
    roll_pitch_coherence: float | None = None
    """Squared, of roll and pitch together with the heave."""
    roll_pitch_weight: float | None = None
    """How much of what they tell is in the heave, 0 (none: the acceleration alone) to 1; absent: nothing is known of
    them."""


class CorrectionStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The learned correction."""

    state: CorrectionState
    runs: int = 0
    """Trainings finished since the start, of any result."""
    last_result: str | None = None
    age_s: float | None = None
    """Since the network in use was accepted."""
    nothing_to_learn: int = 0
    """Times that no training was worth its while: a regression has shown that no network would be accepted."""


class LaserStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Where the beam of the laser meets its target, as its readings show; without numbers before they do."""

    is_elsewhere: bool = False
    """Not where it is configured."""
    ahead_m: float | None = None
    """Of where it would be by the configuration; and to port."""
    ahead_std_m: float | None = None
    port_m: float | None = None
    port_std_m: float | None = None


class HullStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The last HULL in short."""

    state: str
    z_deg: float | None = None
    std_arcsec: float | None = None
    """Of the worst axis."""
    warnings: tuple[str, ...] = ()
    resets: int = 0


class AttitudeStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The last ATTITUDE in short; without numbers before the first."""

    heave_m: float | None = None
    heave_std_m: float | None = None
    pitch_deg: float | None = None
    pitch_std_deg: float | None = None
    age_s: float | None = None
    cautions: tuple[str, ...] = ()
    resets: int = 0


class ReferenceStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The last REFERENCE in short; without numbers before the first, and ten seconds after the last."""

    heave_difference_m: float | None = None
    """Latest; then over the window, as there."""
    heave_std_difference_m: float | None = None
    heave_explained_m: float | None = None
    heave_correlation: float | None = None
    heave_delay_s: float | None = None
    heave_scale: float | None = None
    roll_mean_difference_deg: float | None = None
    roll_std_difference_deg: float | None = None
    pitch_mean_difference_deg: float | None = None
    pitch_std_difference_deg: float | None = None
    compared_s: float | None = None
    age_s: float | None = None
    """Of the last reading that was compared."""
    warnings: tuple[str, ...] = ()


class ClockStatus(msgspec.Struct, frozen=True, kw_only=True):
    """UTC, as it is tracked."""

    utc_offset_s: float
    """UTC minus the monotonic clock."""
    steps: int = 0
    """Steps of the system's UTC since the start."""


class StatusRecord(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag_field="class", tag="STATUS"):
    """The daemon's state, for people, monitoring and the answer to ``?STATUS``. Not-finite numbers must be ``None``."""

    release: str
    uptime_s: float
    frames: int
    """Frames made since the start."""
    rate_hz: float | None = None
    """Frames a second, measured over the last seconds."""
    heave: HeaveStatus
    quality: Quality
    devices: tuple[DeviceStatus, ...]
    outputs: tuple[OutputStatus, ...] = ()
    clients: int
    dropped: int
    """Lines dropped for slow clients since the start, all clients together."""
    lead_s: float | None = None
    observer: ObserverStatus | None = None
    correction: CorrectionStatus | None = None
    laser: LaserStatus | None = None
    """When there is one."""
    hull: HullStatus | None = None
    """When [hull] is enabled."""
    attitude: AttitudeStatus | None = None
    """When [attitude] is enabled."""
    reference_mru: ReferenceStatus | None = None
    """When there is a device of that role."""
    rock: tuple[RockStatus, ...] = ()
    """Of 150 ms and 1 s, where they are predicted."""
    quiet: QuietStatus | None = None
    clock: ClockStatus | None = None
    config_file: str | None = None
    state_file: str | None = None
