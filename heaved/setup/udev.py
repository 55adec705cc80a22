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

    from heaved.setup.adapters import Adapter

GROUP: Final = "dialout"
"""To whom serial ports belong on Debian; the unit is in it."""
FTDI: Final = "0403"
"""Vendor of adapters that hold bytes back for 16 ms, unless told otherwise."""
PREFIX: Final = "heaved-"
_LITERAL: Final = re.compile(r"[^A-Za-z0-9_.:-]")
_NAME: Final = re.compile(rf'SYMLINK\+="({re.escape(PREFIX)}[^" ]+)')


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


def rules(wanted: Mapping[str, Sequence[str]], plugged: Sequence[Adapter]) -> tuple[Rule, ...]:
    """A rule for each adapter that a port of the configuration is.

    wanted: by port, as a link has it, names of what is connected to it. plugged: what there is.
    """
    found = []
    for path, names in wanted.items():
        real = os.path.realpath(path)
        adapter = next((one for one in plugged if one.path == real), None)
        if adapter is not None and adapter.usb_id:
            found.append(_rule(tuple(names), adapter, plugged))
    return tuple(found)


def _rule(names: tuple[str, ...], adapter: Adapter, plugged: Sequence[Adapter]) -> Rule:
    usb, _, interface = adapter.socket.partition(":")
    vendor, _, product = adapter.usb_id.partition(":")
    matches = [f'ATTRS{{idVendor}}=="{vendor}"', f'ATTRS{{idProduct}}=="{product}"']
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
        f"# {', '.join(names)}: {_LITERAL.sub(' ', adapter.name) or 'adapter'} "
        f"({adapter.usb_id}), {_LITERAL.sub('?', known_by.replace(' ', '_')).replace('_', ' ')}",
        f'SUBSYSTEM=="tty", {device}{port}, GROUP="{GROUP}", MODE="0660", SYMLINK+="{links}"',
    ]
    if vendor == FTDI:
        lines.append(f'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", {device}, ATTR{{latency_timer}}="1"')
    return Rule(names=names, text="\n".join(lines) + "\n", caution=caution)


def _kind(adapter: Adapter) -> tuple[str, str]:
    return adapter.usb_id, adapter.serial_number


def kept_rules(text: str, names: Iterable[str]) -> str:
    """Of an earlier file of rules, those for ports of ``names``: their adapters are unplugged just now."""
    wanted = {f"{PREFIX}{name}" for name in names}
    # One paragraph each, as they are written.
    paragraphs = [paragraph.strip() for paragraph in text.split("\n\n")]
    kept = [p for p in paragraphs if (told := _NAME.search(p)) is not None and told[1] in wanted]
    return "\n\n".join(kept) + "\n" if kept else ""
