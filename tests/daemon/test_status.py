"""The STATUS record and its one line."""

from __future__ import annotations

import msgspec
import pytest

from heaved.config.read import data_directory, load
from heaved.daemon.acquisition import Acquisition
from heaved.daemon.daemon import make_pipeline
from heaved.daemon.metrics import Metrics
from heaved.daemon.status import status_line, status_record
from heaved.daemon.utc_clock import UtcClock
from heaved.outputs import wire
from heaved.outputs.output import OutputHealth
from heaved.outputs.records import HeaveStatus, OutputStatus, StatusRecord
from heaved.samples import (
    CorrectionState,
    Fault,
    HeaveState,
    LaserState,
    MotionFrame,
    Quality,
    SeaState,
    Vibration,
)

CONFIG = load(data_directory() / "sensors.toml")
QUALITY = Quality(heave=HeaveState.VALID, laser=LaserState.VALID, correction=CorrectionState.OFF)


@pytest.fixture
def acquisition() -> Acquisition:
    acquisition = Acquisition(
        make_pipeline(CONFIG),
        metrics=Metrics("test"),
        publish=lambda _frame: None,
        train=lambda _window: None,
        fit=lambda _past: None,
        clock=lambda: 110.0,
    )
    acquisition.set_devices(CONFIG.device)
    return acquisition


def record_of(acquisition: Acquisition, *outputs: OutputHealth) -> StatusRecord:
    return status_record(
        acquisition,
        CONFIG,
        now_s=110.0,
        started_s=100.0,
        utc=UtcClock(lambda: 0.0, lambda: 1.7e9),
        outputs=outputs,
        clients=2,
        dropped=0,
        config_file=None,
        state_file=None,
    )


def test_before_the_first_frame_and_poll_it_is_whole_json(acquisition: Acquisition) -> None:
    line = wire.encode_record(record_of(acquisition))
    assert b"null" not in line
    assert msgspec.json.decode(line, type=StatusRecord).uptime_s == 10.0
    assert wire.decode(line)["quality"] == {
        "heave": "invalid", "laser": "off", "correction": "off", "reasons": ["no frame yet"],
    }  # fmt: skip


def test_outputs(acquisition: Acquisition) -> None:
    well, broken = OutputHealth("dp", "EM3000", "udp://10.0.0.9:5000"), OutputHealth("plc", "TSS1", "/dev/ttyUSB2")
    well.up()
    well.sent = 1000
    broken.down("/dev/ttyUSB2 is not there: plug the adapter in")
    broken.lost["down"] = 7
    record = record_of(acquisition, well, broken)
    assert record.outputs == (
        OutputStatus(name="dp", kind="EM3000", link="udp://10.0.0.9:5000", up=True, sent=1000),
        OutputStatus(
            name="plc",
            kind="TSS1",
            link="/dev/ttyUSB2",
            up=False,
            lost={"down": 7},
            detail="/dev/ttyUSB2 is not there: plug the adapter in",
        ),
    )
    assert status_line(record).endswith("laser down (not polled yet), output plc down")
    assert msgspec.json.decode(wire.encode_record(record), type=StatusRecord).outputs == record.outputs


def test_devices(acquisition: Acquisition) -> None:
    imu = acquisition.health["imu"]
    for number in range(5):
        imu.observe(100.0 + number, Fault.NONE, "")
    for number in range(4):
        imu.observe(105.0 + number, Fault.TIMEOUT, "no answer: check power and cable")
    record = record_of(acquisition)
    device = record.devices[0]
    assert (device.name, device.up, device.results) == ("imu", False, {"none": 5, "timeout": 4})
    assert (device.last_fault, device.last_fault_age_s) == ("timeout", 2.0)
    assert device.detail == "no answer: check power and cable"
    assert status_line(record) == "heave invalid, 0.0 Hz, 2 clients, imu down (timeout), laser down (not polled yet)"


def test_what_the_observer_has_found_out(acquisition: Acquisition) -> None:
    acquisition.last_frame = MotionFrame(
        t_s=109.9,
        quality=Quality(heave=HeaveState.VALID, laser=LaserState.OFF, correction=CorrectionState.OFF),
        sea=SeaState(
            significant_height_m=2.5, peak_period_s=9.0, mean_period_s=7.5, systems=(), frequencies_hz=(),
            spectrum_m2phz=(), t_s=98.0, noise_mps2_rthz=1.2345e-3,
            vibration=(Vibration(frequency_hz=3.10004, width_hz=0.0216, rms_mps2=0.212134),),
        ),
    )  # fmt: skip
    observer = wire.decode(wire.encode_record(record_of(acquisition)))["observer"]
    assert observer == {
        "name": "sea", "fit_age_s": 12.0, "noise_mps2_rthz": 0.00123,
        "vibration": [{"frequency_hz": 3.1, "width_hz": 0.022, "rms_mps2": 0.2121}],
    }  # fmt: skip


def test_line_when_all_is_well(acquisition: Acquisition) -> None:
    for health in acquisition.health.values():
        health.observe(109.0, Fault.NONE, "")
    heave = HeaveStatus(heave_m=-0.1234, heave_std_m=0.0312, age_s=0.01)
    record = msgspec.structs.replace(record_of(acquisition), heave=heave, quality=QUALITY, rate_hz=99.97, clients=1)
    assert status_line(record) == "heave valid -0.12 m ± 0.03 m, 100.0 Hz, 1 client, imu up, laser up"
    assert status_line(msgspec.structs.replace(record, devices=())).endswith("1 client, no devices configured")
