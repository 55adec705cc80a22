"""Faults of the configuration of devices that speak by themselves. Oracle: the words that a person needs."""

import tomllib
from pathlib import Path

import pytest

from heaved.config import Config
from heaved.config.read import ConfigError, packaged_profiles, packaged_sentences, parse
from heaved.config.rules import cautions

BOX = """
[[device]]
name = "box"
role = "craft"
link = "LINK"
rate_hz = 10
[device.profile]
name = "box"
[[device.profile.sentences]]
header = "$--XDR"
fields = [{ quantity = "pitch_rad", transducer = "PTCH", unit = "deg" }]
"""
SLAVE = """
[[device]]
name = "slave"
role = "heave_sensor"
link = "LINK"
rate_hz = 2
[device.profile]
name = "slave"
[[device.profile.blocks]]
start = 0
fields = [{ quantity = "heave_m", offset = 0, unit = "m" }]
"""


def read(text: str) -> Config:
    return parse(tomllib.loads(text), file="test.toml", directory=Path("/nonexistent"))


def box(link: str, extra: str = "") -> str:
    return BOX.replace("LINK", link).replace("rate_hz = 10", f"rate_hz = 10\n{extra}")


SOUND = {
    "udp": box("udp-listen://127.0.0.1:5601"),
    "udp from the network": box("udp-listen://0.0.0.0:5601", 'allow = ["10.0.0.0/8"]'),
    "serial": box("serial:///dev/ttyUSB9?baudrate=4800"),
    "a box on the network": box("tcp://192.168.1.30:4001"),
    "two of them": box("udp-listen://127.0.0.1:5601")
    + box("udp-listen://127.0.0.1:5602").replace('"box"', '"other"').replace("craft", "pitch_sensor"),
}


@pytest.mark.parametrize("name", SOUND)
def test_sound(name: str) -> None:
    assert not any(device.is_asked for device in read(SOUND[name]).device)


FAULTS = {
    "a scheme for Modbus": (box("rtu:///dev/ttyUSB9"), "device[0].link: ", "unknown scheme 'rtu'"),
    "sentences of a device that is asked": (
        SLAVE.replace("LINK", "serial:///dev/ttyUSB9"),
        "device[0].link: ",
        "it must be tcp://host:port or rtu:///dev/port",
    ),
    "beyond this machine for anybody": (
        box("udp-listen://0.0.0.0:5601"),
        "device[0].link: ",
        "listens beyond this machine; name who may connect in device[0].allow",
    ),
    "a name to listen on": (box("udp-listen://crane:5601"), "device[0].link: ", "is no IP address"),
    "a network that is none": (
        box("udp-listen://127.0.0.1:5601", 'allow = ["10.0.0.1/8"]'),
        "device[0].allow[0]: ",
        "host bits",
    ),
    "allow where nobody can send": (
        box("serial:///dev/ttyUSB9", 'allow = ["10.0.0.0/8"]'),
        "device[0].allow: ",
        "udp-listen link alone",
    ),
    "one port for two": (
        box("udp-listen://127.0.0.1:5601")
        + box("udp-listen://0.0.0.0:5601", 'allow = ["10.0.0.0/8"]')
        .replace('"box"', '"other"')
        .replace("craft", "pitch_sensor"),
        "device[1].link: ",
        "port 5601 is also that of device[0].link",
    ),
    "a line for one that speaks and one that is asked": (
        SLAVE.replace("LINK", "rtu:///dev/ttyUSB9") + box("serial:///dev/./ttyUSB9"),
        "device[1].link: ",
        "give each a port of its own",
    ),
    "blocks beside sentences": (
        box("udp-listen://127.0.0.1:5601")
        + '[[device.profile.blocks]]\nstart = 0\nfields = [{ quantity = "heave_m", offset = 0, unit = "m" }]\n',
        "device[0].profile: ",
        "has both blocks and sentences",
    ),
    "a header with a star": (
        box("udp-listen://127.0.0.1:5601").replace("$--XDR", "A*B"),
        "device[0].profile.sentences[0].header: ",
        "regex",
    ),
    "a header with the separator at its end": (
        box("udp-listen://127.0.0.1:5601").replace("$--XDR", "$CRN;").replace("fields", 'separator = ";"\nfields'),
        "device[0].profile.sentences[0]: ",
        "header ends with the separator",
    ),
    "columns beyond the line": (
        box("udp-listen://127.0.0.1:5601")
        .replace('transducer = "PTCH"', "columns = [20, 30]")
        .replace("fields", "length = 25\nfields"),
        "device[0].profile.sentences[0]: ",
        "are not first and last of 25",
    ),
    "nothing for the role": (
        box("udp-listen://127.0.0.1:5601").replace('"craft"', '"heave_sensor"'),
        "device[0].profile: ",
        "has no heave_m, which role 'heave_sensor' needs",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_are_named(name: str) -> None:
    text, path, words = FAULTS[name]
    with pytest.raises(ConfigError) as caught:
        read(text)
    assert any(fault.startswith(path) and words in fault for fault in caught.value.faults), caught.value.faults


MRU = box("udp-listen://127.0.0.1:5601").replace('"craft"', '"reference_mru"')


def test_a_reference_mru_needs_its_point_and_an_imu() -> None:
    with pytest.raises(ConfigError) as caught:
        read(MRU + '[reference_mru]\npoint = "mru"\n')
    assert caught.value.faults == ["reference_mru.point: no [[point]] is named 'mru'"]
    config = read(MRU + '[reference_mru]\npoint = "mru"\n[[point]]\nname = "mru"\nforward_m = 3.0\n')
    assert any("there is nothing to compare it with" in caution for caution in cautions(config))


def test_packaged_profiles_are_told_apart_by_how_they_are_read() -> None:
    asked, speaking = packaged_profiles(), packaged_sentences()
    assert {profile.name for profile in speaking} >= {"tss1", "pashr"}
    assert all(profile.blocks and not profile.sentences for profile in asked)
    assert not {profile.name for profile in asked} & {profile.name for profile in speaking}
