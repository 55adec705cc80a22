"""``heaved probe --live``: each register and what it means, side by side, while somebody lifts a corner."""

from __future__ import annotations

import time
from math import degrees, inf, nan, sqrt
from typing import TYPE_CHECKING, Final, TextIO

import msgspec
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from heaved.devices.profile import Block, Profile, Quantity, field_registers
from heaved.setup.survey import signed_word
from heaved.text import printable

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rich.console import RenderableType

    from heaved.setup.polling import Polls

REDRAW_S: Final = 0.2
_FADES_S: Final = 1.0
"""For so long after it a leap stays marked."""
_LEAP: Final = 5.0
"""Times its usual distance from where it was a moment ago, by which a value is away when somebody moves the sensor."""
_MOMENT_S: Final = 2.0
_USUAL_S: Final = 20.0
"""Time constants of where a value was, and of how far it usually is from there."""
_SETTLED: Final = 20
"""Readings from which that is known."""
_COLUMNS: Final = ("", "register", "hex", "raw", "type", "value", "unit", "min", "max", "new/s")
_NEEDS_COLUMNS: Final = {"type": 88, "raw": 78, "hex": 70, "new/s": 66}
"""Width of a terminal below which a column is left out,"""
_PAIR_COLUMNS: Final = 12
"""and so much more where values take two registers."""
_UNITS: Final = {"mps2": "m/s2", "rad": "deg", "radps": "deg/s", "m": "m", "c": "degC", "s": "s", "mps": "m/s"}


class Cell(msgspec.Struct):
    """One row: a value of the profile, or a register that means nothing yet."""

    address: int
    function: str
    indices: tuple[int, ...]
    """Of its registers in a poll."""
    kind: str
    quantity: Quantity | None = None
    words: tuple[int, ...] = ()
    value: float = nan
    low: float = inf
    high: float = -inf
    changes: int = 0
    readings: int = 0
    at_s: float = nan
    slow: float = nan
    spread2: float = 0.0
    smallest: float = 0.0
    """Least change so far: what is coarse is not moved when it changes by a count or two."""
    leapt_at_s: float = -inf

    def take(self, words: tuple[int, ...], value: float, now_s: float) -> None:
        """One more reading."""
        if self.readings == 0:
            self.slow = value
        else:
            self._compare(words, value, now_s)
        self.words, self.value, self.at_s = words, value, now_s
        self.low, self.high = min(self.low, value), max(self.high, value)
        self.readings += 1

    def _compare(self, words: tuple[int, ...], value: float, now_s: float) -> None:
        off, passed_s = abs(value - self.slow), max(now_s - self.at_s, 0.0)
        if self.readings >= _SETTLED and off > _LEAP * max(sqrt(self.spread2), self.smallest) and off > 0.0:
            self.leapt_at_s = now_s
        if words != self.words:
            self.changes += 1
            step = abs(value - self.value)
            self.smallest = min(self.smallest or step, step)
        self.slow += (value - self.slow) * min(passed_s / _MOMENT_S, 1.0)
        self.spread2 += (off**2 - self.spread2) * max(min(passed_s / _USUAL_S, 1.0), 1.0 / (self.readings + 1))


def cells(blocks: Sequence[Block]) -> list[Cell]:
    """The rows of some blocks: each field, and each register between them."""
    found: list[Cell] = []
    begin = 0
    for block in blocks:
        end = max(field.offset + field_registers(field) for field in block.fields)
        taken: set[int] = set()
        for field in block.fields:
            offsets = range(field.offset, field.offset + field_registers(field))
            taken.update(offsets)
            order = "" if field.byte_order == "ABCD" else f" {field.byte_order}"
            found.append(
                Cell(block.start + field.offset, block.function, tuple(begin + i for i in offsets),
                     field.type + order, field.quantity)
            )  # fmt: skip
        found += [Cell(block.start + i, block.function, (begin + i,), "-") for i in range(end) if i not in taken]
        begin += end
    return sorted(found, key=lambda cell: cell.indices)


class View:
    """What the screen shows."""

    def __init__(self, title: str, profile: Profile) -> None:
        self._title = title
        self.profile = profile
        self.cells = cells(profile.blocks)
        self._polls = 0
        self._lost = 0
        self._detail = ""
        self._began_s = nan
        self._last_s = nan

    def push(self, polls: Polls, now_s: float) -> None:
        """Take the newest poll; those before it are let go of, for this may run for hours."""
        lost = sum(polls.lost.values())
        if lost > self._lost:
            self._lost, self._detail = lost, next(reversed(polls.lost))
        if not polls.registers:
            return
        registers, values = polls.registers[-1], polls.values[-1]
        if self._polls == 0:
            self._began_s = now_s
        self._polls, self._last_s = self._polls + 1, now_s
        for cell in self.cells:
            words = tuple(registers[i] for i in cell.indices)
            value = values[cell.quantity] if cell.quantity is not None else float(signed_word(words[0]))
            cell.take(words, value, now_s)
        for column in (polls.sent_s, polls.round_trips_s, polls.registers, polls.values):
            column.clear()

    def render(self, now_s: float, width: int) -> RenderableType:
        """All of it for a terminal of ``width`` columns. On a narrow one what the registers are made of is left out, as
        a number that is cut short would be another number.
        """
        pairs = _PAIR_COLUMNS if any(len(cell.indices) > 1 for cell in self.cells) else 0
        left_out = {name for name, least in _NEEDS_COLUMNS.items() if width < least + pairs}
        table = Table(box=None, pad_edge=False, header_style="dim")
        kept = [name for name in _COLUMNS if name not in left_out]
        for name in kept:
            table.add_column(name, justify="left" if name in ("", "type", "unit") else "right", no_wrap=True)
        for cell in self.cells:
            row = self._row(cell, now_s)
            moved = now_s - cell.leapt_at_s < _FADES_S
            style = "bold reverse" if moved else "" if cell.quantity is not None else "dim"
            table.add_row(*(Text(row[name], style) for name in kept))
        return Group(Text(printable(self._title), "bold"), Text(self._pace(now_s)), table, *self._foot())

    def _pace(self, now_s: float) -> str:
        if self._polls == 0:
            return "waiting for the first answer"
        span_s = self._last_s - self._began_s
        pace = f"{(self._polls - 1) / span_s:.1f} polls a second" if span_s > 0.0 else "first answer"
        old_s = now_s - self._last_s
        return pace + (f"; no answer for {old_s:.0f} s" if old_s > 1.0 else "")

    def _row(self, cell: Cell, now_s: float) -> dict[str, str]:
        """What stands in each column."""
        factor, unit = _shown_in(cell.quantity)
        span_s = self._last_s - self._began_s
        value, low, high = (f"{factor * number:.3f}" for number in (cell.value, cell.low, cell.high))
        if cell.quantity is None:
            value, low, high = "", low.partition(".")[0], high.partition(".")[0]
        if not cell.words:
            value = low = high = ""
        is_signed = cell.kind.startswith("int16") or cell.quantity is None
        name = (cell.quantity or "").rpartition("_")[0] or cell.quantity or ""
        return {
            "": name + (" ◀" if now_s - cell.leapt_at_s < _FADES_S else ""),
            "register": f"{'input ' if cell.function == 'input' else ''}0x{cell.address:02X}",
            "hex": " ".join(f"{word:04X}" for word in cell.words),
            "raw": " ".join(str(signed_word(word) if is_signed else word) for word in cell.words),
            "type": cell.kind,
            "value": value,
            "unit": unit,
            "min": low,
            "max": high,
            "new/s": f"{cell.changes / span_s:.1f}" if span_s > 0.0 else "",
        }

    def _foot(self) -> Iterator[Text]:
        if self._lost:
            yield Text(f"{self._lost} without an answer, the latest: {printable(self._detail)}", "yellow")
        yield Text("lift a corner: what moves is marked ◀. Ctrl-C ends", "dim")


def _shown_in(quantity: Quantity | None) -> tuple[float, str]:
    """Factor and unit in which people read a quantity."""
    ending = (quantity or "").rpartition("_")[2]
    unit = _UNITS.get(ending, "")
    return (degrees(1.0) if unit.startswith("deg") and ending != "c" else 1.0), unit


class Screen:
    """The view on a terminal, drawn anew five times a second; a context manager."""

    def __init__(self, view: View, out: TextIO) -> None:
        self._view = view
        console = Console(file=out, force_terminal=True, highlight=False, markup=False, emoji=False)
        self._live = Live(
            console=console, screen=True, auto_refresh=False, redirect_stdout=False, redirect_stderr=False
        )
        self._drawn_s = -inf

    def __enter__(self) -> Screen:
        self._live.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.__exit__(None, None, None)

    def push(self, polls: Polls) -> None:
        """The newest poll, and the screen if it is time."""
        now_s = time.monotonic()
        self._view.push(polls, now_s)
        if now_s - self._drawn_s >= REDRAW_S:
            self._live.update(self._view.render(now_s, self._live.console.width), refresh=True)
            self._drawn_s = now_s
