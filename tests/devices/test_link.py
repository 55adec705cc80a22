"""Links and wire times, against the arithmetic of the Modbus serial line document written out here."""

from __future__ import annotations

import errno
import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from heaved.devices.link import bus_key, bus_load_faults, buses, line_faults, request_time_s, request_wire_s
from heaved.devices.profile import Block, DeviceSpec, Field, Profile
from heaved.links import SerialLink, TcpLink, character_s, explain_open_failure, parse_link, silence_s


def profile(*registers: int) -> Profile:
    """Blocks of that many registers each."""
    return Profile(name="p", blocks=tuple(
        Block(start=0, fields=(Field(quantity="az_mps2", offset=count - 1, unit="g"),)) for count in registers
    ))  # fmt: skip


def device(name: str, link: str, rate_hz: float, registers: int = 12, device_id: int = 1) -> DeviceSpec:
    return DeviceSpec(
        name=name, role="imu", link=link, device_id=device_id, profile=profile(registers), rate_hz=rate_hz
    )


@pytest.mark.parametrize(
    ("text", "link"),
    [
        ("tcp://10.0.0.7:502", TcpLink("10.0.0.7", 502)),
        ("tcp://plc.ship:1502", TcpLink("plc.ship", 1502)),
        ("tcp://[::1]:502", TcpLink("::1", 502)),
        ("rtu:///dev/ttyUSB0", SerialLink("/dev/ttyUSB0", 9600, "N", 1, 8)),
        ("rtu:///dev/ttyS1?baudrate=57600&parity=E&stopbits=2&bytesize=8", SerialLink("/dev/ttyS1", 57600, "E", 2, 8)),
    ],
)
def test_links(text: str, link: object) -> None:
    assert parse_link(text) == link


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "unknown scheme ''"),
        ("udp://h:1", "unknown scheme 'udp'"),
        ("/dev/ttyUSB0", "unknown scheme ''"),
        ("tcp://:502", "host is missing"),
        ("tcp://host", "port is missing"),
        ("tcp://host:0", "port is missing"),
        ("tcp://host:70000", "1 to 65535"),
        ("tcp://host:x", "1 to 65535"),
        ("tcp://host:502/unit", "nothing may stand"),
        ("tcp://host:502#7", 'what follows "#"'),
        ("tcp://fd00::7:502", "stands in brackets"),
        ("tcp://10.0.0.7:502\n", "a character that no link has (U+000A)"),
        ("tcp://h\N{LATIN SMALL LETTER O WITH DIAERESIS}st:502", "(LATIN SMALL LETTER O WITH DIAERESIS)"),
        ("rtu:///dev/tty USB0", "a character that no link has (SPACE)"),
        ("rtu:///dev/ttyUSB0#2?baudrate=9600", 'what follows "#"'),
        ("tcp://host:502?timeout=3", "nothing may stand"),
        ("rtu://dev/ttyUSB0", "absolute path"),
        ("rtu:///", "absolute path"),
        ("rtu:///dev/x?baudrate=fast", "baudrate 'fast'"),
        ("rtu:///dev/x?baudrate=", "baudrate ''"),
        ("rtu:///dev/x?baudrate=1", "300 to 4000000"),
        ("rtu:///dev/x?parity=e", "parity 'e' must be N, E or O"),
        ("rtu:///dev/x?stopbits=3", "stopbits '3'"),
        ("rtu:///dev/x?bytesize=7", "bytesize '7' must be 8"),
        ("rtu:///dev/x?baud=9600", "unknown option 'baud'"),
        ("rtu:///dev/x?parity=N&parity=E", "parity is given twice"),
    ],
)
def test_bad_links_say_which_part_is_wrong(text: str, words: str) -> None:
    with pytest.raises(ValueError, match="link") as caught:
        parse_link(text)
    assert words in str(caught.value)
    assert repr(text) in str(caught.value)


@given(st.text(max_size=40))
def test_any_text_is_a_link_or_a_clear_refusal(text: str) -> None:
    for link in (text, "rtu://" + text, "tcp://" + text):
        refusal = "link"
        try:
            parse_link(link)
        except ValueError as error:
            refusal = str(error)
        assert refusal.startswith("link")


def test_devices_on_one_line_share_a_bus() -> None:
    assert bus_key(parse_link("tcp://h:1")) != bus_key(parse_link("tcp://h:2"))
    one, two, three = (
        device("one", "rtu:///dev/a?baudrate=9600", 1),
        device("two", "tcp://h:502", 1),
        device("three", "rtu:///dev/a?parity=E", 1),
    )
    assert list(buses([one, two, three]).values()) == [(one, three), (two,)]


@pytest.mark.parametrize(("baudrate", "milliseconds"), [(9600, 45.8), (115200, 6.7)])
def test_twelve_registers_take_what_the_field_measures(baudrate: int, milliseconds: float) -> None:
    seconds = request_time_s(SerialLink("/dev/x", baudrate), profile(12))
    assert seconds * 1e3 == pytest.approx(milliseconds, abs=0.05)


def test_wire_time_counts_every_bit() -> None:
    link = SerialLink("/dev/x", 19200, "E", 2)
    # 1 start, 8 data, 1 parity, 2 stop bits; up to 19200 baud a silence is 3.5 characters.
    assert character_s(link) == pytest.approx(12 / 19200)
    assert silence_s(link) == pytest.approx(42 / 19200)
    assert silence_s(SerialLink("/dev/x", 38400)) == 0.00175
    assert request_wire_s(link) == pytest.approx(96 / 19200)
    # Two blocks of 1 and 3 registers: requests of 8 bytes, answers of 7 and 11, four silences.
    assert request_time_s(link, profile(1, 3)) == pytest.approx((8 + 7 + 8 + 11 + 4 * 3.5) * 12 / 19200)
    assert request_time_s(TcpLink("h", 1), profile(12)) == request_wire_s(TcpLink("h", 1)) == 0.0


def test_rate_beyond_the_line_names_what_is_needed_and_what_helps() -> None:
    faults = bus_load_faults([device("imu", "rtu:///dev/a?baudrate=9600", 100.0)])
    assert len(faults) == 1
    for words in ("/dev/a", "imu at 100 Hz", "45.8 ms", "459 %", "imu 21.8 Hz", "set 57600 baud"):
        assert words in faults[0]


def test_load_is_shared_by_the_devices_of_a_line() -> None:
    link = "rtu:///dev/a?baudrate=115200"
    # 6.7 ms each: 100 Hz alone takes 67 %; with 60 Hz more it is 107 %.
    assert bus_load_faults([device("a", link, 100.0)]) == []
    assert bus_load_faults([device("a", link, 100.0), device("b", "rtu:///dev/b?baudrate=115200", 60.0)]) == []
    faults = bus_load_faults([device("a", link, 100.0), device("b", link, 60.0, device_id=2)])
    assert len(faults) == 1
    assert "a at 100 Hz" in faults[0]
    assert "b at 60 Hz" in faults[0]


def test_promised_rates_and_baud_rates_do_help() -> None:
    for baudrate, rate_hz in ((9600, 100.0), (19200, 50.0), (115200, 180.0)):
        message = bus_load_faults([device("imu", f"rtu:///dev/a?baudrate={baudrate}", rate_hz)])[0]
        reachable = float(message.split("reachable: imu ")[1].split(" Hz")[0])
        assert bus_load_faults([device("imu", f"rtu:///dev/a?baudrate={baudrate}", reachable)]) == []
        enough = int(message.split("set ")[1].split(" baud")[0])
        assert bus_load_faults([device("imu", f"rtu:///dev/a?baudrate={enough}", rate_hz)]) == []


def test_rate_that_no_baud_rate_can_carry() -> None:
    faults = bus_load_faults([device("imu", "rtu:///dev/a?baudrate=921600", 1000.0)])
    assert "no baud rate helps" in faults[0]


def test_tcp_has_no_wire_to_overload() -> None:
    assert bus_load_faults([device("imu", "tcp://h:502", 1000.0)]) == []


def test_every_fault_of_the_lines_is_reported_at_once() -> None:
    faults = line_faults([
        device("a", "rtu:///dev/a?baudrate=9600", 1.0),
        device("b", "rtu:///dev/a?baudrate=19200", 1.0, device_id=2),
        device("c", "rtu:///dev/c", 1.0, device_id=0),
        device("d", "tcp://h", 1.0),
        device("e", "rtu:///dev/e", 100.0),
        device("f", "tcp://h:502", 100.0, device_id=0),
        device("g", "rtu:///dev/a?baudrate=9600", 1.0),
    ])  # fmt: skip
    assert len(faults) == 5
    text = "\n".join(faults)
    assert "device b" in text
    assert "same port" in text
    assert "device c: device_id 0" in text
    assert "device d: link 'tcp://h'" in text
    assert "line /dev/e" in text
    assert "device g: device_id 1 on /dev/a (9600 8N1) is that of device a already" in text


@pytest.mark.parametrize(
    ("link", "error", "words"),
    [
        ("rtu:///dev/a", OSError(errno.EACCES, "x"), "no permission to open /dev/a"),
        ("rtu:///dev/a", OSError(errno.ENOENT, "x"), "/dev/a is not there"),
        ("rtu:///dev/a", OSError(errno.EAGAIN, "x"), "in use by another program"),
        ("rtu:///dev/a", ValueError("custom baud rate"), "custom baud rate"),
        ("rtu:///dev/a", OSError(errno.EMFILE, "x"), "no file descriptor is left"),
        ("tcp://h:502", OSError(errno.EMFILE, "x"), "no file descriptor is left"),
        ("tcp://h:502", socket.gaierror(-2, "x"), "host name h is unknown"),
        ("tcp://h:502", socket.gaierror(-3, "x"), "no name server answers: check the network, or write the IP"),
        ("tcp://h:502", TimeoutError(), "nobody answers"),
        ("tcp://h:502", ConnectionRefusedError(), "port 502"),
        ("tcp://h:502", PermissionError(1, "Operation not permitted"), "IPAddressAllow"),
        ("tcp://h:502", OSError(errno.ENETUNREACH, "Network is unreachable"), "Network is unreachable"),
    ],
)
def test_a_line_that_does_not_open_says_why(link: str, error: BaseException, words: str) -> None:
    assert words in explain_open_failure(parse_link(link), error)
