"""``heaved watch``: the motion live in a terminal, through restarts of the daemon.

What is old, invalid or cut off is a dash, never a number. Marks and words say what colours say. Text of the daemon is
text: neither the terminal nor rich's markup obeys it.
"""

from __future__ import annotations

import io
import time
from collections import deque
from typing import TYPE_CHECKING, Any, Final, TextIO

import msgspec
from rich import box
from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from heaved.client.report import accelerometer_text, duration, reference_text, signed, spread
from heaved.client.stream_client import SILENCE_S, StreamConnection, Trouble, UnreachableError
from heaved.outputs.records import MotionRecord, StatusRecord
from heaved.samples import HeaveState
from heaved.text import printable

if TYPE_CHECKING:
    import ssl
    from collections.abc import Iterable, Iterator, Sequence

    from rich.console import ConsoleOptions, RenderableType, RenderResult

    from heaved.outputs.records import DeviceStatus, PointRecord

_REDRAW_S: Final = 0.2
_RETRY_S: Final = 0.5
_CONNECT_S: Final = 1.0
_STATUS_S: Final = 2.0
_OLD_S: Final = 1.0
"""Data older than this are not shown."""
_SCALE_WINDOW_S: Final = 60.0
"""The bar spans the greatest heave of the last minute."""
_SCALES_M: Final = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
_WIDE: Final = 150
"""Columns from which two tables stand side by side."""
_HORIZONS: Final = 4
"""Most predictions that a table shows ..."""
_COLUMN: Final = 15
"""... each so wide, beside ..."""
_FIRST_COLUMNS: Final = 15
"""... what stands before them: a number that is cut short would be another number."""


class _Look(msgspec.Struct, frozen=True):
    """How a state is shown."""

    mark: str
    style: str
    frame: box.Box = box.ROUNDED


_ALARM: Final = _Look("✖", "bold red", box.HEAVY)
_LOOKS: Final = {
    HeaveState.VALID: _Look("✔", "bold green"),
    HeaveState.DEGRADED: _Look("▲", "bold yellow", box.DOUBLE),
    HeaveState.SETTLING: _Look("◔", "bold yellow", box.DOUBLE),
    HeaveState.INVALID: _ALARM,
}


class View:
    """What the screen shows: the last records, when they came, and how the connection fares."""

    def __init__(self, where: str) -> None:
        self._where = where
        self._release = ""
        self._motion: MotionRecord | None = None
        self._motion_at_s = 0.0
        self._status: StatusRecord | None = None
        self._trouble: str | None = "connecting"
        self._connections = 0
        self._connected_at_s = 0.0
        self._lost_frames = 0
        self._heaves: deque[tuple[float, float]] = deque()  # (time, |heave|) within the window of the bar.

    def connected(self, release: str, now_s: float) -> None:
        """A daemon answers."""
        self._release, self._trouble = release, None
        self._connections += 1
        self._connected_at_s = now_s

    def lost(self, trouble: str) -> None:
        """It does not any more, and why."""
        self._trouble = trouble
        self._status = None  # What it said of its devices may have changed.

    def push(self, record: object, now_s: float) -> None:
        """One record of the stream."""
        if isinstance(record, StatusRecord):
            self._status = record
        elif isinstance(record, MotionRecord):
            self._motion, self._motion_at_s = record, now_s
            self._lost_frames += record.dropped or 0
            if record.heave_m is not None:
                self._heaves.append((now_s, abs(record.heave_m)))
        while self._heaves and self._heaves[0][0] < now_s - _SCALE_WINDOW_S:
            self._heaves.popleft()

    def render(self, now_s: float, width: int) -> RenderableType:
        """All of it for a terminal of ``width`` columns, from the most important down: a low one cuts the end off."""
        parts: list[RenderableType] = [
            _text(f"heaved {self._release} at {self._where}", "bold"),
            self._connection(now_s),
        ]
        motion = self._motion
        fresh = motion if motion is not None and self._trouble is None and self._age_s(now_s) <= _OLD_S else None
        if motion is not None:
            parts.append(self._heave_panel(motion, fresh, now_s))
        status = self._status
        if status is not None:
            parts += _troubles(status)
        if motion is not None:
            horizons = max(0, min(_HORIZONS, (width - _FIRST_COLUMNS) // _COLUMN))
            tables = [_attitude_table(motion, fresh, horizons), *_forecast_tables(motion, fresh, horizons)]
            parts += [_side_by_side(tables)] if width >= _WIDE else tables
            if motion.points:
                parts.append(_points_table(motion.points, is_known=_is_usable(fresh)))
        if status is not None:
            parts += _status_parts(status)
        return Group(*parts, _text("Ctrl-C ends", "dim"))

    def _age_s(self, now_s: float) -> float:
        assert self._motion is not None
        return now_s - self._motion_at_s + (self._motion.age_s or 0.0)

    def _connection(self, now_s: float) -> Text:
        if self._trouble is not None:
            return _text(f"✖ {self._trouble} - trying again", "bold red")
        since = f"connected for {duration(now_s - self._connected_at_s)}"
        again = f", connection {self._connections} since this view began" if self._connections > 1 else ""
        lost = f", {self._lost_frames} frames lost on the way" if self._lost_frames else ""
        return _text(since + again + lost, "dim")

    def _heave_panel(self, motion: MotionRecord, fresh: MotionRecord | None, now_s: float) -> Panel:
        age_s = self._age_s(now_s)
        if fresh is None:
            look, title = _ALARM, f"DATA {duration(age_s)} OLD"
        else:
            look, title = _LOOKS[motion.quality.heave], f"HEAVE {motion.quality.heave.value.upper()}"
        shown = motion if _is_usable(fresh) else None
        heave = Text.assemble(
            (signed(_of(shown, "heave_m"), " m", 2), look.style),
            f"  {spread(_of(shown, 'heave_std_m'), ' m', 3)}",
            f"  {signed(_of(shown, 'heave_velocity_mps'), ' m/s', 2)}",
            f"  laser {signed(_of(fresh, 'reference_m'), ' m', 3)} {fresh.quality.laser.value if fresh else ''}",
        )
        reasons = () if fresh is None else fresh.quality.reasons
        correction = (
            f"correction {fresh.quality.correction.value} {signed(fresh.correction_m, ' m', 3)}   " if fresh else ""
        )
        scale_m = max((heave_m for _, heave_m in self._heaves), default=0.0)
        return Panel(
            Group(
                heave,
                _Bar(_of(shown, "heave_m"), scale_m),
                *(_text(reason, look.style) for reason in reasons),
                _told(f"age {duration(age_s)}   {correction}{motion.time}"),
            ),
            title=_text(f" {look.mark} {title} ", f"{look.style} reverse"),
            title_align="left",
            box=look.frame,
            border_style=look.style,
            padding=(0, 1),
        )


class _Bar:
    """The heave on a scale, as wide as there is room."""

    def __init__(self, heave_m: float | None, greatest_m: float) -> None:
        self._heave_m, self._greatest_m = heave_m, greatest_m

    def __rich_console__(self, _console: Console, options: ConsoleOptions) -> RenderResult:
        yield _text(bar(self._heave_m, self._greatest_m, options.max_width).strip())


def bar(heave_m: float | None, greatest_m: float, width: int) -> str:
    """A scale from minus to plus the next round value above ``greatest_m``, filled from the middle to ``heave_m``."""
    scale_m = next((scale for scale in _SCALES_M if scale >= greatest_m), greatest_m)
    left, right = f"  {-scale_m:g} m ", f" {scale_m:+g} m"
    half = max(4, (width - len(left) - len(right) - 3) // 2)
    filled = 0 if heave_m is None else round(max(-1.0, min(1.0, heave_m / scale_m)) * half)
    below, above = "█" * max(0, -filled), "█" * max(0, filled)
    return f"{left}[{below:·>{half}}|{above:·<{half}}]{right}"


def _is_usable(fresh: MotionRecord | None) -> bool:
    """Whether its heave may stand on the screen: settling as such, invalid never."""
    return fresh is not None and fresh.quality.heave is not HeaveState.INVALID


def _of(record: MotionRecord | None, field: str) -> float | None:
    """A number of a record; None without one."""
    return None if record is None else getattr(record, field)


def _text(text: str, style: str = "") -> Text:
    return Text(printable(text), style=style, no_wrap=True, overflow="ellipsis")


def _told(text: str, style: str = "") -> Text:
    """What goes on in further lines, because all of it counts."""
    return Text(printable(text), style=style, overflow="fold")


def _table(*heads: str, rows: Iterable[Sequence[str | Text]], apart: int = 2) -> Table:
    table = Table(box=None, padding=(0, apart, 0, 0), header_style="dim", pad_edge=False)
    for index, head in enumerate(heads):
        table.add_column(_text(head), no_wrap=True, justify="left" if index == 0 else "right", overflow="ellipsis")
    for row in rows:
        table.add_row(*(cell if isinstance(cell, Text) else _text(cell) for cell in row))
    return table


def _side_by_side(tables: Sequence[RenderableType]) -> Table:
    grid = Table.grid(padding=(0, 6, 0, 0))
    grid.add_row(*tables)
    return grid


def _in(horizon_s: float) -> str:
    return f"in {horizon_s * 1e3:g} ms" if horizon_s < 1.0 else f"in {horizon_s:g} s"


def _attitude_table(motion: MotionRecord, fresh: MotionRecord | None, horizons: int) -> Table:
    """Each axis now and as it is predicted, with the half-width of the 95 % interval."""
    rock = motion.rock[-_HORIZONS:][:horizons]

    def cells(axis: str) -> Iterator[str]:
        yield axis
        yield signed(_of(fresh, f"{axis}_deg"), "°", 2)
        for one in rock:
            value, width = getattr(one, f"{axis}_deg"), getattr(one, f"{axis}_interval_deg")
            yield f"{signed(value, '°', 2)} {spread(width, '', 2)}".rstrip() if fresh else "-"

    heads = ("±95 %", "now", *(_in(one.horizon_s) for one in rock))
    return _table(*heads, rows=[tuple(cells(axis)) for axis in ("roll", "pitch", "yaw")], apart=1)


def _forecast_tables(motion: MotionRecord, fresh: MotionRecord | None, horizons: int) -> list[RenderableType]:
    forecast = motion.forecast[-_HORIZONS:][:horizons]
    if not forecast:
        return []
    is_known = _is_usable(fresh)
    cells = [
        f"{signed(one.heave_m, ' m', 2)} {spread(one.std_m, '', 2)}".rstrip() if is_known else "-" for one in forecast
    ]
    return [_table("±1σ", *(_in(one.horizon_s) for one in forecast), rows=[("heave", *cells)], apart=1)]


def _points_table(points: tuple[PointRecord, ...], *, is_known: bool) -> Table:
    def cells(point: PointRecord) -> tuple[str, ...]:
        state: HeaveState | None = point.state
        if not is_known or state is HeaveState.INVALID:
            return point.name, "-", "", "-", state.value if state and is_known else ""
        return (
            point.name,
            signed(point.heave_m, " m", 2),
            spread(point.heave_std_m, " m", 3),
            signed(point.heave_velocity_mps, " m/s", 2),
            state.value if state else "",
        )

    return _table("point", "heave", "std", "velocity", "", rows=map(cells, points))


def _troubles(status: StatusRecord) -> Iterator[Text]:
    """What is down, and what to do about it: before everything that only tells more."""
    for device in status.devices:
        if not device.up:
            yield _told(f"✖ {device.name} ({device.role}) DOWN: {_without_place(device)}", "bold red")
    if status.reference_mru is not None:
        for warning in status.reference_mru.warnings:
            yield _told(f"▲ {warning}", "bold yellow")
    for output in _outputs(status):
        if not output.up:
            yield _told(f"✖ output {output.name} ({output.kind}) DOWN: {output.detail}", "bold red")


def _outputs(status: StatusRecord) -> tuple[Any, ...]:
    """Those beside the stream."""
    return tuple(status.outputs)


def _state(is_up: bool) -> Text:
    return _text("✔ up", "green") if is_up else _text("✖ DOWN", "bold red")


def _status_parts(status: StatusRecord) -> Iterator[RenderableType]:
    yield _table("device", "role", "state", "rate", "last fault", rows=map(_device_cells, status.devices))
    if outputs := _outputs(status):
        yield _table("output", "speaks", "state", "sent", "lost", rows=map(_output_cells, outputs))
    if status.observer is not None and (told := accelerometer_text(status.observer)):
        yield _told(f"accelerometer   {told}", "dim")
    if status.reference_mru is not None:
        yield _told(f"reference MRU   {reference_text(status.reference_mru)}", "dim")


def _device_cells(device: DeviceStatus) -> tuple[str | Text, ...]:
    wanted = "" if device.wanted_rate_hz is None else f" of {device.wanted_rate_hz:g}"
    rate = "-" if device.rate_hz is None else f"{device.rate_hz:.1f}{wanted} Hz"
    ago = "" if device.last_fault_age_s is None else f" {duration(device.last_fault_age_s)} ago"
    fault = "-" if device.last_fault is None else f"{device.last_fault}{ago}"
    return device.name, device.role, _state(device.up), rate, fault


def _output_cells(output: Any) -> tuple[str | Text, ...]:
    lost = ", ".join(f"{reason} {count}" for reason, count in output.lost.items() if count)
    return output.name, output.kind, _state(output.up), str(output.sent), lost or "-"


def _without_place(device: DeviceStatus) -> str:
    """What is wrong, without the device's name and link before it: on a narrow screen nothing else would be seen."""
    place, _, what = device.detail.partition("): ")
    return what if what and place.startswith(f"{device.name} (") else device.detail


def watch(host: str, port: int, out: TextIO, tls: ssl.SSLContext | None = None) -> None:
    """Show the stream on the terminal ``out`` until the user interrupts (``KeyboardInterrupt`` is not caught)."""
    if isinstance(out, io.TextIOWrapper):
        out.reconfigure(errors="replace")  # A terminal that cannot show a mark still shows the word beside it.
    console = Console(file=out, force_terminal=True, highlight=False, markup=False, emoji=False)
    view = View(f"{host}:{port}")
    with Live(console=console, screen=True, auto_refresh=False, redirect_stdout=False, redirect_stderr=False) as screen:
        while True:
            try:
                _follow(view, host, port, screen, tls)
            except UnreachableError as error:
                view.lost(str(error))
                _draw(view, screen)
                time.sleep(_RETRY_S)


def _follow(view: View, host: str, port: int, screen: Live, tls: ssl.SSLContext | None) -> None:
    """Show one connection until it is lost.

    Raises:
        UnreachableError: it is.
    """
    _draw(view, screen)
    with StreamConnection(host, port, deadline_s=time.monotonic() + _CONNECT_S, tls=tls) as connection:
        heard_s = drawn_s = time.monotonic()
        asked_s = heard_s - _STATUS_S
        view.connected(connection.version.release, heard_s)
        connection.send('?WATCH={"classes":["MOTION"],"rate_hz":10}')
        while True:
            now_s = time.monotonic()
            if now_s - asked_s >= _STATUS_S:
                connection.send("?STATUS")
                asked_s = now_s
            record = connection.read(now_s + _REDRAW_S)
            now_s = time.monotonic()
            if record is not None:
                heard_s = now_s
                view.push(record, now_s)
            elif now_s - heard_s > SILENCE_S:
                raise UnreachableError(Trouble.SILENT, f"{host}:{port}: nothing said for {SILENCE_S:g} s")
            if now_s - drawn_s >= _REDRAW_S:
                _draw(view, screen)
                drawn_s = now_s


def _draw(view: View, screen: Live) -> None:
    screen.update(view.render(time.monotonic(), screen.console.width), refresh=True)
