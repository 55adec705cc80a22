"""Tables of the manual that are made from the code's own: nothing is written twice."""

from __future__ import annotations

import inspect
import sys
from typing import TYPE_CHECKING, Final, get_args

import msgspec

from heaved.config.read import data_directory, packaged_profiles
from heaved.devices.profile import SI, Role, role_quantities
from heaved.manual.configuration import reference
from heaved.outputs.records import (
    AttitudeRecord,
    DelayedRecord,
    ForecastRecord,
    HullRecord,
    MotionRecord,
    PointRecord,
    QuietRecord,
    RockRecord,
    SeaRecord,
    VersionRecord,
    WaveSystemRecord,
)
from heaved.outputs.register_map import FIXED, QUALITIES, Register, of_horizon, of_point
from heaved.outputs.telegrams.formats import FORMATS
from heaved.samples import Fault, Vibration

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from heaved.outputs.telegrams.spec import Format


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """As Markdown has it."""
    cells = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in cells)


def configuration() -> str:
    """Every key of the file that ships."""
    return reference((data_directory() / "heaved.toml").read_text(encoding="utf-8"))


def telegrams() -> str:
    """What each format is, in a line."""

    def row(name: str, form: Format) -> Sequence[str]:
        most = "" if form.most_hz is None else f"{form.most_hz:g}"
        signs = form.signs
        usual = f"heave {signs.heave.value}, {signs.roll.value}, {signs.pitch.value}, {signs.convention.value}"
        return f"`{name}`", form.title, f"{form.longest_bytes}", most, form.lead.value, usual.replace("_", " ")

    head = "telegram", "what", "bytes at most", "Hz at most", "moment", "signs"
    return markdown_table(head, (row(name.value, form) for name, form in FORMATS.items()))


def telegram_layouts() -> str:
    """What each format has in it: the description beside its encoder."""
    parts = []
    for module in dict.fromkeys(form.encode.__module__ for form in FORMATS.values()):
        names = [f"`{name.value}`" for name, form in FORMATS.items() if form.encode.__module__ == module]
        described = inspect.cleandoc(sys.modules[module].__doc__ or "").replace("``", "")
        parts.append(f"### {', '.join(names)}\n\n```text\n{described}\n```\n")
    return "\n".join(parts)


def _registers(registers: Iterable[Register], sign: str = "") -> str:
    rows, place = [], 0
    for one in registers:
        step = f"{1 / one.per_unit:g} {one.unit}" if one.unit else ""
        unknown = f"{one.kind.unknown:0{4 * one.kind.words}X}h"
        rows.append(
            (f"{sign}{place}", one.name, one.kind.name.lower(), step, unknown, one.axis.value.replace("none", ""))
        )
        place += one.kind.words
    return markdown_table(("register", "what", "type", "one step", "not known", "sign of"), rows)


def registers() -> str:
    """The fixed part of the map."""
    return _registers(FIXED)


def registers_of_horizon() -> str:
    """What follows for each horizon."""
    return _registers(of_horizon(1.0), "+").replace(" in 1 s", "")


def registers_of_point() -> str:
    """What follows for each point."""
    return _registers(of_point(0, "the point"), "+")


def qualities() -> str:
    """Words of quality."""
    return markdown_table(("word", "heave"), ((str(word), f"`{state.value}`") for state, word in QUALITIES.items()))


def profiles() -> str:
    """Those that come with the program."""
    rows = [
        (
            f"`{profile.name}`",
            profile.description,
            f"{profile.bandwidth_hz:g}" if profile.bandwidth_hz else "",
            ", ".join(dict.fromkeys(f"{field.quantity}" for block in profile.blocks for field in block.fields)),
        )
        for profile in packaged_profiles()
    ]
    return markdown_table(("profile", "device", "bandwidth, Hz", "quantities"), rows)


def roles() -> str:
    """What a device of each role may give."""
    rows = [(f"`{role}`", ", ".join(role_quantities(role))) for role in get_args(Role)]
    return markdown_table(("role", "quantities"), rows)


def units() -> str:
    """Units of profiles."""
    kinds: dict[str, list[str]] = {}
    for unit, (_, kind) in SI.items():
        kinds.setdefault(kind, []).append(f"`{unit}`")
    return markdown_table(("of", "units"), ((kind, ", ".join(units)) for kind, units in kinds.items()))


def faults() -> str:
    """Words for a sample that carries nothing."""
    return ", ".join(f"`{fault.value}`" for fault in Fault if fault is not Fault.NONE)


def records() -> str:
    """Records of the stream with their keys."""
    kinds = (VersionRecord, MotionRecord, SeaRecord, DelayedRecord, QuietRecord, HullRecord, AttitudeRecord)
    parts = (RockRecord, ForecastRecord, PointRecord, WaveSystemRecord, Vibration)
    named: list[tuple[str, type[msgspec.Struct]]] = [(f"`{kind.__struct_config__.tag}`", kind) for kind in kinds]
    named += [(f"in {kind.__name__.removesuffix('Record')}", kind) for kind in parts]
    rows = [(name, ", ".join(field.encode_name for field in msgspec.structs.fields(kind))) for name, kind in named]
    return markdown_table(("record", "keys"), rows)


TABLES: Final[dict[str, Callable[[], str]]] = {
    "configuration": configuration,
    "telegrams": telegrams,
    "telegram-layouts": telegram_layouts,
    "records": records,
    "registers": registers,
    "registers-of-horizon": registers_of_horizon,
    "registers-of-point": registers_of_point,
    "qualities": qualities,
    "profiles": profiles,
    "roles": roles,
    "units": units,
    "faults": faults,
}
"""By the names that topics have for them; what the command line knows of itself is added by it."""
