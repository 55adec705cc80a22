"""``[registers]``: what cannot be served, or would disturb others, is named with numbers and advice."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from heaved.config.read import ConfigError, parse
from heaved.outputs.register_map import Mode, RegistersParams
from heaved.outputs.telegrams.spec import HeavePositive, PitchPositive, RollPositive

if TYPE_CHECKING:
    from heaved.config import Config

DEVICE = """
[[device]]
name = "imu"
role = "imu"
link = "{}"
profile = "heaved-sim-imu"
rate_hz = 10
"""
POINT = '[[point]]\nname = "tip"\n'
ON = "[registers]\nenabled = true\n"
SERIAL = ON + 'link = "rtu:///dev/ttyS1?baudrate=9600"\n'
PUSH = ON + 'mode = "push"\nlink = "tcp://10.0.0.5:502"\n'


def read(text: str) -> Config:
    return parse(tomllib.loads(text), file="test.toml", directory=Path("/nonexistent"))


def faults_of(text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        read(text)
    return caught.value.faults


@pytest.mark.parametrize(
    "text",
    [
        ON,
        PUSH,
        SERIAL,
        PUSH + "count = 66",
        ON + 'point = "tip"\n' + POINT,
        ON.replace("[registers]\n", '[registers]\nallow = ["10.0.0.0/8"]\nlink = "tcp://0.0.0.0:502"\n'),
        ON + "start = 65470",
        PUSH + "start = 65530",
        ON + 'link = "tcp://127.0.0.1:5570"\n[stream]\nport = 0',
        ON + 'link = "tcp://127.0.0.1:9570"\n[http]\nenabled = false',
        ON + 'link = "tcp://127.0.0.2:5570"',
        ON + "horizons_s = []",
        ON + "horizons_s = [3.0]\n[heave]\nforecast_horizons_s = [3.0]\n[rock]\nhorizons_s = [3.0]",
        PUSH.replace("10.0.0.5:502", "127.0.0.1:502"),
        SERIAL + DEVICE.format("rtu:///dev/ttyS2?baudrate=9600"),
        PUSH + DEVICE.format("tcp://10.0.0.5:502"),
        SERIAL + 'mode = "push"\nrate_hz = 26',
        # What is not enabled is in nobody's way.
        '[registers]\nlink = "tcp://0.0.0.0:5570"\npoint = "nowhere"\nstart = 65535',
    ],
)
def test_sound(text: str) -> None:
    assert read(text).registers is not None


def test_values_reach_their_keys() -> None:
    text = (
        PUSH + 'device_id = 7\nstart = 100\nrate_hz = 5\ncount = 8\npoint = "tip"\nlead = "none"\n'
        'heave_positive = "down"\nroll_positive = "starboard_up"\npitch_positive = "bow_up"\nhorizons_s = [1.0]\n'
    )
    assert read(text + POINT).registers == RegistersParams(
        enabled=True, mode=Mode.PUSH, link="tcp://10.0.0.5:502", device_id=7, start=100, rate_hz=5.0, count=8,
        point="tip", lead=RegistersParams().lead.NONE, heave_positive=HeavePositive.DOWN,
        roll_positive=RollPositive.STARBOARD_UP, pitch_positive=PitchPositive.BOW_UP, horizons_s=(1.0,),
    )  # fmt: skip


FAULTS: dict[str, tuple[str, str]] = {
    "no such link": (ON + 'link = "udp://10.0.0.1:5502"', "registers.link: link 'udp://10.0.0.1:5502': unknown scheme"),
    "no port": (ON + 'link = "tcp://127.0.0.1"', "registers.link: link 'tcp://127.0.0.1': the port is missing"),
    "no such mode": (ON + 'mode = "master"', "registers.mode: must be 'serve' or 'push' (got 'master')"),
    "no such point": (ON + 'point = "tip"', "registers.point: no [[point]] is named 'tip'"),
    "a horizon twice": (ON + "horizons_s = [1.0, 1]", "registers.horizons_s: names a horizon twice"),
    "a horizon of nobody": (
        ON + "horizons_s = [1.0, 3.0, 4.0]",
        "registers.horizons_s: 3, 4 s is not among heave.forecast_horizons_s: add it there, or leave it out here",
    ),
    "a horizon of heave alone": (
        ON + "horizons_s = [3.0]\n[heave]\nforecast_horizons_s = [3.0]",
        "registers.horizons_s: 3 s is not among rock.horizons_s",
    ),
    "beyond the last register": (
        ON + "start = 65471",
        "registers.start: 65471 and the 66 registers of the map end beyond register 65535: start at 65470 or below",
    ),
    "beyond, by a point": (ON + "start = 65470\n" + POINT, "start: 65470 and the 70 registers of the map end beyond"),
    "written beyond": (PUSH + "start = 65531", "registers.start: 65531 and the 6 registers of the map end beyond"),
    "more than there are": (PUSH + "count = 67", "registers.count: the map has 66 registers, not 67"),
    "the stream's port": (
        ON + 'link = "tcp://127.0.0.1:5570"',
        "registers.link: port 5570 is also that of stream.port",
    ),
    "the port of http": (ON + 'link = "tcp://localhost:9570"', "registers.link: port 9570 is also that of http.port"),
    "a port on all addresses": (
        ON + 'link = "tcp://0.0.0.0:5570"\nallow = ["10.0.0.0/8"]',
        "registers.link: port 5570 is also that of stream.port",
    ),
    "for all": (
        ON + 'link = "tcp://0.0.0.0:5502"',
        "registers.link: 0.0.0.0 listens beyond this machine; name who may",
    ),
    "a name": (ON + 'link = "tcp://crane-pc:5502"', "registers.link: 'crane-pc' is no IP address"),
    "no network": (ON + 'allow = ["10.0.0.1/8"]', "registers.allow[0]: '10.0.0.1/8' is not a network such as"),
    "a device's address": (
        ON + 'link = "tcp://127.0.0.1:502"' + DEVICE.format("tcp://127.0.0.1:502"),
        "device[0].link: at tcp://127.0.0.1:502 heaved itself listens (registers.link)",
    ),
    "a device's line": (
        SERIAL + DEVICE.format("rtu:///dev/ttyS1?baudrate=115200"),
        "registers.link: /dev/ttyS1 is the port of device[0] already: give each a port of its own",
    ),
    "a device's line to push": (
        SERIAL + 'mode = "push"\n' + DEVICE.format("rtu:///dev/../dev/ttyS1"),
        "registers.link: /dev/ttyS1 is the port of device[0]",
    ),
    "broadcast on a line": (
        SERIAL + "device_id = 0",
        "registers.device_id: 0 is no address on a serial line: 1 to 247",
    ),
    "beyond the ids": (SERIAL + "device_id = 248", "registers.device_id: 248 is no address on a serial line: 1 to 247"),
    # 29 characters of 10 bits and two silences of 3.5 at 9600 baud: 37.5 ms.
    "faster than the line": (
        SERIAL + 'mode = "push"\nrate_hz = 27',
        "registers.rate_hz: 27 is too high for /dev/ttyS1 (9600 8N1): a write of 6 registers takes 37.5 ms there, so "
        "26.6 Hz at most",
    ),
    "too many at once": (PUSH + "count = 124", "registers.count: Expected `int` <= 123"),
}


@pytest.mark.parametrize("case", FAULTS)
def test_a_fault_is_named(case: str) -> None:
    text, expected = FAULTS[case]
    faults = faults_of(text)
    assert any(expected in fault for fault in faults), faults


def test_a_key_that_is_wrong_already_is_named_once() -> None:
    (fault,) = faults_of(ON + "start = 70000")
    assert fault.startswith("registers.start: Expected `int` <= 65535")
