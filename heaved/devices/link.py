"""The lines that devices hang on: link strings, what a poll costs on the wire, what a line cannot carry. Pure."""

from __future__ import annotations

import errno
import socket
import unicodedata
from math import ceil, inf
from typing import TYPE_CHECKING, Literal
from urllib.parse import SplitResult, parse_qsl, urlsplit

import msgspec

from heaved.devices.profile import DeviceSpec, Profile, block_registers

if TYPE_CHECKING:
    from collections.abc import Sequence

BAUD_RATES = (9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)
"""Rates worth suggesting."""

READ_REQUEST_BYTES = 8
"""Id, function, address (2), count (2), CRC (2)."""
READ_ANSWER_BYTES = 5
"""Id, function, byte count, CRC (2); the registers come on top."""

Parity = Literal["N", "E", "O"]


class TcpLink(msgspec.Struct, frozen=True):
    """Modbus TCP."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"tcp://[{self.host}]:{self.port}" if ":" in self.host else f"tcp://{self.host}:{self.port}"


class RtuLink(msgspec.Struct, frozen=True):
    """Modbus RTU on a serial port."""

    path: str
    baudrate: int = 9600
    parity: Parity = "N"
    stopbits: Literal[1, 2] = 1
    bytesize: Literal[8] = 8

    def __str__(self) -> str:
        return f"{self.path} ({self.baudrate} {self.bytesize}{self.parity}{self.stopbits})"


Link = TcpLink | RtuLink


def parse_link(text: str) -> Link:
    """``tcp://host:port`` or ``rtu:///dev/ttyUSB0?baudrate=9600&parity=N&stopbits=1&bytesize=8`` (the defaults).

    Raises:
        ValueError: names the part that is wrong, and what it should be.
    """
    odd = next((char for char in text if not "!" <= char <= "~"), None)
    if odd is not None:
        name = unicodedata.name(odd, f"U+{ord(odd):04X}")
        raise ValueError(f"link {text!r}: has a character that no link has ({name}): type it anew, without spaces")
    if "#" in text:
        raise ValueError(f'link {text!r}: what follows "#" would be ignored; options follow "?", joined by "&"')
    try:
        url = urlsplit(text)
    except ValueError as error:
        raise ValueError(f"link {text!r}: {error}") from None
    if url.scheme == "tcp":
        return _parse_tcp(text, url)
    if url.scheme == "rtu":
        return _parse_rtu(text, url)
    raise ValueError(f"link {text!r}: unknown scheme {url.scheme!r}; it must be tcp://host:port or rtu:///dev/port")


def _parse_tcp(text: str, url: SplitResult) -> TcpLink:
    if url.netloc.count(":") > 1 and "[" not in url.netloc:
        raise ValueError(f"link {text!r}: an IPv6 address stands in brackets, e.g. tcp://[fd00::7]:502")
    if not url.hostname:
        raise ValueError(f"link {text!r}: the host is missing, e.g. tcp://192.168.1.20:502")
    try:
        port = url.port
    except ValueError:
        raise ValueError(f"link {text!r}: the port must be a number from 1 to 65535") from None
    if not port:
        raise ValueError(f"link {text!r}: the port is missing, e.g. tcp://{url.hostname}:502")
    if url.path or url.query or url.fragment or url.username is not None:
        raise ValueError(f"link {text!r}: nothing may stand beside tcp://host:port")
    return TcpLink(url.hostname, port)


def _parse_rtu(text: str, url: SplitResult) -> RtuLink:
    if url.netloc or not url.path.startswith("/") or url.path == "/":
        raise ValueError(f"link {text!r}: the port's absolute path is missing, e.g. rtu:///dev/ttyUSB0?baudrate=115200")
    settings: dict[str, str | int] = {"path": url.path}
    for key, value in parse_qsl(url.query, keep_blank_values=True):
        if key in settings:
            raise ValueError(f"link {text!r}: {key} is given twice, or not an option")
        settings[key] = _serial_setting(text, key, value)
    return msgspec.convert(settings, RtuLink)


def _serial_setting(text: str, key: str, value: str) -> str | int:
    if key == "baudrate":
        if not value.isdecimal() or not 300 <= int(value) <= 4_000_000:
            raise ValueError(f"link {text!r}: baudrate {value!r} must be a number from 300 to 4000000")
        return int(value)
    if key == "parity":
        if value not in ("N", "E", "O"):
            raise ValueError(f"link {text!r}: parity {value!r} must be N, E or O")
        return value
    if key == "stopbits":
        if value not in ("1", "2"):
            raise ValueError(f"link {text!r}: stopbits {value!r} must be 1 or 2")
        return int(value)
    if key == "bytesize":
        if value != "8":
            raise ValueError(f"link {text!r}: bytesize {value!r} must be 8, as Modbus RTU has it")
        return int(value)
    raise ValueError(f"link {text!r}: unknown option {key!r}; known: baudrate, parity, stopbits, bytesize")


def bus_key(link: Link) -> str:
    """Devices with the same key share one bus: one connection, one request at a time."""
    return str(link) if isinstance(link, TcpLink) else link.path


def buses(devices: Sequence[DeviceSpec]) -> dict[str, tuple[DeviceSpec, ...]]:
    """The devices on each bus, by its key, in the order given.

    Raises:
        ValueError: a link that cannot be parsed.
    """
    found: dict[str, tuple[DeviceSpec, ...]] = {}
    for device in devices:
        key = bus_key(parse_link(device.link))
        found[key] = (*found.get(key, ()), device)
    return found


def explain_open_failure(link: Link, error: BaseException) -> str:  # Each cause has its own words.  # noqa: PLR0911
    """Why a line could not be opened, and what to do about it."""
    number = error.errno if isinstance(error, OSError) else None
    if number in (errno.EMFILE, errno.ENFILE) and not isinstance(error, socket.gaierror):
        return "no file descriptor is left for the line: close other connections, or raise the limit (LimitNOFILE)"
    if isinstance(link, RtuLink):
        if number in (errno.EACCES, errno.EPERM):
            return f"no permission to open {link.path}: add the daemon's user to the port's group (often dialout)"
        if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
            return f"{link.path} is not there: plug the adapter in, or correct the link"
        if number in (errno.EAGAIN, errno.EBUSY):
            return f"{link.path} is in use by another program, or by this one under another name of the port: stop it"
        return f"{link.path} cannot be opened ({error}): check the link's settings"
    if isinstance(error, socket.gaierror):
        if number == socket.EAI_AGAIN:
            return (
                f"host name {link.host} cannot be looked up, no name server answers: check the network, "
                "or write the IP address into the link"
            )
        return f"host name {link.host} is unknown ({error.strerror}): check it, or write the IP address into the link"
    if isinstance(error, TimeoutError):
        return "nobody answers the connection: check power, cable and address"
    if isinstance(error, ConnectionRefusedError):
        return f"connection refused: check that the device serves Modbus TCP on port {link.port}"
    return f"no connection ({error}): check network and address"


# ---- time on the wire ------------------------------------------------------------------------------------------------


def character_s(link: RtuLink) -> float:
    """Duration of one byte: start bit, data bits, parity bit, stop bits."""
    return (1 + link.bytesize + (link.parity != "N") + link.stopbits) / link.baudrate


def silence_s(link: RtuLink) -> float:
    """Silence between frames: 3.5 characters, but 1.75 ms above 19200 baud (Modbus over serial line V1.02, 2.5.1.1)."""
    silence = 3.5 * character_s(link)
    return max(silence, 1.75e-3) if link.baudrate > 19200 else silence


def request_wire_s(link: Link) -> float:
    """From the first bit of a read request to the moment the slave has heard it all; 0 on TCP."""
    return READ_REQUEST_BYTES * character_s(link) if isinstance(link, RtuLink) else 0.0


def request_time_s(link: Link, profile: Profile) -> float:
    """Least time that one poll of the device takes on the line: a request, an answer and a silence after each, for
    every block; the slave's own thinking time comes on top. 0 on TCP.
    """
    if isinstance(link, TcpLink):
        return 0.0
    characters = sum(READ_REQUEST_BYTES + READ_ANSWER_BYTES + 2 * block_registers(block) for block in profile.blocks)
    return characters * character_s(link) + 2 * len(profile.blocks) * silence_s(link)


def most_rate_hz(link: Link, profile: Profile) -> float:
    """Polls a second of that device alone that the line can carry; inf on TCP."""
    poll_s = request_time_s(link, profile)
    return _floor3(1.0 / poll_s) if poll_s > 0.0 else inf


def line_faults(devices: Sequence[DeviceSpec]) -> list[str]:
    """Everything that is wrong with the lines of all devices, one message each: links that cannot be read, devices
    that want one serial port with different settings, two with one id, broadcast ids, rates that a line cannot
    carry.
    """
    faults: list[str] = []
    sound: list[DeviceSpec] = []
    first: dict[str, tuple[DeviceSpec, RtuLink]] = {}
    slaves: dict[tuple[str, int], list[DeviceSpec]] = {}
    for device in devices:
        try:
            link = parse_link(device.link)
        except ValueError as error:
            faults.append(f"device {device.name}: {error}")
            continue
        sound.append(device)
        same = slaves.setdefault((bus_key(link), device.device_id), [])
        twin = next((other for other in same if isinstance(link, RtuLink) or _overlap(device, other)), None)
        if twin is not None and parse_link(twin.link) == link:
            faults.append(
                f"device {device.name}: device_id {device.device_id} on {link} is that of device {twin.name} already: "
                "give one of them another id, in the sensor and here"
            )
        same.append(device)
        if isinstance(link, TcpLink):
            continue
        if device.device_id == 0:
            faults.append(f"device {device.name}: device_id 0 is the broadcast address, which nobody answers")
        other, settings = first.setdefault(link.path, (device, link))
        if settings != link:
            faults.append(
                f"device {device.name}: wants {link}, but device {other.name} wants {settings} on the same port: "
                "give both the same settings"
            )
    return faults + bus_load_faults(sound)


def _overlap(one: DeviceSpec, other: DeviceSpec) -> bool:
    """Whether they read some register both. Behind one TCP address and id, a PLC may well hold two sensors."""
    return any(
        a.function == b.function and a.start < b.start + block_registers(b) and b.start < a.start + block_registers(a)
        for a in one.profile.blocks
        for b in other.profile.blocks
    )


def bus_load_faults(devices: Sequence[DeviceSpec]) -> list[str]:
    """One message for each serial line that cannot carry the poll rates of its devices; TCP has no such limit, and of a
    line whose devices want different settings nothing can be said.

    Raises:
        ValueError: a link that cannot be parsed.
    """
    faults = []
    for members in buses(devices).values():
        link = parse_link(members[0].link)
        if any(parse_link(device.link) != link for device in members):
            continue
        if isinstance(link, RtuLink) and (load := _load(link, members)) > 1.0:
            faults.append(_load_message(link, members, load))
    return faults


def _load(link: RtuLink, devices: Sequence[DeviceSpec]) -> float:
    """Share of the time for which the line is taken; above 1 it cannot keep up."""
    return sum(device.rate_hz * request_time_s(link, device.profile) for device in devices)


def _load_message(link: RtuLink, devices: Sequence[DeviceSpec], load: float) -> str:
    needs = "; ".join(
        f"{device.name} at {device.rate_hz:g} Hz needs {request_time_s(link, device.profile) * 1e3:.1f} ms a poll"
        for device in devices
    )
    reachable = ", ".join(f"{device.name} {_floor3(device.rate_hz / load):g} Hz" for device in devices)
    enough = [
        rate
        for rate in BAUD_RATES
        if rate > link.baudrate and _load(msgspec.structs.replace(link, baudrate=rate), devices) <= 1.0
    ]
    remedy = f"set {enough[0]} baud on the line and in the device, or lower" if enough else "no baud rate helps: lower"
    return (
        f"line {link}: {needs}, so the line would be taken {ceil(load * 100)} % of the time; "
        f"reachable: {reachable}; {remedy} rate_hz"
    )


def _floor3(value: float) -> float:
    """Three significant digits, rounded down: a rate that is promised must be reachable."""
    digits = 10 ** (2 - (len(str(int(value))) - 1)) if value >= 1 else 1000
    return int(value * digits) / digits
