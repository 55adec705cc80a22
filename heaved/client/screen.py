"""``heaved watch``: the motion live in a terminal, through restarts of the daemon."""

from __future__ import annotations

import shutil
import time
from collections import deque
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final, TextIO

from heaved.client.report import accelerometer_text, duration, signed, spread
from heaved.client.stream_client import SILENCE_S, StreamConnection, Trouble, UnreachableError
from heaved.outputs.records import DeviceStatus, MotionRecord, StatusRecord
from heaved.samples import HeaveState
from heaved.text import printable

if TYPE_CHECKING:
    from collections.abc import Iterator

_REDRAW_S: Final = 0.2
_RETRY_S: Final = 0.5
_CONNECT_S: Final = 1.0
_STATUS_S: Final = 2.0
_OLD_S: Final = 1.0
"""Data older than this are shown as such."""
_SCALE_WINDOW_S: Final = 60.0
"""The bar spans the greatest heave of the last minute."""
_SCALES_M: Final = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)

_RESET, _BOLD, _DIM, _RED, _GREEN, _YELLOW = "\x1b[0m", "\x1b[1m", "\x1b[2m", "\x1b[31m", "\x1b[32m", "\x1b[33m"
_COLOURS: Final = {
    HeaveState.VALID: _GREEN,
    HeaveState.DEGRADED: _YELLOW,
    HeaveState.SETTLING: _YELLOW,
    HeaveState.INVALID: _RED,
}
_GLYPHS: Final = {
    "0": ("███", "█ █", "█ █", "█ █", "███"),
    "1": (" █ ", "██ ", " █ ", " █ ", "███"),
    "2": ("███", "  █", "███", "█  ", "███"),
    "3": ("███", "  █", "███", "  █", "███"),
    "4": ("█ █", "█ █", "███", "  █", "  █"),
    "5": ("███", "█  ", "███", "  █", "███"),
    "6": ("███", "█  ", "███", "█ █", "███"),
    "7": ("███", "  █", "  █", "  █", "  █"),
    "8": ("███", "█ █", "███", "█ █", "███"),
    "9": ("███", "█ █", "███", "  █", "███"),
    "+": ("   ", " █ ", "███", " █ ", "   "),
    "-": ("   ", "   ", "███", "   ", "   "),
    ".": (" ", " ", " ", " ", "█"),
    "m": ("     ", "     ", "████ ", "█ █ █", "█ █ █"),
    " ": (" ", " ", " ", " ", " "),
}  # fmt: skip


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

    def render(self, now_s: float, width: int) -> list[str]:
        """The screen's lines, with colours, none wider than ``width`` columns."""
        lines = [(_BOLD, f"heaved {self._release} at {self._where}"), self._connection_line(now_s), ("", "")]
        if self._motion is not None:
            lines += self._motion_lines(self._motion, now_s, width)
        if self._status is not None:
            lines += [("", ""), *_device_lines(self._status)]
            if self._status.observer is not None and (told := accelerometer_text(self._status.observer)):
                lines.append((_DIM, f"  accelerometer   {told}"))
        lines += [("", ""), (_DIM, "Ctrl-C ends")]
        return [f"{colour}{printable(text)[:width]}{_RESET if colour else ''}" for colour, text in lines]

    def _connection_line(self, now_s: float) -> tuple[str, str]:
        if self._trouble is not None:
            return _RED, f"{self._trouble} - trying again"
        since = f"connected for {duration(now_s - self._connected_at_s)}"
        again = f", connection {self._connections} since this view began" if self._connections > 1 else ""
        lost = f", {self._lost_frames} frames lost on the way" if self._lost_frames else ""
        return _DIM, since + again + lost

    def _motion_lines(self, motion: MotionRecord, now_s: float, width: int) -> Iterator[tuple[str, str]]:
        age_s = now_s - self._motion_at_s + (motion.age_s or 0.0)
        is_old = age_s > _OLD_S
        colour = _RED if is_old else _COLOURS[motion.quality.heave]
        heave = "-" if motion.heave_m is None else f"{motion.heave_m:+.2f} m"
        for row in big(heave):
            yield (_DIM if is_old else _BOLD + colour), f"  {row}"
        yield "", ""
        std, velocity = spread(motion.heave_std_m, " m", 3), signed(motion.heave_velocity_mps, " m/s", 2)
        yield "", f"  {std}   {velocity}   laser {signed(motion.reference_m, ' m', 3)}"
        if is_old:
            yield _BOLD + _RED, f"  DATA {duration(age_s)} OLD"
        else:
            state, (first, *others) = motion.quality.heave.value.upper(), motion.quality.reasons or ("",)
            yield _BOLD + colour, f"  {state}: {first}" if first else f"  {state}"
            yield from ((colour, f"  {' ' * len(state)}  {reason}") for reason in others)
        yield "", ""
        scale_m = max((heave_m for _, heave_m in self._heaves), default=0.0)
        yield "", bar(motion.heave_m, scale_m, width)
        attitude = (("roll", motion.roll_deg), ("pitch", motion.pitch_deg), ("yaw", motion.yaw_deg))
        yield "", ""
        yield "", "  " + "   ".join(f"{name} {signed(value, '°', 2)}" for name, value in attitude)
        correction = f"correction {motion.quality.correction.value} {signed(motion.correction_m, ' m', 3)}"
        yield "", f"  {correction}   laser {motion.quality.laser.value}   age {duration(age_s)}   {motion.time}"


def big(text: str) -> list[str]:
    """``text`` of digits, signs and m in letters five lines high."""
    return [" ".join(_GLYPHS[letter][row] for letter in text) for row in range(5)]


def bar(heave_m: float | None, greatest_m: float, width: int) -> str:
    """A scale from minus to plus the next round value above ``greatest_m``, filled from the middle to ``heave_m``."""
    scale_m = next((scale for scale in _SCALES_M if scale >= greatest_m), greatest_m)
    left, right = f"  {-scale_m:g} m ", f" {scale_m:+g} m"
    half = max(4, (width - len(left) - len(right) - 3) // 2)
    filled = 0 if heave_m is None else round(max(-1.0, min(1.0, heave_m / scale_m)) * half)
    below, above = "█" * max(0, -filled), "█" * max(0, filled)
    return f"{left}[{below:·>{half}}|{above:·<{half}}]{right}"


def _device_lines(status: StatusRecord) -> Iterator[tuple[str, str]]:
    for device in status.devices:
        rate = "-" if device.rate_hz is None else f"{device.rate_hz:.1f} Hz"
        fault = "" if device.last_fault is None else f"   last fault {device.last_fault}"
        state = "up" if device.up else "DOWN"
        colour = _GREEN if device.up else _RED
        yield colour, f"  {device.name} ({device.role}) {state}   {rate}{fault}"
        if device.detail:
            yield colour, f"    {_without_place(device)}"


def _without_place(device: DeviceStatus) -> str:
    """What is wrong, without the device's name and link before it: on a narrow screen nothing else would be seen."""
    place, _, what = device.detail.partition("): ")
    return what if what and place.startswith(f"{device.name} (") else device.detail


def watch(host: str, port: int, out: TextIO) -> None:
    """Show the stream on the terminal ``out`` until the user interrupts (``KeyboardInterrupt`` is not caught)."""
    view = View(f"{host}:{port}")
    with _own_screen(out):
        while True:
            try:
                _follow(view, host, port, out)
            except UnreachableError as error:
                view.lost(str(error))
                _draw(view, out)
                time.sleep(_RETRY_S)


def _follow(view: View, host: str, port: int, out: TextIO) -> None:
    """Show one connection until it is lost.

    Raises:
        UnreachableError: it is.
    """
    _draw(view, out)
    with StreamConnection(host, port, deadline_s=time.monotonic() + _CONNECT_S) as connection:
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
                _draw(view, out)
                drawn_s = now_s


def _draw(view: View, out: TextIO) -> None:
    """Over the old screen, each line cleared to its end, so that nothing flickers."""
    width, height = shutil.get_terminal_size()
    lines = view.render(time.monotonic(), width)[:height]
    out.write("\x1b[H" + "\x1b[K\r\n".join(lines) + "\x1b[K\x1b[J")
    out.flush()


@contextmanager
def _own_screen(out: TextIO) -> Iterator[None]:
    """The terminal's second screen without a cursor; what was there before comes back at the end."""
    out.write("\x1b[?1049h\x1b[?25l\x1b[2J")
    try:
        yield
    finally:
        out.write("\x1b[?25h\x1b[?1049l")
        out.flush()
