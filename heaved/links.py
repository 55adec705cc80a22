"""Link strings of the configuration: hosts, ports, serial lines; and why one could not be opened. Pure."""

from __future__ import annotations

import errno
import socket
import unicodedata
from typing import TYPE_CHECKING, Final, Literal
from urllib.parse import SplitResult, parse_qsl, urlsplit

import msgspec

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

Parity = Literal["N", "E", "O"]


class TcpLink(msgspec.Struct, frozen=True):
    """A TCP port of somebody else."""

    host: str
    port: int

    def __str__(self) -> str:
        return _shown("tcp", self.host, self.port)


class TcpListenLink(msgspec.Struct, frozen=True):
    """A TCP port of ours, to which others connect."""

    host: str
    port: int

    def __str__(self) -> str:
        return _shown("tcp-listen", self.host, self.port)


class UdpLink(msgspec.Struct, frozen=True):
    """A UDP port of somebody else, of a broadcast address or a multicast group too."""

    host: str
    port: int

    def __str__(self) -> str:
        return _shown("udp", self.host, self.port)


class UdpListenLink(msgspec.Struct, frozen=True):
    """A UDP port of ours, to which others send."""

    host: str
    port: int

    def __str__(self) -> str:
        return _shown("udp-listen", self.host, self.port)


class ServiceLink(msgspec.Struct, frozen=True):
    """A service of somebody else, which its scheme names: a broker, a database."""

    scheme: str
    host: str
    port: int

    def __str__(self) -> str:
        return _shown(self.scheme, self.host, self.port)


class SerialLink(msgspec.Struct, frozen=True):
    """A serial port."""

    path: str
    baudrate: int = 9600
    parity: Parity = "N"
    stopbits: Literal[1, 2] = 1
    bytesize: Literal[8] = 8

    def __str__(self) -> str:
        return f"{self.path} ({self.baudrate} {self.bytesize}{self.parity}{self.stopbits})"


Link = TcpLink | SerialLink
"""To a device on Modbus."""
AnyLink = TcpLink | TcpListenLink | UdpLink | UdpListenLink | SerialLink

_KINDS: Final[dict[str, type[TcpLink | TcpListenLink | UdpLink | UdpListenLink]]] = {
    "tcp": TcpLink,
    "tcp-listen": TcpListenLink,
    "udp": UdpLink,
    "udp-listen": UdpListenLink,
}
_SERIAL: Final = ("rtu", "serial")
_USAGE: Final = {scheme: f"{scheme}://host:port" for scheme in _KINDS} | {s: f"{s}:///dev/port" for s in _SERIAL}


def _shown(scheme: str, host: str, port: int) -> str:
    return f"{scheme}://[{host}]:{port}" if ":" in host else f"{scheme}://{host}:{port}"


def parse_link(text: str) -> Link:
    """The link to a device: ``tcp://host:port`` or ``rtu:///dev/ttyUSB0?baudrate=9600&parity=N&stopbits=1&bytesize=8``
    (the defaults).

    Raises:
        ValueError: names the part that is wrong, and what it should be.
    """
    link = parse_any_link(text, ("tcp", "rtu"))
    assert isinstance(link, TcpLink | SerialLink)
    return link


def parse_any_link(text: str, schemes: Sequence[str]) -> AnyLink:
    """A link of one of the ``schemes`` tcp, tcp-listen, udp, udp-listen (``://host:port``), rtu and serial (``:///dev/port?...``).

    Raises:
        ValueError: names the part that is wrong, and what it should be.
    """
    url = _split(text, schemes, _USAGE)
    return _parse_serial(text, url) if url.scheme in _SERIAL else _parse_address(text, url)


def parse_service_link(text: str, ports: Mapping[str, int]) -> ServiceLink:
    """A link ``scheme://host:port`` of one of the schemes in ``ports``, which has the usual port of each: it may be
    left out.

    Raises:
        ValueError: names the part that is wrong, and what it should be.
    """
    url = _split(text, tuple(ports), {scheme: f"{scheme}://host:{port}" for scheme, port in ports.items()})
    if "@" in url.netloc:  # Not shown: it is a secret.
        raise ValueError("link: no name and no password may stand in it; they have keys of their own")
    host, port = _host_and_port(text, url, ports[url.scheme])
    if port == 0:
        raise ValueError(f"link {text!r}: the port must be a number from 1 to 65535")
    return ServiceLink(url.scheme, host, port or ports[url.scheme])


def _split(text: str, schemes: Sequence[str], usages: Mapping[str, str]) -> SplitResult:
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
    if url.scheme not in schemes:
        *others, last = [usages[scheme] for scheme in schemes]
        usage = f"{', '.join(others)} or {last}" if others else last
        raise ValueError(f"link {text!r}: unknown scheme {url.scheme!r}; it must be {usage}")
    return url


def _parse_address(text: str, url: SplitResult) -> TcpLink | TcpListenLink | UdpLink | UdpListenLink:
    host, port = _host_and_port(text, url, 502)
    if not port:
        raise ValueError(f"link {text!r}: the port is missing, e.g. {url.scheme}://{host}:502")
    return _KINDS[url.scheme](host, port)


def _host_and_port(text: str, url: SplitResult, usual: int) -> tuple[str, int | None]:
    """``usual``: port of the examples. None: no port is given."""
    scheme = url.scheme
    if url.netloc.count(":") > 1 and "[" not in url.netloc:
        raise ValueError(f"link {text!r}: an IPv6 address stands in brackets, e.g. {scheme}://[fd00::7]:{usual}")
    if not url.hostname:
        raise ValueError(f"link {text!r}: the host is missing, e.g. {scheme}://192.168.1.20:{usual}")
    try:
        port = url.port
    except ValueError:
        raise ValueError(f"link {text!r}: the port must be a number from 1 to 65535") from None
    if url.path or url.query or url.fragment or url.username is not None:
        raise ValueError(f"link {text!r}: nothing may stand beside {scheme}://host:port")
    return url.hostname, port


def _parse_serial(text: str, url: SplitResult) -> SerialLink:
    if url.netloc or not url.path.startswith("/") or url.path == "/":
        example = f"{url.scheme}:///dev/ttyUSB0?baudrate=115200"
        raise ValueError(f"link {text!r}: the port's absolute path is missing, e.g. {example}")
    settings: dict[str, str | int] = {"path": url.path}
    for key, value in parse_qsl(url.query, keep_blank_values=True):
        if key in settings:
            raise ValueError(f"link {text!r}: {key} is given twice, or not an option")
        settings[key] = _serial_setting(text, key, value)
    return msgspec.convert(settings, SerialLink)


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
            raise ValueError(f"link {text!r}: bytesize {value!r} must be 8, as Modbus and every telegram has it")
        return int(value)
    raise ValueError(f"link {text!r}: unknown option {key!r}; known: baudrate, parity, stopbits, bytesize")


def explain_open_failure(link: Link, error: BaseException) -> str:  # Each cause has its own words.
    """Why a line could not be opened, and what to do about it."""
    number = error.errno if isinstance(error, OSError) else None
    if number in (errno.EMFILE, errno.ENFILE) and not isinstance(error, socket.gaierror):
        return "no file descriptor is left for the line: close other connections, or raise the limit (LimitNOFILE)"
    if isinstance(link, SerialLink):
        if number in (errno.EACCES, errno.EPERM):
            return f"no permission to open {link.path}: add the daemon's user to the port's group (often dialout)"
        if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
            return f"{link.path} is not there: plug the adapter in, or correct the link"
        if number in (errno.EAGAIN, errno.EBUSY):
            return f"{link.path} is in use by another program, or by this one under another name of the port: stop it"
        return f"{link.path} cannot be opened ({error}): check the link's settings"
    return explain_no_connection(link.host, error, f"the device serves Modbus TCP on port {link.port}")


def explain_no_connection(host: str, error: BaseException, served: str) -> str:
    """Why there is no connection, and what to do about it. ``served``: what should be so at the far end, a clause."""
    if isinstance(error, socket.gaierror):
        if error.errno == socket.EAI_AGAIN:
            return (
                f"host name {host} cannot be looked up, no name server answers: check the network, "
                "or write the IP address into the link"
            )
        return f"host name {host} is unknown ({error.strerror}): check it, or write the IP address into the link"
    if isinstance(error, TimeoutError):
        # Nor does anybody where the unit does not permit it: what it does not permit is dropped, not refused.
        return (
            "nobody answers the connection: check power, cable and address, and of a service that its unit permits the "
            "address (heaved install-service)"
        )
    if isinstance(error, ConnectionRefusedError):
        return f"connection refused: check that {served}"
    if isinstance(error, PermissionError):
        return f"not permitted to talk to {host}: name its network in IPAddressAllow of the unit, or ask the firewall"
    return f"no connection ({error}): check network and address"


def character_s(link: SerialLink) -> float:
    """Duration of one byte: start bit, data bits, parity bit, stop bits."""
    return (1 + link.bytesize + (link.parity != "N") + link.stopbits) / link.baudrate


def silence_s(link: SerialLink) -> float:
    """Silence between frames: 3.5 characters, but 1.75 ms above 19200 baud (Modbus over serial line V1.02, 2.5.1.1)."""
    silence = 3.5 * character_s(link)
    return max(silence, 1.75e-3) if link.baudrate > 19200 else silence
