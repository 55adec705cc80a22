"""The serial adapters of this machine: what they are called for good, who has them open, and why one cannot be used."""

from __future__ import annotations

import getpass
import grp
import os
from contextlib import suppress
from pathlib import Path
from typing import Final

import msgspec
from serial.tools import list_ports

from heaved.links import Link, SerialLink
from heaved.text import printable

BY_ID: Final = Path("/dev/serial/by-id")
"""Where udev gives each adapter a name that stays when others are plugged in or the machine starts anew."""
PROCESSES: Final = Path("/proc")
_PSEUDO: Final = "/dev/pts/"
"""A pseudo-terminal is held open by whoever serves it."""
_MOST_SHOWN: Final = 60
"""Letters of a command line."""


class Adapter(msgspec.Struct, frozen=True, kw_only=True):
    """One serial port of this machine."""

    path: str
    """As it is called now: ``/dev/ttyUSB0``."""
    stable_path: str
    """What should stand in a configuration: the name under ``/dev/serial/by-id``; where there is none, ``path``."""
    name: str = ""
    """Of the adapter, as it says itself."""
    maker: str = ""
    serial_number: str = ""
    """As the kernel shows it; empty: it has none."""
    usb_id: str = ""
    """Vendor and product, such as ``0403:6001``; empty: a port of the board."""
    socket: str = ""
    """Of the bus, such as ``1-1.2``; of one among several ports of an adapter with its interface, ``1-1.2:1.0``."""
    held_by: tuple[str, ...] = ()
    """Processes that have it open."""
    refusal: str = ""
    """Why the user may not open it, and what to do; empty: may."""


def adapters() -> list[Adapter]:
    """Those that are plugged in, USB adapters before the ports of the board."""
    ports = sorted(list_ports.comports(), key=lambda port: (port.vid is None, port.device))
    return [
        Adapter(
            path=port.device,
            stable_path=stable_path(port.device),
            name=_told(port.product) or _told(port.description),
            maker=_told(port.manufacturer),
            serial_number=port.serial_number or "",
            usb_id="" if port.vid is None else f"{port.vid:04x}:{port.pid:04x}",
            socket=port.location or "",
            held_by=tuple(holders(port.device)),
            refusal=refusal(port.device),
        )
        for port in ports
    ]


def _told(text: str | None) -> str:
    return "" if text in (None, "n/a") else printable(str(text))


def stable_path(path: str, directory: Path = BY_ID) -> str:
    """The name of a port that stays, in ``directory``; ``path`` itself where there is none."""
    target = os.path.realpath(path)
    with suppress(OSError):
        for link in sorted(directory.iterdir()):
            if os.path.realpath(link) == target:
                return str(link)
    return path


def holders(path: str, processes: Path = PROCESSES) -> list[str]:
    """Processes but this one that have the port open, as far as we may look: command and number of each."""
    target = os.path.realpath(path)
    found = []
    for process in sorted(processes.glob("[0-9]*"), key=lambda entry: int(entry.name)):
        if int(process.name) == os.getpid():
            continue
        with suppress(OSError):  # It has ended, or is somebody else's.
            if any(_is_open_on(descriptor, target) for descriptor in (process / "fd").iterdir()):
                found.append(f"{_command(process)} (process {process.name})")
    return found


def _is_open_on(descriptor: Path, target: str) -> bool:
    with suppress(OSError):
        return str(descriptor.readlink()) == target
    return False


def _command(process: Path) -> str:
    words = (process / "cmdline").read_bytes().rstrip(b"\0").decode(errors="replace").split("\0")
    if Path(words[0]).name.startswith("python") and len(words) > 2:
        # Not who runs it, but what is run.
        words = words[2:] if words[1] == "-m" else words if words[1].startswith("-") else words[1:]
    words[0] = Path(words[0]).name
    text = printable(" ".join(words))
    return text if len(text) <= _MOST_SHOWN else text[:_MOST_SHOWN] + "…"


def refusal(path: str) -> str:
    """Why the user may not open a port that is there, and what to do about it; empty: may, or it is not there."""
    try:
        group_id = Path(path).stat().st_gid
    except OSError:
        return ""
    if os.access(path, os.R_OK | os.W_OK):
        return ""
    try:
        group = grp.getgrgid(group_id).gr_name
    except KeyError:
        group = str(group_id)
    if group == "root":
        return f"no permission to open {path}, which belongs to root alone: ask with sudo, or have udev set its group"
    user = getpass.getuser()
    return f"no permission to open {path}: sudo usermod -aG {group} {user}, log out and in again (or: newgrp {group})"


def explain(link: Link, reason: str) -> str:
    """Why a line could not be opened, a ``reason``, and what this machine knows besides: who has it, whose it is."""
    if not isinstance(link, SerialLink) or not Path(link.path).exists():
        return reason
    if refused := refusal(link.path):
        return refused
    if "in use" not in reason:
        return reason
    if found := holders(link.path):
        service = "; the daemon: systemctl stop heaved" if any("heaved" in holder for holder in found) else ""
        return f"{link.path} is in use: {', '.join(found)} has it open: stop it{service}"
    return f"{reason} (sudo fuser -v {link.path} says by whom)"


def beside_us(link: Link) -> str:
    """A warning where somebody else has the port open, too, without having locked it; else empty."""
    if not isinstance(link, SerialLink) or os.path.realpath(link.path).startswith(_PSEUDO):
        return ""
    if not (found := holders(link.path)):
        return ""
    return f"{', '.join(found)} has {link.path} open, too: its bytes and ours will be mixed; end it"
