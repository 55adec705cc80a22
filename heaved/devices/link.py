"""The lines that devices hang on: what a poll costs on the wire, what a line cannot carry. Pure."""

from __future__ import annotations

from math import ceil, inf
from typing import TYPE_CHECKING

import msgspec

from heaved.devices.profile import DeviceSpec, Profile, block_registers
from heaved.links import Link, SerialLink, TcpLink, character_s, parse_link, silence_s

if TYPE_CHECKING:
    from collections.abc import Sequence

BAUD_RATES = (9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)
"""Rates worth suggesting."""

READ_REQUEST_BYTES = 8
"""Id, function, address (2), count (2), CRC (2)."""
READ_ANSWER_BYTES = 5
"""Id, function, byte count, CRC (2); the registers come on top."""


def bus_key(link: Link) -> str:
    """Devices with the same key share one bus: one connection, one request at a time."""
    return str(link) if isinstance(link, TcpLink) else link.path


def buses(devices: Sequence[DeviceSpec]) -> dict[str, tuple[DeviceSpec, ...]]:
    """The devices that are asked on each bus, by its key, in the order given.

    Raises:
        ValueError: a link that cannot be parsed.
    """
    found: dict[str, tuple[DeviceSpec, ...]] = {}
    for device in devices:
        if not device.is_asked:
            continue
        key = bus_key(parse_link(device.link))
        found[key] = (*found.get(key, ()), device)
    return found


# ---- time on the wire ------------------------------------------------------------------------------------------------


def request_wire_s(link: Link) -> float:
    """From the first bit of a read request to the moment the slave has heard it all; 0 on TCP."""
    return READ_REQUEST_BYTES * character_s(link) if isinstance(link, SerialLink) else 0.0


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
    first: dict[str, tuple[DeviceSpec, SerialLink]] = {}
    slaves: dict[tuple[str, int], list[DeviceSpec]] = {}
    for device in devices:
        if not device.is_asked:
            continue
        try:
            link = parse_link(device.link)
        except ValueError as error:
            faults.append(f"device {device.name}: {error}")
            continue
        sound.append(device)
        same = slaves.setdefault((bus_key(link), device.device_id), [])
        twin = next((other for other in same if isinstance(link, SerialLink) or _overlap(device, other)), None)
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
        if isinstance(link, SerialLink) and (load := _load(link, members)) > 1.0:
            faults.append(_load_message(link, members, load))
    return faults


def _load(link: SerialLink, devices: Sequence[DeviceSpec]) -> float:
    """Share of the time for which the line is taken; above 1 it cannot keep up."""
    return sum(device.rate_hz * request_time_s(link, device.profile) for device in devices)


def _load_message(link: SerialLink, devices: Sequence[DeviceSpec], load: float) -> str:
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
