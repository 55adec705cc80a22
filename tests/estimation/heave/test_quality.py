"""Oracle: the table of what a consumer is to be told, written out."""

from math import nan

import msgspec
import pytest

from heaved.estimation.heave.quality import Facts, judge
from heaved.samples import Fault, HeaveState

WELL = Facts(
    imu_fault=Fault.NONE,
    since_sample_s=0.0,
    period_s=0.05,
    settled_s=100.0,
    needed_s=30.0,
    error_std_m=0.02,
    heave_std_m=0.5,
    missing=0.0,
    doubts=(),
    notes=(),
    is_still=False,
    tilt_removed=True,
    std_scale=1.0,
    remarks=(),
    laser_fault=Fault.NONE,
    laser_configured=True,
    laser_fresh=True,
)
VALID, SETTLING, DEGRADED, INVALID = HeaveState.VALID, HeaveState.SETTLING, HeaveState.DEGRADED, HeaveState.INVALID
BROAD = "error above a fifth of the heave"
TILT = "no attitude or no horizontal acceleration: tilt not removed"
SHAKES = "vibration: seen at 3.1 Hz, 0.21 m/s2"

TABLE = [
    ({}, VALID, ()),
    ({"since_sample_s": 0.09}, VALID, ()),
    ({"since_sample_s": 0.11}, DEGRADED, ("imu: samples missing, extrapolated",)),
    ({"since_sample_s": 0.11, "period_s": 0.1}, VALID, ()),
    ({"since_sample_s": 0.21, "period_s": 0.1}, DEGRADED, ("imu: samples missing, extrapolated",)),
    ({"since_sample_s": 0.2, "imu_fault": Fault.CRC}, DEGRADED, ("imu: crc, extrapolated",)),
    ({"since_sample_s": 1.0}, DEGRADED, ("imu: samples missing, extrapolated",)),
    ({"since_sample_s": 1.01}, INVALID, ("imu: no samples",)),
    ({"since_sample_s": 9.0, "imu_fault": Fault.TIMEOUT}, INVALID, ("imu: timeout",)),
    ({"since_sample_s": nan, "period_s": nan, "settled_s": nan, "error_std_m": nan}, INVALID, ("imu: no samples",)),
    ({"settled_s": 12.0, "error_std_m": nan}, SETTLING, ("settling: 12 s of 30 s",)),
    ({"settled_s": nan, "error_std_m": nan}, SETTLING, ("settling: 0 s of 30 s",)),
    ({"settled_s": 16.0}, SETTLING, ("settling: 16 s of 30 s",)),
    ({"settled_s": 16.0, "tilt_removed": False}, SETTLING, (TILT, "settling: 16 s of 30 s")),
    ({"tilt_removed": False}, DEGRADED, (TILT,)),
    ({"error_std_m": 0.12}, DEGRADED, (BROAD,)),
    ({"error_std_m": 0.005, "heave_std_m": 0.006}, VALID, ()),
    ({"error_std_m": 0.12, "std_scale": 0.5}, DEGRADED, (BROAD,)),
    ({"error_std_m": 0.12, "std_scale": 2.0}, DEGRADED, ("laser and observer disagree",)),
    ({"error_std_m": 0.26}, INVALID, ("error above half of the heave",)),
    ({"error_std_m": 0.26, "tilt_removed": False}, INVALID, ("error above half of the heave", TILT)),
    ({"error_std_m": 0.26, "std_scale": 3.0}, DEGRADED, ("laser and observer disagree",)),
    ({"error_std_m": 0.26, "settled_s": 16.0}, SETTLING, (BROAD, "settling: 16 s of 30 s")),
    ({"error_std_m": 0.024, "heave_std_m": 0.01}, DEGRADED, (BROAD,)),
    ({"period_s": 0.25}, VALID, ()),
    ({"period_s": 0.5}, DEGRADED, ("imu: 2.0 samples a second: waves shorter than 1.4 s are lost",)),
    ({"period_s": 2.0}, INVALID, ("imu: samples 2.0 s apart do not show waves",)),
    ({"std_scale": 3.1}, DEGRADED, ("laser and observer disagree",)),
    ({"missing": 0.24}, VALID, ()),
    ({"missing": 0.3}, DEGRADED, ("imu: 30 % of the samples missing",)),
    ({"doubts": ("it drifts",), "notes": ("still",)}, DEGRADED, ("it drifts", "still")),
    ({"notes": ("still",)}, VALID, ("still",)),
    # A still ship has no heave to compare with; one that shakes has.
    ({"error_std_m": 0.04, "heave_std_m": 0.01, "is_still": True, "notes": ("still",)}, VALID, ("still",)),
    (
        {"error_std_m": 0.04, "heave_std_m": 0.01, "notes": (SHAKES,)},
        INVALID,
        (
            "error above half of the heave",
            SHAKES,
        ),
    ),
    ({"error_std_m": 0.02, "heave_std_m": 0.05, "notes": (SHAKES,)}, DEGRADED, (BROAD, SHAKES)),
    ({"notes": (SHAKES,)}, VALID, (SHAKES,)),
    ({"doubts": ("it drifts",), "settled_s": 16.0}, SETTLING, ("it drifts", "settling: 16 s of 30 s")),
    ({"laser_fresh": False}, VALID, ("laser: no fresh reference",)),
    ({"laser_fresh": False, "laser_fault": Fault.STUCK}, VALID, ("laser: stuck",)),
    ({"laser_fresh": False, "laser_configured": False}, VALID, ()),
    ({"remarks": ("laser: it is of feet",)}, VALID, ("laser: it is of feet",)),
    ({"laser_fresh": False, "since_sample_s": 2.0}, INVALID, ("imu: no samples", "laser: no fresh reference")),
]


@pytest.mark.parametrize(("changed", "state", "reasons"), TABLE)
def test_state_and_reasons(changed: dict[str, object], state: HeaveState, reasons: tuple[str, ...]) -> None:
    assert judge(msgspec.structs.replace(WELL, **changed)) == (state, reasons)
