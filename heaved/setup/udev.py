"""udev rules for the adapters of a configuration: a name that stays, whatever is plugged in first, and no waiting.

The kernel numbers USB adapters in the order in which it finds them: ``/dev/ttyUSB0`` is another sensor after the next
power cut. A rule knows an adapter by its serial number, or, where it has none or shares it, by the socket it is in.
"""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING, Final

import msgspec

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

GROUP: Final = "dialout"
"""To whom serial ports belong on Debian; the unit is in it."""
FTDI: Final = 0x0403
"""Vendor of adapters that hold bytes back for 16 ms, unless told otherwise."""
PREFIX: Final = "heaved-"
_LITERAL: Final = re.compile(r"[^A-Za-z0-9_.:-]")
_NAME: Final = re.compile(rf'SYMLINK\+="({re.escape(PREFIX)}[^" ]+)')


class Adapter(msgspec.Struct, frozen=True, kw_only=True):
    """A serial port on USB that is plugged in."""

    device: str
    """Such as ``/dev/ttyUSB0``."""
    vid: int
    pid: int
    serial_number: str = ""
    """Empty: it has none."""
    socket: str
    """Of the bus, such as ``1-1.2``; of one among several ports of an adapter with its interface, ``1-1.2:1.0``."""
    product: str = ""


class Rule(msgspec.Struct, frozen=True, kw_only=True):
    """What udev is told of one adapter."""

    names: tuple[str, ...]
    """Of what is connected to it; the first makes the port's name."""
    text: str
    caution: str = ""
    """What people should know; empty: nothing."""

    @property
    def path(self) -> str:
        """The port's name that stays."""
        return f"/dev/{PREFIX}{self.names[0]}"


def adapters() -> tuple[Adapter, ...]:
    """Those that are plugged in now."""
    from serial.tools.list_ports import comports  # It asks the whole of /sys, and only here.

    return tuple(
        Adapter(
            device=port.device,
            vid=port.vid,
            pid=port.pid,
            serial_number=port.serial_number or "",
            socket=port.location or "",
            product=port.product or "",
        )
        for port in comports()
        if port.vid is not None and port.pid is not None
    )


def rules(wanted: Mapping[str, Sequence[str]], plugged: Sequence[Adapter]) -> tuple[Rule, ...]:
    """A rule for each adapter that a port of the configuration is.

    wanted: by port, as a link has it, names of what is connected to it. plugged: what there is.
    """
    found = []
    for path, names in wanted.items():
        real = os.path.realpath(path)
        adapter = next((one for one in plugged if one.device == real), None)
        if adapter is not None:
            found.append(_rule(tuple(names), adapter, plugged))
    return tuple(found)


def _rule(names: tuple[str, ...], adapter: Adapter, plugged: Sequence[Adapter]) -> Rule:
    usb, _, interface = adapter.socket.partition(":")
    matches = [f'ATTRS{{idVendor}}=="{adapter.vid:04x}"', f'ATTRS{{idProduct}}=="{adapter.pid:04x}"']
    known_by, caution = f"serial number {adapter.serial_number}", ""
    same = [one for one in plugged if _kind(one) == _kind(adapter) and one.socket.partition(":")[0] != usb]
    if adapter.serial_number and not same:
        matches.append(f'ATTRS{{serial}}=="{_LITERAL.sub("?", adapter.serial_number)}"')
    else:
        known_by = f"USB socket {usb}"
        matches.insert(0, f'KERNELS=="{usb}"')
        why = "shares its serial number with another" if adapter.serial_number else "has no serial number"
        caution = f"{names[0]}: its adapter {why}, and is known by its socket ({usb}): leave it in that one"
    device = ", ".join(matches)
    # A port of several on one adapter: udev numbers its interfaces in hexadecimal, two digits.
    port = f', ENV{{ID_USB_INTERFACE_NUM}}=="{int(interface.rpartition(".")[2]):02x}"' if interface else ""
    links = " ".join(f"{PREFIX}{name}" for name in names)
    lines = [
        f"# {', '.join(names)}: {_LITERAL.sub(' ', adapter.product) or 'adapter'} "
        f"({adapter.vid:04x}:{adapter.pid:04x}), {_LITERAL.sub('?', known_by.replace(' ', '_')).replace('_', ' ')}",
        f'SUBSYSTEM=="tty", {device}{port}, GROUP="{GROUP}", MODE="0660", SYMLINK+="{links}"',
    ]
    if adapter.vid == FTDI:
        lines.append(f'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", {device}, ATTR{{latency_timer}}="1"')
    return Rule(names=names, text="\n".join(lines) + "\n", caution=caution)


def _kind(adapter: Adapter) -> tuple[int, int, str]:
    return adapter.vid, adapter.pid, adapter.serial_number


def kept_rules(text: str, names: Iterable[str]) -> str:
    """Of an earlier file of rules, those for ports of ``names``: their adapters are unplugged just now."""
    wanted = {f"{PREFIX}{name}" for name in names}
    # One paragraph each, as they are written.
    paragraphs = [paragraph.strip() for paragraph in text.split("\n\n")]
    kept = [p for p in paragraphs if (told := _NAME.search(p)) is not None and told[1] in wanted]
    return "\n\n".join(kept) + "\n" if kept else ""
