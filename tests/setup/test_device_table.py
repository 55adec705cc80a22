"""The table that is written is read back as the very device, and its rate suits line, bandwidth and vibration."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest

from heaved.config.read import packaged_profiles, parse
from heaved.devices.probe import Variant
from heaved.devices.profile import Block, Field, Profile
from heaved.links import SerialLink, TcpLink, parse_link
from heaved.setup.device_table import line_share, link_text, rate, role_of, table, toml
from heaved.setup.polling import Channel, Measured
from heaved.setup.sensor_record import Line, Noise, Pace, RoundTrips

if TYPE_CHECKING:
    from heaved.devices.profile import Role

PROFILES = {profile.name: profile for profile in packaged_profiles()}
WITMOTION = PROFILES["witmotion-wt901c485"]


def measured(*lines_hz: float, median_s: float = 0.001) -> Measured:
    channel = Channel(quantity="az_mps2", noise=Noise(density=1e-3), lines=[Line(f, 0.1) for f in lines_hz])
    trips = RoundTrips(
        answers=100, lost=0, median_s=median_s, p95_s=1.1 * median_s, p99_s=1.5 * median_s, worst_s=2.0 * median_s
    )
    pace = Pace(polls_hz=100.0, new_hz=100.0, kind="every poll")
    return Measured(
        seconds=10.0, pace=pace, round_trips=trips, wire_s=0.0, age_spread_s=float("nan"), channels=[channel]
    )


TABLES: dict[str, dict[str, Any]] = {
    "as it is": {"variant": Variant(profile=WITMOTION), "device_id": 80},
    "measured": {"variant": Variant(profile=WITMOTION), "measured": measured(25.0, median_s=0.047)},
    "with another bandwidth": {"variant": Variant(profile=WITMOTION), "set_bandwidth_hz": 42.0},
    "as asked for": {"variant": Variant(profile=WITMOTION), "rate_hz": 12.5},
    "with an address off by one": {"variant": Variant(profile=WITMOTION, shift=1)},
    "with everything changed": {
        "variant": Variant(profile=PROFILES["heaved-sim-imu"], shift=1, other_function=True, byte_order="CDAB")
    },
    "a laser over TCP, in doubt": {
        "variant": Variant(profile=PROFILES["baumer-om20"]), "role": "laser", "link": "tcp://192.168.1.20:502",
        "doubt": "such values alone prove nothing",
    },
}  # fmt: skip


@pytest.mark.parametrize("name", TABLES)
def test_what_is_written_is_read_back_as_the_very_device(name: str) -> None:
    given: dict[str, Any] = {
        "name": "imu",
        "role": "imu",
        "link": "rtu:///dev/ttyUSB0?baudrate=115200&parity=N",
        "device_id": 7,
    }
    found = table(**(given | {"heading": "Found"} | TABLES[name]))
    text = toml(found)
    config = parse(tomllib.loads(text), file="it", directory=Path("/nonexistent"))
    assert config.device == (found.device,)
    assert text.startswith("# Found\n")
    assert ("# Not proved" in text) is bool(found.doubt)


def test_the_profiles_of_the_program_are_written_in_full_and_read_back() -> None:
    from heaved.setup.device_table import profile_lines

    for profile in PROFILES.values():
        text = "[[device]]\n" + "\n".join(profile_lines(profile, ["a note"]))
        (device,) = tomllib.loads(text)["device"]
        assert msgspec.convert(device["profile"], Profile) == profile


def test_the_keys_say_why() -> None:
    found = table(
        name="imu", role="imu", link="rtu:///dev/ttyUSB0?baudrate=9600", device_id=80, heading="Found",
        variant=Variant(profile=WITMOTION), measured=measured(median_s=0.047), set_bandwidth_hz=10.0,
    )  # fmt: skip
    text = toml(found)
    # 45.8 ms of line and some thinking a poll: 21 a second, of which four fifths are used.
    assert "rate_hz = 16.0  # the line carries 17; at 16 Hz, less than twice its bandwidth of 10 Hz" in text
    assert "timeout_ms = 150.0  # answers: median 47, 95 % 51.7, slowest 94 ms" in text
    # 0.2 / 10 Hz.
    assert "latency_ms = -20.0  # lag of a low-pass of 10 Hz" in text
    assert "bandwidth_hz = 10.0  # as its register says" in text


SERIAL, FAST, TCP = SerialLink("/dev/x", 9600), SerialLink("/dev/x", 115200), TcpLink("127.0.0.1", 502)
RATES: dict[str, tuple[float, tuple[Any, ...]]] = {
    "all that is of use": (100.0, ("imu", TCP, WITMOTION, 20.0, None)),
    "a fast line": (100.0, ("imu", FAST, WITMOTION, 20.0, None)),
    "a slow line": (16.0, ("imu", SERIAL, WITMOTION, 20.0, None)),
    "a slow sensor": (12.5, ("imu", TCP, WITMOTION, 20.0, measured(median_s=0.06))),
    "a very slow sensor": (0.4, ("imu", TCP, WITMOTION, 20.0, measured(median_s=2.0))),
    "a laser": (20.0, ("laser", TCP, PROFILES["baumer-om20"], 0.0, None)),
    "a crane": (10.0, ("crane", TCP, PROFILES["heaved-sim-crane"], 0.0, None)),
    # Carries 80 / 1.5: 53. At 50 Hz a line of 50.2 is a wave of 5 s.
    "a line that would fold": (40.0, ("imu", TCP, WITMOTION, 20.0, measured(50.2, median_s=0.015))),
    # Twice the bandwidth comes first: there is no rate of 40 Hz or more at which neither folds.
    "lines that fold anyhow": (50.0, ("imu", TCP, WITMOTION, 20.0, measured(50.2, 40.1, median_s=0.015))),
    "a shared line": (50.0, ("imu", TCP, WITMOTION, 20.0, None, 0.55)),
}


@pytest.mark.parametrize("name", RATES)
def test_the_rate_suits(name: str) -> None:
    expected_hz, arguments = RATES[name]
    found = rate(*arguments)
    assert found.hertz == expected_hz
    assert ("would read as waves" in found.reason) is (name == "a line that would fold")
    assert ("50.2, 40.1 Hz" in found.reason or "50.2 Hz reads as waves" in found.reason) is (
        name == "lines that fold anyhow"
    )


def test_devices_on_one_line_share_it() -> None:
    sharing: list[tuple[Role, Profile]] = [("imu", WITMOTION), ("laser", PROFILES["witmotion-wt53r-485"])]
    assert line_share(TCP, sharing) == 1.0
    share = line_share(SERIAL, sharing)
    rates = [rate(role, SERIAL, profile, 0.0, None, share).hertz for role, profile in sharing]
    # 100 polls of 37 characters and twice 3.5 of silence, 20 of 15: 1.04 ms each at 9600 baud.
    assert share == pytest.approx(0.8 / (100 * 44 * 10 / 9600 + 20 * 22 * 10 / 9600), rel=0.01)
    assert rates[0] * 44 / 960 + rates[1] * 22 / 960 <= 0.8


ROLES: dict[str, Role | None] = {
    "witmotion-wt901c485": "imu", "baumer-om20": "laser", "heaved-sim-imu2": "imu2", "heaved-sim-crane": "crane",
    "heaved-sim-craft": "craft", "smc-imu-108": "reference_mru", "bewis-mins127": "pitch_sensor",
}  # fmt: skip


@pytest.mark.parametrize("name", ROLES)
def test_what_a_device_is_good_for(name: str) -> None:
    assert role_of(PROFILES[name]) == ROLES[name]


def test_a_temperature_is_good_for_nothing() -> None:
    field = Field(quantity="temperature_c", offset=0, unit="degC")
    assert role_of(Profile(name="x", blocks=(Block(start=0, fields=(field,)),))) is None


LINKS: tuple[tuple[SerialLink | TcpLink, str, str], ...] = (
    (SerialLink("/dev/ttyUSB0"), "", "rtu:///dev/ttyUSB0?baudrate=9600&parity=N"),
    (SerialLink("/dev/ttyUSB0", 57600, "E", 2), "/dev/serial/by-id/usb-A_B-if00",
     "rtu:///dev/serial/by-id/usb-A_B-if00?baudrate=57600&parity=E&stopbits=2"),
    # A name that no link can hold: the port's own.
    (SerialLink("/dev/ttyUSB0"), "/dev/serial/by-id/usb-A?B#1", "rtu:///dev/ttyUSB0?baudrate=9600&parity=N"),
    (SerialLink("/dev/ttyUSB0"), "/dev/serial/by-id/usb-A B", "rtu:///dev/ttyUSB0?baudrate=9600&parity=N"),
    (TcpLink("fd00::7", 502), "", "tcp://[fd00::7]:502"),
)  # fmt: skip


@pytest.mark.parametrize(("link", "lasting", "expected"), LINKS)
def test_links_are_written_as_they_are_read(link: SerialLink | TcpLink, lasting: str, expected: str) -> None:
    assert link_text(link, lasting) == expected
    parsed = parse_link(expected)
    if isinstance(link, SerialLink):
        assert isinstance(parsed, SerialLink)
        assert msgspec.structs.replace(parsed, path="") == msgspec.structs.replace(link, path="")
    else:
        assert parsed == link
