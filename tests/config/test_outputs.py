"""``[[output]]``: what cannot be, is named with its path; what may not be meant, is said."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import pytest

from heaved.config.read import ConfigError, data_directory, parse
from heaved.config.rules import cautions
from heaved.outputs.telegrams.formats import FORMATS
from heaved.outputs.telegrams.spec import HeavePositive, OutputSpec, Telegram

if TYPE_CHECKING:
    from heaved.config import Config

IMU = """
[[device]]
name = "imu"
role = "imu"
link = "tcp://10.0.0.7:502"
rate_hz = 100
[device.profile]
name = "inline"
[[device.profile.blocks]]
start = 0
fields = [{ quantity = "az_mps2", offset = 0, type = "float32", unit = "m/s2" }]
"""

SPEAKING = """
[[device]]
name = "box"
role = "craft"
link = "serial:///dev/ttyUSB7"
rate_hz = 10
[device.profile]
name = "box"
[[device.profile.sentences]]
header = "$--XDR"
fields = [{ quantity = "pitch_rad", transducer = "PTCH", unit = "deg" }]
"""


def output(**keys: object) -> str:
    """A table that is well, but for ``keys``; None: left out."""
    table = {"name": "plc", "telegram": "tss1", "link": "udp://10.0.0.9:5000"} | keys
    lines = [f"{key} = {value!r}" for key, value in table.items() if value is not None]
    return "\n[[output]]\n" + "\n".join(lines).replace("(", "[").replace(",)", "]") + "\n"


def read(text: str) -> Config:
    return parse(tomllib.loads(text), file="test.toml", directory=Path("/nonexistent"))


def faults_of(text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        read(text)
    return caught.value.faults


SERIAL = "serial:///dev/ttyUSB7"
OTHER = output(name="other", link="tcp-listen://127.0.0.1:10110")

FAULTS: dict[str, tuple[str, str]] = {
    "one table": ('[output]\nname = "plc"', "output: is one table; write [[output]], once for each output"),
    "no telegram": (output(telegram=None), "output[0].telegram: missing"),
    "no such telegram": (output(telegram="nmea"), "output[0].telegram: must be 'tss1', 'em1000', 'em3000'"),
    "no such lead": (output(lead="now"), "output[0].lead: must be 'none', 'transmission' or 'compensation'"),
    "no such sign": (output(heave_positive="yes"), "output[0].heave_positive: must be 'up' or 'down' (got 'yes')"),
    "unknown key": (output(baudrate=9600), "output[0].baudrate: unknown key; known here: name, telegram, link"),
    "a name with a space": (output(name="the plc"), "output[0].name: Expected `str` matching regex"),
    "one name twice": (output() + output(telegram="em3000"), "output[1].name: 'plc' is already the name of output[0]"),
    "no such scheme": (
        output(link="rtu:///dev/ttyS0"),
        "output[0].link: link 'rtu:///dev/ttyS0': unknown scheme 'rtu'; it must be udp://host:port, tcp://host:port, "
        "tcp-listen://host:port or serial:///dev/port",
    ),
    "no port": (output(link="udp://10.0.0.9"), "output[0].link: link 'udp://10.0.0.9': the port is missing"),
    "no such parity": (output(link=f"{SERIAL}?parity=X"), "parity 'X' must be N, E or O"),
    "no such point": (output(point="tip"), "output[0].point: no [[point]] is named 'tip'"),
    "never": (output(rate_hz=0), "output[0].rate_hz: Expected `float` > 0.0 (got 0)"),
    "more than the IMU": (
        IMU.replace("100", "20") + output(rate_hz=25),
        "output[0].rate_hz: 25 Hz, but the IMU is polled at 20, and each sample gives one telegram at the most",
    ),
    "more than its readers take": (output(rate_hz=26), "output[0].rate_hz: 26 Hz, but readers of tss1 take 25 at the"),
    "more than the line carries": (
        # 78 bytes of 10 bits: 81.25 ms at 9600 baud.
        output(link=SERIAL, rate_hz=25, telegram="pashr"),
        "output[0].rate_hz: pashr has up to 78 bytes, 81.2 ms on /dev/ttyUSB7 (9600 8N1): 25 Hz would take 204 % of "
        "the time; reachable: 12.3 Hz; set 38400 baud on the line and in the reader, or lower rate_hz",
    ),
    "an option of another format": (
        output(talker="HE"),
        "output[0].talker: tss1 has none; it is for xdr: take it out",
    ),
    "the default of an option of another format": (
        output(ins_good=1),
        "output[0].ins_good: tss1 has none; it is for pa",
    ),
    "settling of what tells no heave": (
        output(telegram="prdid", settling="error"),
        "output[0].settling: prdid has none",
    ),
    "an identifier that ends a field": (
        output(telegram="xdr", transducers=["HE,VE", "P", "R"]),
        "output[0].transducers",
    ),
    "allow for a link to which nobody connects": (
        output(allow=["10.0.0.0/8"]),
        "output[0].allow: says who may connect",
    ),
    "allow is no network": (
        output(link="tcp-listen://10.0.0.1:5000", allow=["10.0.0.1/8"]),
        "output[0].allow[0]: 10.0.0.1/8 has host bits set",
    ),
    "off-host without allow": (
        output(link="tcp-listen://0.0.0.0:5000"),
        "output[0].link: tcp-listen://0.0.0.0:5000 listens beyond this machine; name who may connect in output[0].all",
    ),
    "listening on a name": (output(link="tcp-listen://ship:5000"), "output[0].link: 'ship' is no IP address"),
    "two on one serial port": (
        output(link=SERIAL) + output(name="b", link=f"{SERIAL}?baudrate=19200"),
        "output[1].link: /dev/ttyUSB7 is the port of output[0] already",
    ),
    "the name of another kind of output": (
        output(name="mqtt"),
        "output[0].name: 'mqtt' is that of the table [mqtt]",
    ),
    "on the serial port of a device": (
        IMU.replace("tcp://10.0.0.7:502", "rtu:///dev/ttyUSB7?baudrate=115200") + output(link=SERIAL),
        "output[0].link: /dev/ttyUSB7 is the port of device[0] already",
    ),
    "to a device": (
        IMU + output(link="tcp://10.0.0.7:502"),
        "output[0].link: at tcp://10.0.0.7:502 there is already what device[0] talks to: correct one of them",
    ),
    "to a PLC that is written to": (
        '[registers]\nenabled = true\nmode = "push"\nlink = "tcp://10.0.0.8:502"' + output(link="tcp://10.0.0.8:502"),
        "output[0].link: at tcp://10.0.0.8:502 there is already what registers talks to",
    ),
    "on the serial port of the registers": (
        '[registers]\nenabled = true\nlink = "rtu:///dev/ttyUSB7?baudrate=19200"' + output(link=SERIAL),
        "output[0].link: /dev/ttyUSB7 is the port of registers already",
    ),
    "at the port of the registers": (
        '[registers]\nenabled = true\nlink = "tcp://127.0.0.1:5502"' + output(link="tcp-listen://127.0.0.1:5502"),
        "output[0].link: port 5502 is also that of registers.link: choose another",
    ),
    "on the serial port of a device that speaks": (
        SPEAKING + output(link=SERIAL),
        "output[0].link: /dev/ttyUSB7 is the port of device[0] already",
    ),
    "into our own ear": (
        SPEAKING.replace("serial:///dev/ttyUSB7", "udp-listen://127.0.0.1:5000") + output(link="udp://127.0.0.1:5000"),
        "output[0].link: at udp://127.0.0.1:5000 heaved itself listens (device[0].link): correct it",
    ),
    "two that listen at one port": (
        OTHER + output(link="tcp-listen://127.0.0.1:10110"),
        "output[1].link: port 10110 is also that of output[0].link: choose another",
    ),
    "one of them everywhere": (
        OTHER + output(link="tcp-listen://0.0.0.0:10110", allow=["10.0.0.0/8"]),
        "output[1].link: port 10110 is also that of output[0].link: choose another",
    ),
    "at the port of the stream": (output(link="tcp-listen://localhost:5570"), "port 5570 is also that of stream.port"),
    "at the port of metrics": (output(link="tcp-listen://127.0.0.1:9570"), "port 9570 is also that of http.port"),
    "to our own stream": (
        output(link="tcp://127.0.0.1:5570"),
        "at tcp://127.0.0.1:5570 heaved itself listens (stream.p",
    ),
    "to our own output": (OTHER + output(link="tcp://127.0.0.1:10110"), "heaved itself listens (output[0].link)"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_is_named_with_its_path(name: str) -> None:
    text, expected = FAULTS[name]
    found = faults_of(text)
    assert len(found) == 1, found
    assert expected in found[0]


def test_every_fault_is_reported_in_one_go() -> None:
    text = (
        output(rate_hz="often", point="tip", talker="II", allow=["x"], link="tcp-listen://0.0.0.0:5570")
        + output(name="plc", telegram="tss1", rate_hz=50, baud=3, link="udp://")
        + output(name="b c", telegram="gga", link="ftp://x")
    )
    assert sorted(fault.split(":")[0] for fault in faults_of(text)) == [
        "output[0].allow[0]", "output[0].link", "output[0].point", "output[0].rate_hz", "output[0].talker",
        "output[1].baud", "output[1].link", "output[1].name", "output[1].rate_hz",
        "output[2].link", "output[2].name", "output[2].telegram",
    ]  # fmt: skip


WELL: dict[str, str] = {
    "two receivers": output() + output(name="b", link="udp://10.0.0.10:5000"),
    "two to one receiver": output() + output(name="b", telegram="em3000"),
    "one port of two addresses": OTHER + output(link="tcp-listen://127.0.0.2:10110"),
    "the port of a server that is off": "[http]\nenabled = false\n" + output(link="tcp-listen://127.0.0.1:9570"),
    "the stream of another machine": output(link="tcp://10.0.0.8:5570"),
    "beyond this machine": output(link="tcp-listen://0.0.0.0:4001", allow=["10.0.0.0/8"]),
    "as fast as the line": output(link=f"{SERIAL}?baudrate=9600", rate_hz=25),  # 27 bytes take 28 ms of 40.
    "as fast as the IMU": IMU + output(rate_hz=100, telegram="em3000"),
    "a point": '[[point]]\nname = "tip"\n' + output(point="tip"),
    "options": output(telegram="xdr", talker="HE", transducers=["H", "PITCH", "R_1"], settling="error"),
}


@pytest.mark.parametrize("name", WELL)
def test_what_can_be_is_no_fault(name: str) -> None:
    assert read(WELL[name]).output


def test_what_is_written_is_what_is_had() -> None:
    (found,) = read(output(heave_positive="down", rate_hz=25, point="")).output
    assert found == OutputSpec(
        name="plc", telegram=Telegram.TSS1, link="udp://10.0.0.9:5000", rate_hz=25.0, heave_positive=HeavePositive.DOWN
    )


def test_a_serial_port_under_two_names_is_one(tmp_path: Path) -> None:
    (tmp_path / "ttyUSB0").touch()
    (tmp_path / "by-id").symlink_to("ttyUSB0")
    text = output(link=f"serial://{tmp_path}/ttyUSB0") + output(name="b", link=f"serial://{tmp_path}/by-id")
    (fault,) = faults_of(text)
    assert fault.startswith("output[1].link: ")


@pytest.mark.parametrize("stopbits", [1, 2])
@pytest.mark.parametrize("telegram", list(Telegram))
def test_what_is_said_to_be_reachable_and_enough_is(telegram: Telegram, stopbits: int) -> None:
    rate_hz = min(FORMATS[telegram].most_hz or 250.0, 250.0)
    link = f"{SERIAL}?baudrate=1200&stopbits={stopbits}"
    (fault,) = faults_of(output(telegram=str(telegram), link=link, rate_hz=rate_hz))
    reachable = re.search(r"reachable: ([\d.]+) Hz", fault)
    assert reachable is not None
    assert read(output(telegram=str(telegram), link=link, rate_hz=float(reachable[1]))).output
    enough = re.search(r"set (\d+) baud", fault)
    assert enough is not None
    better = link.replace("1200", enough[1])
    assert read(output(telegram=str(telegram), link=better, rate_hz=rate_hz)).output


def test_cautions() -> None:
    assert cautions(read(output() + output(name="b", telegram="kmb", lead="none"))) == []
    (caution,) = cautions(read(output(lead="none")))
    assert caution.startswith('output[0].lead: "none", but tss1 tells no time')
    (caution,) = cautions(read(output(lead="compensation")))
    assert caution.startswith('output[0].lead: "compensation" without [compensation] lead_s')
    assert cautions(read("[compensation]\nlead_s = 0.2\n" + output(lead="compensation"))) == []


def test_every_telegram_has_a_format() -> None:
    assert set(FORMATS) == set(Telegram)


def test_the_default_file_documents_outputs() -> None:
    """The example, as it stands there, is sound and shows defaults; the keys for some formats alone come after it."""
    text = (data_directory() / "heaved.toml").read_text(encoding="utf-8")
    section = text[text.index("#     [[output]]\n") :]
    example, _, rest = section.partition("# For some links")
    (table,) = tomllib.loads(re.sub(r"(?m)^# ? ? ? ? ?", "", example))["output"]
    found = msgspec.convert(table, OutputSpec)
    for field in msgspec.structs.fields(OutputSpec):
        assert field.name in table or re.search(rf"(?m)^#     {field.name} = ", rest), field.name
        if not field.required and field.default is not None:
            assert getattr(found, field.name) == field.default
    assert read("[[output]]\n" + "\n".join(f"{key} = {value!r}" for key, value in table.items())).output == (found,)
    for telegram in Telegram:
        assert str(telegram) in example
