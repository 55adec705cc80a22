"""What the hull-deformation estimator is told and what it says: configuration, state, warnings, the estimate."""

from __future__ import annotations

from enum import StrEnum
from math import nan
from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.samples import HullAngles

Array = NDArray[np.float64]


class Method(StrEnum):
    """The filter: ours, or one of the source's two."""

    SO3 = "so3"
    CKF = "ckf"
    UKF = "ukf"


class Start(StrEnum):
    """What the filter starts from."""

    ALIGN = "align"
    """The alignment of the first seconds."""
    ZERO = "zero"
    """All angles zero (the source; ckf and ukf only)."""


class ResetReason(StrEnum):
    """Why the estimator started over."""

    TIME = "time"
    """The clock stepped back."""
    COVARIANCE = "covariance"
    """The covariance was none any more, or something was not finite."""
    INCONSISTENT = "inconsistent"
    """Nothing was explained for too long."""
    REMEMBERED = "remembered"
    """The deformation of an earlier run is not that of now: an IMU was moved or replaced."""


class Params(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[hull]``: deformation between the IMU amidships and the one at the crane base."""

    enabled: bool = False
    method: Method = Method.SO3
    rate_hz: Annotated[float, msgspec.Meta(ge=2, le=50)] = 10.0
    """Common time base of the two IMUs, at the least: it takes the rate of the slower one, up to 25 Hz."""
    start: Start = Start.ALIGN
    start_s: Annotated[float, msgspec.Meta(ge=2, le=60)] = 5.0
    """Record for the alignment, longer while the motion does not suffice."""
    alignment_std_deg: Annotated[float, msgspec.Meta(gt=0, le=90)] = 2.0
    """Prior about the alignment; with ``start = "zero"``, about zero."""
    flexure_std_arcsec: Annotated[float, msgspec.Meta(gt=0, le=3600)] = 10.0
    """Flexure per axis until it is fitted: standard deviation (sigma)."""
    flexure_mu_radps: Annotated[float, msgspec.Meta(gt=0, le=10)] = 0.3
    """Its damping (mu)."""
    flexure_hz: Annotated[float, msgspec.Meta(gt=0, le=5)] = 0.2
    """Its frequency (lambda / 2 pi)."""
    refit_after_s: Annotated[float, msgspec.Meta(ge=0, le=3600)] = 300.0
    """Record from which the flexure is fitted; what was filtered before is filtered again with it. 0: never."""
    refit_every_s: Annotated[float, msgspec.Meta(ge=60, le=86400)] = 600.0
    """Later fits, of the latest ``refit_after_s``: the sea changes."""
    gyro_noise_deg_rth: Annotated[float, msgspec.Meta(gt=0, le=100)] = 0.0005
    """Angle random walk of one gyro that is assumed at least; more is taken when the record shows it."""
    gyro_bias_deg_h: Annotated[float, msgspec.Meta(gt=0, le=10000)] = 0.1
    """Prior standard deviation of the difference of the gyro biases."""
    bias_walk_deg_h_rth: Annotated[float, msgspec.Meta(ge=0, le=10000)] = 0.005
    """Random walk of that difference, degrees per hour per root hour."""
    scale_ppm: Annotated[float, msgspec.Meta(gt=0, le=50000)] = 50.0
    """Prior standard deviation of the scale of each local gyro against the midships ones."""
    delay_ms: Annotated[float, msgspec.Meta(gt=0, le=100)] = 20.0
    """Prior standard deviation of the delay between the IMUs, about the one that the alignment finds."""
    delay_walk_us_rts: Annotated[float, msgspec.Meta(ge=0, le=1000)] = 10.0
    """Random walk of that delay, microseconds per root second."""
    static_walk_arcsec_rth: Annotated[float, msgspec.Meta(ge=0, le=1000)] = 2.0
    """Random walk of the static deformation (sun, ballast), arcsec per root hour."""
    coherent_floor_arcsec: Annotated[float, msgspec.Meta(ge=0, le=3600)] = 1.0
    """Added to the published deviations: flexure coherent with the waves, which rates do not show."""
    converged_arcsec: Annotated[float, msgspec.Meta(gt=0, le=3600)] = 30.0
    """Published deviation of the worst axis below which the state is ``converged``."""
    weak_arcsec: Annotated[float, msgspec.Meta(gt=0, le=3600)] = 60.0
    """Reachable deviation above which the motion is called weak."""
    forecast_s: Annotated[float, msgspec.Meta(ge=10, le=86400)] = 600.0
    """Record for which the reachable accuracy is forecast."""
    delay_warning_ms: Annotated[float, msgspec.Meta(gt=0, le=1000)] = 20.0
    mount_deg: tuple[float, float, float] | None = None
    """Expected x, y, z; when given, an estimate further off than ``mount_tolerance_deg`` is named."""
    mount_tolerance_deg: Annotated[float, msgspec.Meta(gt=0, le=180)] = 5.0
    base_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The crane base from the IMU amidships: forward, port, up. Monitoring points of the frame "crane" start there."""


class HullState(StrEnum):
    """How far the deformation can be trusted."""

    STARTING = "starting"
    """No alignment yet, or a provisional one."""
    CONVERGING = "converging"
    CONVERGED = "converged"
    WEAK = "weak"
    """The motion does not determine the deformation."""
    HOLDING = "holding"
    """No pair of readings for two seconds or more: the last static deformation, the flexure forgotten."""


class HullWarning(StrEnum):
    """What makes the deformation worth less, or is wrong with an IMU."""

    WEAK_MOTION = "weak_motion"
    SINGLE_AXIS = "single_axis"
    STUCK_MIDSHIPS = "stuck_midships"
    STUCK_LOCAL = "stuck_local"
    MISSING_MIDSHIPS = "missing_midships"
    MISSING_LOCAL = "missing_local"
    LOW_RATE_MIDSHIPS = "low_rate_midships"
    LOW_RATE_LOCAL = "low_rate_local"
    DELAY = "delay"
    CLOCK_DRIFT = "clock_drift"
    INCONSISTENT = "inconsistent"
    """The two streams are not those of one hull, or the errors are larger than configured."""
    SWAPPED = "swapped"
    MOUNT = "mount"
    GIMBAL = "gimbal"
    """y near +-90 degrees: x and z are not defined one by one, C is."""


class HullEstimate(msgspec.Struct, frozen=True, eq=False, gc=False, kw_only=True):
    """The deformation, as it is published and as matrices. nan: not known (yet)."""

    angles: HullAngles
    """Valid at a moment a good second before the newest pair, for what is slow is known from both sides."""
    local_from_midships: Array
    """(3, 3) C, total: static, mounting and flexure."""
    static: Array
    """(3, 3) C0, without the flexure."""
    covariance_rad2: Array
    """(3, 3) of the total about the hull's axes, as the filter has it: without the floor."""
    bias_radps: tuple[float, float, float] = (nan, nan, nan)
    """Gyro bias, local minus midships, local axes."""
