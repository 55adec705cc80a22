"""Records that cross rooms: what a device said, what the pipeline concludes.

The one place where units, frames and signs are defined:

* SI units and radians. Degrees exist only in files, on the wire and on screens.
* Body axes x forward, y port, z up (right-handed). Specific force: at rest ``az = +9.80665``.
* Heave positive up. Roll positive port side up. Pitch positive bow up (*minus* the right-hand rotation about y).
  Yaw/heading positive clockwise from above, as a compass.
* Body rates ``gx, gy, gz`` are right-handed about x, y, z; so the pitch rate of a level ship is ``-gy``.
* ``t_s`` is monotonic time (seconds) of *validity*: the moment at which the slave sampled, never of arrival.
* ``nan`` means "not known". It is left out on the wire; it is never replaced by zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from math import nan
from typing import Final

import msgspec

GRAVITY_MPS2 = 9.80665
"""Standard gravity (ISO 80000-3), m/s2."""


# ---- what devices say ------------------------------------------------------------------------------------------------


class Fault(Enum):
    """Why a sample carries no (trustworthy) values."""

    NONE = "none"
    TIMEOUT = "timeout"
    CRC = "crc"
    EXCEPTION = "exception"
    LENGTH = "length"
    OUT_OF_RANGE = "out_of_range"
    NOT_FINITE = "not_finite"
    STUCK = "stuck"
    STALE = "stale"
    DISCONNECTED = "disconnected"

    __hash__ = object.__hash__  # Members are compared by identity; Enum's own hash is that of the name, in Python.


class ImuSample(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """One reading of an accelerometer, IMU or attitude sensor."""

    t_s: float
    ax_mps2: float = nan
    ay_mps2: float = nan
    az_mps2: float = nan
    roll_rad: float = nan
    pitch_rad: float = nan
    yaw_rad: float = nan
    gx_radps: float = nan
    gy_radps: float = nan
    gz_radps: float = nan
    fault: Fault = Fault.NONE


class LaserSample(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """One reading of the laser gauge: the raw distance, sign and offset not yet applied."""

    t_s: float
    laser_m: float = nan
    fault: Fault = Fault.NONE


class RatesSample(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """One reading of the second IMU, at the crane base: body rates in its own axes. It never touches the heave."""

    t_s: float
    gx_radps: float = nan
    gy_radps: float = nan
    gz_radps: float = nan
    fault: Fault = Fault.NONE


class CraftSample(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """One reading of what a craft's own sensors say; what a device does not measure is nan. It never touches our heave.

    Heave about the trim; flaps trailing edge down.
    """

    t_s: float
    heave_m: float = nan
    pitch_rad: float = nan
    speed_mps: float = nan
    flap_fore_rad: float = nan
    flap_aft_rad: float = nan
    fault: Fault = Fault.NONE


class CraneSample(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """One reading of the crane's encoders; what it does not measure is nan. It never touches the heave.

    Slew positive clockwise from above, 0 with the boom forward; boom its elevation above the deck, positive up; jib the
    same of the jib, against the deck; line out is the length that the winch has paid out.
    """

    t_s: float
    slew_rad: float = nan
    boom_rad: float = nan
    jib_rad: float = nan
    line_out_m: float = nan
    fault: Fault = Fault.NONE


class MruSample(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """One reading of an existing motion reference unit, to compare ours with; what it does not say is nan. It never
    touches the heave.

    As it tells it: which way its heave counts, and what it calls roll, say ``[reference_mru]``.
    """

    t_s: float
    heave_m: float = nan
    heave_velocity_mps: float = nan
    roll_rad: float = nan
    pitch_rad: float = nan
    yaw_rad: float = nan
    fault: Fault = Fault.NONE


Sample = ImuSample | LaserSample | RatesSample | CraftSample | CraneSample | MruSample


# ---- what a frame is worth -------------------------------------------------------------------------------------------


class HeaveState(Enum):
    """How far the published heave can be trusted."""

    SETTLING = "settling"
    VALID = "valid"
    DEGRADED = "degraded"
    INVALID = "invalid"

    __hash__ = object.__hash__  # As of a fault.


class LaserState(Enum):
    """VALID: fresh and plausible; STALE: configured, but nothing fresh; OFF: none configured."""

    VALID = "valid"
    STALE = "stale"
    OFF = "off"


class CorrectionState(Enum):
    """OFF: disabled; LEARNING: nothing found yet; ACTIVE: applied, laser fresh; HOLDING: no laser, or faded out."""

    OFF = "off"
    LEARNING = "learning"
    ACTIVE = "active"
    HOLDING = "holding"


class Quality(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """What the numbers of a frame are worth, and why."""

    heave: HeaveState
    laser: LaserState
    correction: CorrectionState
    reasons: tuple[str, ...] = ()


# ---- the heave, elsewhere and at other times -------------------------------------------------------------------------


class HeaveForecast(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """Heave predicted for ``t_s + horizon_s``."""

    horizon_s: float
    heave_m: float = nan
    std_m: float = nan


class PointMotion(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """Motion of a monitoring point: that of the IMU, and what the attitude adds at the end of the lever arm.

    Heave and its velocity are what the ship does to it. What the crane does to it, by slewing, luffing and hoisting, is
    apart: ``own_height_m``, its height over the IMU on the level ship, and the rate of that.
    """

    name: str
    heave_m: float = nan
    heave_std_m: float = nan
    """From those of the heave and of the measured attitude; how well the attitude is aligned is not known to us."""
    heave_velocity_mps: float = nan
    heave_acceleration_mps2: float = nan
    own_height_m: float = nan
    own_velocity_mps: float = nan
    forecast: tuple[HeaveForecast, ...] = ()
    """Of the heave, for as far ahead of the frame as its own forecasts."""
    state: HeaveState | None = None
    """Where it is worth less than the heave of the IMU; None: as much."""
    reasons: tuple[str, ...] = ()
    """Why."""


class MotionNow(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """Heave and points of ``t_s`` itself, where those of the frame are for a moment after it."""

    heave_m: float = nan
    heave_std_m: float = nan
    heave_velocity_mps: float = nan
    points: tuple[PointMotion, ...] = ()


class DelayedHeave(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """Heave of a moment that lies some time back, from the samples before and after it (fixed-lag smoothing)."""

    t_s: float
    """Its own time of validity."""
    heave_m: float
    std_m: float


# ---- roll, pitch and yaw ahead, and the quiet to come ----------------------------------------------------------------


class RockPrediction(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """Attitude predicted for ``t_s + horizon_s``; standard deviations of the prediction error, and half-widths of the
    interval that holds 95 % of what is measured then.
    """

    horizon_s: float
    roll_rad: float = nan
    pitch_rad: float = nan
    yaw_rad: float = nan
    roll_std_rad: float = nan
    pitch_std_rad: float = nan
    yaw_std_rad: float = nan
    roll_interval_rad: float = nan
    pitch_interval_rad: float = nan
    yaw_interval_rad: float = nan


class RockScore(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """How the predictions of one axis for one horizon have fared over the last minutes."""

    axis: str
    """"roll", "pitch" or "yaw"."""
    horizon_s: float
    error_rad: float
    """RMS of what was measured minus what had been predicted for then."""
    coverage: float
    """Share of measured values within the 95 % interval."""


class QuietWindow(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """The next time in which roll, pitch and heave stay within their limits, as seen at ``t_s``."""

    t_s: float
    start_s: float
    """From ``t_s`` on."""
    length_s: float
    """At least the duration asked for; longer while windows that begin later are as sure."""
    confidence: float
    """Probability that the first part of it, as long as was asked for, is quiet."""


class QuietForecast(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """What is foreseen of quiet windows at ``t_s``."""

    t_s: float
    window: QuietWindow | None = None
    """The next one that is sure enough; None: there is none."""
    best: float = nan
    """Confidence of the surest window within the look-ahead; nan: nothing has been learned yet."""


# ---- the sea, and what shakes the hull -------------------------------------------------------------------------------


class WaveSystem(msgspec.Struct, frozen=True, kw_only=True):
    """One peak of the heave spectrum."""

    kind: str
    """"swell" or "wind sea", by its steepness."""
    significant_height_m: float
    peak_period_s: float


class Vibration(msgspec.Struct, frozen=True, kw_only=True):
    """What shakes the accelerometer beside the waves: an engine, a thruster, the hull's own bending."""

    frequency_hz: float
    """As it is seen: what is faster than half the rate of the samples has folded to another one."""
    width_hz: float
    """Half the height of its peak is that wide: small for a line, several hertz for a broad band."""
    rms_mps2: float


class SeaState(msgspec.Struct, frozen=True, kw_only=True):
    """The sea as the vessel's heave shows it, and what the accelerometer shows beside it."""

    significant_height_m: float
    """4 standard deviations of the heave."""
    peak_period_s: float
    mean_period_s: float
    """m0 / m1 of the heave spectrum."""
    systems: tuple[WaveSystem, ...]
    """Longest waves first."""
    frequencies_hz: tuple[float, ...]
    spectrum_m2phz: tuple[float, ...]
    """One-sided heave spectrum at those frequencies."""
    t_s: float = nan
    """End of the record that it was fitted to."""
    window_s: float = nan
    """Length of that record."""
    model: str = ""
    """What was fitted, for people."""
    is_still: bool = False
    """No motion above the noise of the sensor."""
    vibration: tuple[Vibration, ...] = ()
    """Strongest first; none on a quiet hull."""
    noise_mps2_rthz: float = nan
    """Density of the accelerometer's white noise, one-sided, as the record shows it."""
    bias_walk_mps2_rts: float = nan
    """Random walk of its bias, as far as the record shows it."""


# ---- the stages beside the heave -------------------------------------------------------------------------------------


class HullAngles(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """Deformation between the IMU amidships and the one at the crane base at ``t_s``, its own time of validity.

    Angles x, y, z of ``local_from_midships = R3(z) R2(y) R1(x)``, passive; standard deviations about the hull's axes.
    """

    t_s: float
    state: str
    """"starting", "converging", "converged", "weak" or "holding"."""
    warnings: tuple[str, ...] = ()
    total_rad: tuple[float, float, float] = (nan, nan, nan)
    """Static, mounting and flexure."""
    static_rad: tuple[float, float, float] = (nan, nan, nan)
    dynamic_rad: tuple[float, float, float] = (nan, nan, nan)
    """Flexure about the hull's x, y, z."""
    std_rad: tuple[float, float, float] = (nan, nan, nan)
    reachable_std_rad: tuple[float, float, float] = (nan, nan, nan)
    """What the motion at hand would give in the end; inf: nothing."""
    delay_s: float = nan
    """By which the stamps of the second IMU are late."""
    delay_std_s: float = nan
    refits: int = 0
    resets: int = 0


class CraftMotion(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """Fused heave (about the trim) and pitch of a craft at ``t_s``, its own time of validity."""

    t_s: float
    heave_m: float
    heave_velocity_mps: float
    pitch_rad: float
    pitch_rate_radps: float
    heave_std_m: float
    heave_velocity_std_mps: float
    pitch_std_rad: float
    pitch_rate_std_radps: float
    probabilities: tuple[float, ...] = ()
    """Of the filters."""
    switches: int = 0
    """Changes of the filter that serves, so far."""
    resets: int = 0
    cautions: tuple[str, ...] = ()


class MruAgreement(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """How one quantity of an existing MRU stands to ours, in SI units of the quantity; nan: not known."""

    reference: float = nan
    """What it said last, in our signs,"""
    own: float = nan
    """ours at that moment,"""
    difference: float = nan
    """and reference minus ours."""
    mean_difference: float = nan
    """Over the window. Of the heave it has no meaning, of the angles it is how differently the two are mounted."""
    std_difference: float = nan
    """Without that mean,"""
    rms_difference: float = nan
    """and with it."""
    explained: float = nan
    """Standard deviation of the difference that the errors of both explain."""
    correlation: float = nan
    """Greatest within a second either way, means taken out,"""
    delay_s: float = nan
    """by which the reference is then late,"""
    scale: float = nan
    """and so many times as large as ours."""


class MruComparison(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """An existing MRU beside ours, at ``t_s``, the time of validity of its reading."""

    t_s: float
    heave: MruAgreement = MruAgreement()
    heave_velocity: MruAgreement = MruAgreement()
    roll: MruAgreement = MruAgreement()
    pitch: MruAgreement = MruAgreement()
    yaw: MruAgreement = MruAgreement()
    compared_s: float = 0.0
    """Length of what was compared, of the window."""
    warnings: tuple[str, ...] = ()
    """Where the two diverge, in words."""


# ---- all of it -------------------------------------------------------------------------------------------------------


class MotionFrame(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """All that is known of the motion at ``t_s``: one per IMU sample, one per missed sample time too."""

    t_s: float
    quality: Quality
    heave_m: float = nan
    heave_std_m: float = nan
    heave_velocity_mps: float = nan
    heave_acceleration_mps2: float = nan
    observer_m: float = nan
    """Observer output after the multi-step shift, before the learned correction."""
    correction_m: float = nan
    lead_s: float = nan
    """Lead of the inertial displacement over the truth, removed by the multi-step observer."""
    reference_m: float = nan
    """Laser heave (sign applied, constant removed), when fresh."""
    roll_rad: float = nan
    pitch_rad: float = nan
    yaw_rad: float = nan
    surge_acceleration_mps2: float = nan
    """Forward and to port, in the level frame that turns with the heading."""
    sway_acceleration_mps2: float = nan
    roll_rate_radps: float = nan
    """Derivatives of the three angles, as far as they are known."""
    pitch_rate_radps: float = nan
    yaw_rate_radps: float = nan
    points: tuple[PointMotion, ...] = ()
    rock: Sequence[RockPrediction] = ()
    """One per horizon, shortest first, as in ``forecast``."""
    quiet: QuietForecast | None = None
    """None: it is not asked for. Renewed once a second."""
    forecast: Sequence[HeaveForecast] = ()
    compensation_lead_s: float = 0.0
    """Heave, velocity, their standard deviation and the points are for this long after ``t_s``."""
    now: MotionNow | None = None
    """What they are at ``t_s`` itself; None: there is no lead, they are for it."""
    delayed: DelayedHeave | None = None
    """The newest delayed heave; several frames may carry the same one."""
    sea: SeaState | None = None
    """The newest one; many frames carry the same object."""
    crane_roll_rad: float = nan
    """Attitude of the crane base: that of the IMU and the hull's deformation, once that has converged."""
    crane_pitch_rad: float = nan
    crane_yaw_rad: float = nan
    hull: HullAngles | None = None
    """The newest one; many frames carry the same object."""
    attitude: CraftMotion | None = None
    """Likewise."""
    reference_mru: MruComparison | None = None
    """Likewise."""


# ---- what is learned from --------------------------------------------------------------------------------------------


class TrainingWindow(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """What the trainer is handed. Arrays travel as little-endian float64 bytes (C order)."""

    number: int
    """Counts the windows; the result carries it back."""
    inputs: bytes
    """(n, d): rows of the last d observer outputs, metres, oldest first."""
    targets: bytes
    """(n,): laser heave minus observer output, metres."""
    rows: int
    width: int
    hidden: int
    learning_rate: float
    epochs: int
    output: str
    """"linear" or "sigmoid"."""
    seed: int


class TrainedNetwork(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """A trained residual network, or the reason why there is none. Weights as TrainingWindow's arrays."""

    number: int
    weights: bytes = b""
    """Flat: W1 (hidden, width), b1 (hidden,), w2 (hidden,), b2 (1,), then input mean, input std, target mean,
    target std (one scalar each), all float64."""
    width: int = 0
    hidden: int = 0
    output: str = "linear"
    seconds: float = nan
    """CPU time the training took."""
    message: str = ""
    """Empty when well."""


# ---- in words --------------------------------------------------------------------------------------------------------

FELT_MPS2: Final = 0.02
"""RMS from which people on board feel a vibration (ISO 2631-1, annex C: half of them from a peak of 0.015 m/s2 on)."""
BROAD: Final = 0.5
"""A peak that is as wide as that share of its frequency is a band, not a line."""
MOST_NAMED: Final = 3


def vibration_in_words(vibration: Sequence[Vibration]) -> str:
    """``vibration: seen at 3.1 Hz, 0.21 m/s2; from 4.0 to 7.0 Hz, 0.11 m/s2``: the strongest that people would feel;
    empty: there is none. *Seen*, since what is faster than half the rate of the samples shows at another frequency.
    """
    felt = [one for one in vibration if one.rms_mps2 >= FELT_MPS2]
    return "vibration: seen " + "; ".join(map(_in_words, felt[:MOST_NAMED])) if felt else ""


def _in_words(one: Vibration) -> str:
    low_hz, high_hz = one.frequency_hz - 0.5 * one.width_hz, one.frequency_hz + 0.5 * one.width_hz
    is_broad = one.width_hz >= BROAD * one.frequency_hz
    where = f"from {max(low_hz, 0.0):.1f} to {high_hz:.1f}" if is_broad else f"at {one.frequency_hz:.1f}"
    return f"{where} Hz, {one.rms_mps2:.2f} m/s2"
