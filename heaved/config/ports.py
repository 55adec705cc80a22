"""Ports that two would have: serial ports, and those at which heaved listens, whatever wants them."""

from __future__ import annotations

import ipaddress
import os
from typing import TYPE_CHECKING, NamedTuple

from heaved.links import AnyLink, SerialLink, TcpLink, TcpListenLink, UdpLink, UdpListenLink

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence


class Use(NamedTuple):
    """Who wants which port."""

    path: str
    """The key that says so."""
    link: AnyLink
    is_master: bool = False
    """It is a master on Modbus: several may share a serial line, or talk to one slave."""


def port_faults(uses: Sequence[Use]) -> Iterator[str]:
    """A fault for each that wants what an earlier one has, or would talk to ourselves."""
    yield from _serial_faults([use for use in uses if isinstance(use.link, SerialLink)])
    tcp = [use for use in uses if isinstance(use.link, TcpListenLink)]
    udp = [use for use in uses if isinstance(use.link, UdpListenLink)]
    yield from _listening_faults(tcp)
    yield from _listening_faults(udp)
    far = [use for use in uses if isinstance(use.link, TcpLink | UdpLink)]
    for i, use in enumerate(far):
        ours = tcp if isinstance(use.link, TcpLink) else udp
        own = next((other for other in ours if _is_here(use.link) and _clash(other.link, use.link)), None)
        # Several masters may talk to one slave, and any number of outputs to one reader.
        there = next((other for other in far[:i] if other.link == use.link and other.is_master), None)
        if own is not None:
            yield f"{use.path}: at {use.link} heaved itself listens ({own.path}): correct it"
        elif there is not None and not use.is_master:
            yield f"{use.path}: at {use.link} there is already what {_table(there.path)} talks to: correct one of them"


def _serial_faults(uses: Sequence[Use]) -> Iterator[str]:
    """A serial port may go by two names, such as /dev/ttyUSB0 and its link under /dev/serial/by-id: it could not be
    opened under the second beside the first, not even to share the line.
    """
    first: dict[str, Use] = {}
    for use in uses:
        assert isinstance(use.link, SerialLink)
        holder = first.setdefault(os.path.realpath(use.link.path), use)
        assert isinstance(holder.link, SerialLink)
        name, held, other = use.link.path, holder.link.path, _table(holder.path)
        if holder is use:
            continue
        if not (use.is_master and holder.is_master):
            yield f"{use.path}: {name} is the port of {other} already: give each a port of its own"
        elif name != held:
            advice = "give both the same link; they share the line"
            yield f"{use.path}: {name} is the same port as {held} of {other}: {advice}"


def _listening_faults(uses: Sequence[Use]) -> Iterator[str]:
    for i, use in enumerate(uses):
        other = next((one for one in uses[:i] if _clash(one.link, use.link)), None)
        if other is not None:
            port = getattr(use.link, "port", 0)
            yield f"{use.path}: port {port} is also that of {other.path}: choose another"


def _clash(listening: AnyLink, other: AnyLink) -> bool:
    """Whether two addresses are in each other's way. Port 0 is any that is free."""
    assert not isinstance(listening, SerialLink)
    assert not isinstance(other, SerialLink)
    a, b = _address(listening.host), _address(other.host)
    if listening.port != other.port or not other.port or a is None or b is None or a.version != b.version:
        return False
    return a == b or a.is_unspecified or b.is_unspecified


def _is_here(link: AnyLink) -> bool:
    assert not isinstance(link, SerialLink)
    address = _address(link.host)
    return address is not None and address.is_loopback


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address("127.0.0.1" if host == "localhost" else host)
    except ValueError:
        return None


def _table(path: str) -> str:
    """``device[0]`` of ``device[0].link``."""
    return path.removesuffix(".link")
