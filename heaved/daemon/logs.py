"""Logging: one line per event on standard error, for a person or as JSON.

Who says something never waits for who reads it: within :meth:`LineHandler.in_background` a thread writes, and when
standard error takes nothing, lines are lost and counted. A fault that comes again and again is one line with a count,
whoever it comes from: see :class:`Repeats`. Nothing in a line moves the cursor of the terminal that shows it.
"""

from __future__ import annotations

import logging
import os
import sys
import threading
import time
from contextlib import contextmanager, suppress
from io import UnsupportedOperation
from queue import Empty, Full, Queue
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final

import msgspec
import structlog

from heaved.text import printable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from structlog.typing import EventDict, Processor

LOG_FORMATS = ("human", "json")
ALIKE: Final = "alike"
"""Field of an event that is not printed: says what makes two events the same, in place of all their fields."""
PERIOD_S: Final = 10.0
"""Within so long a fault that is the same is said once ..."""
MOST_DIFFERENT: Final = 20
"""... and so many that differ in their details."""
QUEUE_LINES: Final = 1000
"""Lines that wait for a slow reader of standard error; more are lost."""
DRAIN_S: Final = 0.2
"""At the end they are given so long."""

_CHATTY = {"pymodbus": logging.CRITICAL, "aiohttp": logging.CRITICAL}
"""Libraries that log every failed poll or request: the daemon logs the transitions itself."""

_stamp: Final = structlog.processors.TimeStamper(fmt="iso", utc=True)

_Key = tuple[str, int, str, str]


def configure_logging(log_format: str) -> LineHandler:
    """Send the daemon's events, and those of the libraries, to standard error.

    Raises:
        ValueError: ``log_format`` is neither ``human`` nor ``json``.
    """
    if log_format not in LOG_FORMATS:
        raise ValueError(f"log format {log_format!r}: choose one of {', '.join(LOG_FORMATS)}")
    shared: list[Processor] = [
        structlog.processors.add_log_level,
        _stamp,
    ]
    structlog.configure(
        processors=[*shared, structlog.stdlib.ProcessorFormatter.wrap_for_formatter],
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        logger_factory=structlog.stdlib.LoggerFactory(),
        cache_logger_on_first_use=False,
    )
    handler = LineHandler(_writer())
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=shared,
            processors=[
                structlog.stdlib.ProcessorFormatter.remove_processors_meta,
                structlog.processors.format_exc_info,  # Here, so that what is not printed is not worked out.
                render_json if log_format == "json" else render_human,
            ],
        )
    )
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.INFO)
    for name, level in _CHATTY.items():
        logging.getLogger(name).setLevel(level)
    return handler


def render_human(_logger: Any, _method: str, event: EventDict) -> str:
    """``2026-01-01T00:00:00.000000Z warning  device down: imu  fault=timeout polls=3``, always one line."""
    event.pop(ALIKE, None)
    time, level, text = event.pop("timestamp", ""), event.pop("level", ""), event.pop("event", "")
    head = f"{time} {level:<8} {printable(str(text))}"
    return "  ".join([head, *(f"{key}={_value(value)}" for key, value in event.items())])


def render_json(logger: Any, method: str, event: EventDict) -> str:
    """One object of JSON, in ASCII."""
    event.pop(ALIKE, None)
    return str(_render_json(logger, method, event)).replace("\x7f", "\\u007f")  # The one that JSON lets pass.


_render_json: Final = structlog.processors.JSONRenderer()


def _value(value: object) -> str:
    text = printable(f"{value:.6g}" if isinstance(value, float) else str(value))
    return repr(text) if " " in text or not text else text


# ---- what comes again and again --------------------------------------------------------------------------------------


class _Alike(msgspec.Struct):
    since_s: float
    unsaid: dict[str, int] = {}
    """How many were not printed, by what made them the same as one that was; those of too many kinds by nothing."""
    last: dict[str, logging.LogRecord] = {}
    """Of them."""


class Repeats:
    """Tells which warnings and errors are printed. Pure: times are arguments.

    Events are alike when they come from one logger with one text (for those of libraries: with one kind of exception)
    about one device. Of those alike, within :data:`PERIOD_S`, one that is word for word the same as another is counted,
    and so are all of other words than the first :data:`MOST_DIFFERENT`; counts are said when the period is over.
    """

    def __init__(self) -> None:
        self._alike: dict[_Key, _Alike] = {}

    def admits(self, record: logging.LogRecord, now_s: float) -> bool:
        """Whether to print ``record`` now."""
        if record.levelno < logging.WARNING:
            return True
        key, words = _identity(record)
        alike = self._alike.setdefault(key, _Alike(since_s=now_s))
        if words not in alike.unsaid and len(alike.unsaid) < MOST_DIFFERENT:
            alike.unsaid[words] = 0
            return True
        words = words if words in alike.unsaid else ""
        alike.unsaid[words] = alike.unsaid.get(words, 0) + 1
        alike.last[words] = record
        return False

    def over(self, now_s: float, period_s: float = PERIOD_S) -> list[logging.LogRecord]:
        """Forget what is longer ago than ``period_s``; returns what is to be said of it, with counts."""
        ended = [key for key, alike in self._alike.items() if now_s - alike.since_s >= period_s]
        return [
            _counted(record, alike.unsaid[words], now_s - alike.since_s)
            for alike in map(self._alike.pop, ended)
            for words, record in alike.last.items()
        ]


def _identity(record: logging.LogRecord) -> tuple[_Key, str]:
    """What makes events alike, and what makes two of those the same."""
    if not isinstance(record.msg, dict):
        place = _place(record.exc_info)
        # The text of a library may have an address in memory in it: with an exception, that says what it is.
        return (record.name, record.levelno, place.partition(" ")[0], ""), place or record.getMessage()
    event = record.msg
    error = event.get("exc_info")
    place = _place((type(error), error, error.__traceback__) if isinstance(error, BaseException) else None)
    words = event.get(ALIKE)
    if words is None:
        told = {key: value for key, value in event.items() if key not in ("timestamp", "exc_info")}
        words = f"{told} {place}"
    return (record.name, record.levelno, str(event.get("event")), str(event.get("device", ""))), str(words)


_Caught = tuple[type[BaseException], BaseException, TracebackType | None] | tuple[None, None, None]


def _place(caught: _Caught | None) -> str:
    """Kind of an exception, and the line that raised it."""
    if caught is None or caught[0] is None:
        return ""
    trace = caught[2]
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    where = f"{trace.tb_frame.f_code.co_filename}:{trace.tb_lineno}" if trace is not None else ""
    return f"{caught[0].__name__} {where}"


def _counted(record: logging.LogRecord, count: int, period_s: float) -> logging.LogRecord:
    """The last of some that were not printed, with their number; its traceback has been printed before."""
    note = f"(repeated {'once' if count == 1 else f'{count} times'} in {period_s:.0f} s)"
    if isinstance(record.msg, dict):
        told = {key: value for key, value in record.msg.items() if key != "exc_info"}
        message: Any = _stamp(None, "", told | {"event": f"{told.get('event')} {note}"})
    else:
        message = f"{record.getMessage().partition(chr(10))[0]} {note}"
    fields = record.__dict__ | {"msg": message, "args": (), "exc_info": None, "exc_text": None}
    return logging.makeLogRecord(fields)


# ---- where it goes ---------------------------------------------------------------------------------------------------


class LineHandler(logging.Handler):
    """Hands lines to ``write``, which may fail and, while :meth:`in_background` lasts, may take its time."""

    def __init__(self, write: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._write = write
        self._clock = clock
        self._repeats = Repeats()
        self._queue: Queue[str | None] | None = None
        self._lost = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Print or count ``record``. Called with the handler's lock, by whatever thread."""
        now_s = self._clock()
        try:
            for counted in self._repeats.over(now_s):
                self._say(self.format(counted))
            if self._repeats.admits(record, now_s):
                self._say(self.format(record))
        except Exception as error:  # What cannot be formatted must not stop who said it.  # noqa: BLE001
            self._say(f"an event that cannot be printed: {printable(repr(error))}")

    def flush(self) -> None:
        """Say what is still counted, however short its time."""
        with self._locked():
            for counted in self._repeats.over(self._clock(), period_s=0.0):
                self._say(self.format(counted))

    @contextmanager
    def in_background(self) -> Iterator[None]:
        """A thread writes the lines, those of warnings and of exceptions that nobody caught among them.

        At the end it is given :data:`DRAIN_S`, and left behind if that is not enough.
        """
        queue: Queue[str | None] = Queue(QUEUE_LINES)
        writing = threading.Thread(target=self._write_out, args=(queue,), name="log", daemon=True)
        hooks = sys.unraisablehook, threading.excepthook
        sys.unraisablehook, threading.excepthook = _log_unraisable, _log_thread
        logging.captureWarnings(True)
        self._queue = queue
        writing.start()
        try:
            yield
        finally:
            logging.captureWarnings(False)
            sys.unraisablehook, threading.excepthook = hooks
            self.flush()
            self._queue = None
            with suppress(Full):
                queue.put_nowait(None)
            writing.join(DRAIN_S)

    def _say(self, line: str) -> None:
        if self._queue is None:
            self._write(f"{line}\n")
            return
        try:
            self._queue.put_nowait(line)
        except Full:
            self._lost += 1

    def _write_out(self, queue: Queue[str | None]) -> None:
        while True:
            try:
                line = queue.get(timeout=1.0)
            except Empty:
                with self._locked():
                    for counted in self._repeats.over(self._clock()):
                        self._say(self.format(counted))
                continue
            if line is None:
                return
            self._write(f"{line}\n")
            if self._lost and queue.empty():
                lost, self._lost = self._lost, 0
                text = "%d lines of the log were lost: nobody took them"
                self.handle(logging.LogRecord(__name__, logging.WARNING, "", 0, text, (lost,), None))

    @contextmanager
    def _locked(self) -> Iterator[None]:
        self.acquire()
        try:
            yield
        finally:
            self.release()


def _writer() -> Callable[[str], None]:
    """Writes to standard error as it is now, without a buffer whose lock a hanging write would keep; what it does not
    take is lost, since there is no better place to say so.
    """
    stream = sys.stderr

    def write(text: str) -> None:
        rest = text.encode("utf-8", "backslashreplace")
        with suppress(OSError):
            while fd is not None and rest:
                rest = rest[os.write(fd, rest) :]

    def write_in_memory(text: str) -> None:
        stream.write(text)

    try:
        fd = stream.fileno() if stream is not None else None
    except UnsupportedOperation:  # A program that catches what is said.
        return write_in_memory
    return write


def _log_unraisable(caught: Any) -> None:
    text = caught.err_msg or "an exception that nobody can catch"
    logging.getLogger(__name__).error("%s: %r", text, caught.object, exc_info=caught.exc_value)


def _log_thread(caught: Any) -> None:
    name = caught.thread.name if caught.thread is not None else "?"
    logging.getLogger(__name__).error("the thread %s has ended", name, exc_info=caught.exc_value)
