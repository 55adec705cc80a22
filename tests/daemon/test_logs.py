"""One line per event, for a person or for a machine."""

from __future__ import annotations

import json
import logging
import threading
from datetime import UTC, datetime

import pytest
import structlog

from heaved.daemon import logs
from heaved.daemon.logs import MOST_DIFFERENT, PERIOD_S, QUEUE_LINES, LineHandler, Repeats, configure_logging


def boom() -> None:
    raise ZeroDivisionError("float division by zero")


@pytest.mark.parametrize("log_format", ["human", "json"])
def test_one_line_per_event_even_with_a_traceback(capsys: pytest.CaptureFixture[str], log_format: str) -> None:
    configure_logging(log_format)
    log = structlog.get_logger("heaved.test")
    log.debug("not of interest")
    log.warning("device down", device="imu", detail="no answer: check power and cable")
    try:
        boom()
    except ZeroDivisionError as error:
        log.error("a bug", exc_info=error)
    logging.getLogger("asyncio").error("something of a library: %s", 7)
    logging.getLogger("pymodbus.logging").error("No response received after 0 retries")
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = captured.err.splitlines()
    assert len(lines) == 3
    assert "boom" in lines[1]
    assert "something of a library: 7" in lines[2]


def test_json_fields(capsys: pytest.CaptureFixture[str]) -> None:
    configure_logging("json")
    structlog.get_logger("heaved.test").warning("device down", device="imu", away_s=1.5)
    record = json.loads(capsys.readouterr().err)
    moment = datetime.fromisoformat(record.pop("timestamp"))
    assert moment.utcoffset() == datetime.now(UTC).utcoffset()
    assert record == {"event": "device down", "level": "warning", "device": "imu", "away_s": 1.5}


def test_human_fields(capsys: pytest.CaptureFixture[str]) -> None:
    configure_logging("human")
    structlog.get_logger("heaved.test").warning("device down", device="imu", away_s=1.23456789, detail="two words")
    line = capsys.readouterr().err.rstrip("\n")
    moment, rest = line.split(" ", 1)
    assert datetime.fromisoformat(moment).tzinfo is not None
    assert rest == "warning  device down  device=imu  away_s=1.23457  detail='two words'"


def test_an_unknown_format_names_the_known_ones() -> None:
    with pytest.raises(ValueError, match="human, json"):
        configure_logging("xml")


# ---- what comes again and again --------------------------------------------------------------------------------------


HEAD = len("2026-01-01T00:00:00.000000Z warning  ")
"""What stands before the event in a line."""


class Lines(list[str]):
    """What a handler has written, and its clock."""

    handler: LineHandler

    def __init__(self) -> None:
        super().__init__()
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def lines(monkeypatch: pytest.MonkeyPatch) -> Lines:
    lines = Lines()
    monkeypatch.setattr(logs, "_writer", lambda: lambda text: lines.append(text[HEAD:].rstrip("\n")))
    lines.handler = configure_logging("human")
    lines.handler._clock = lines
    return lines


def test_the_same_fault_is_one_line_and_a_count(lines: Lines) -> None:
    log = structlog.get_logger("heaved.test")
    for _ in range(1000):
        log.warning("no room", peer="a")
    assert lines == ["no room  peer=a"]
    lines.now_s = PERIOD_S
    log.warning("no room", peer="a")
    assert lines[1:] == ["no room (repeated 999 times in 10 s)  peer=a", "no room  peer=a"]
    lines.now_s = 3.0 * PERIOD_S
    log.info("something else")
    assert lines[3:] == ["something else"]


def test_other_devices_and_other_words_are_no_repetition(lines: Lines) -> None:
    log = structlog.get_logger("heaved.test")
    for device in ("imu", "laser"):
        for fault in ("timeout", "crc"):
            log.warning("device down", device=device, fault=fault)
    assert len(lines) == 4


def test_too_many_words_for_one_thing_are_counted(lines: Lines) -> None:
    log = structlog.get_logger("heaved.test")
    for i in range(1000):
        log.error("not understood", said=i)
    assert len(lines) == MOST_DIFFERENT
    lines.now_s = PERIOD_S
    log.info("go on")
    assert lines[MOST_DIFFERENT] == f"not understood (repeated {1000 - MOST_DIFFERENT} times in 10 s)  said=999"


def test_who_says_it_may_say_what_is_alike(lines: Lines) -> None:
    log = structlog.get_logger("heaved.test")
    for i in range(100):
        log.warning("client error", error=f"unknown {i}", alike="bad_request")
    assert lines == ["client error  error='unknown 0'"]


def test_what_is_no_fault_is_always_said(lines: Lines) -> None:
    log = structlog.get_logger("heaved.test")
    for _ in range(3):
        log.info("configuration read again")
    assert len(lines) == 3


def test_a_fault_of_a_library_is_one_traceback_and_a_count(lines: Lines) -> None:
    """Whatever addresses its text names."""
    for i in range(1000):
        try:
            boom()
        except ZeroDivisionError as error:
            logging.getLogger("asyncio").error("a fault\nobject at 0x%x", i, exc_info=error)
    assert len(lines) == 1
    assert "boom" in lines[0]
    lines.now_s = PERIOD_S
    logging.getLogger("asyncio").info("go on")
    assert lines[1] == "a fault (repeated 999 times in 10 s)"


def test_counts_are_said_at_the_end_at_the_latest(lines: Lines) -> None:
    log = structlog.get_logger("heaved.test")
    for _ in range(3):
        log.warning("no room")
    lines.now_s = 2.0
    lines.handler.flush()
    assert lines == ["no room", "no room (repeated 2 times in 2 s)"]


def test_little_is_kept_of_what_was_said() -> None:
    repeats = Repeats()
    for i in range(100_000):
        repeats.admits(logging.makeLogRecord({"msg": f"fault {i}", "levelno": logging.ERROR, "name": f"{i % 3}"}), 0.0)
    assert sum(len(alike.unsaid) for alike in repeats._alike.values()) <= 3 * (MOST_DIFFERENT + 1)
    assert len(repeats.over(PERIOD_S)) == 3
    assert repeats._alike == {}


@pytest.mark.parametrize("log_format", ["human", "json"])
def test_a_line_commands_no_terminal(capsys: pytest.CaptureFixture[str], log_format: str) -> None:
    configure_logging(log_format)
    evil = "\x1b]0;x\x07\x9b31m\u202e\x7f\n\r"
    structlog.get_logger("heaved.test").warning(f"event {evil}", detail=evil, other=f"with a space {evil}")
    logging.getLogger("asyncio").error("library %s", evil)
    shown = capsys.readouterr().err
    assert shown.count("\n") == 2
    assert shown.replace("\n", "").isprintable()


# ---- who reads it ----------------------------------------------------------------------------------------------------


def test_a_log_that_nobody_reads_holds_nobody_up() -> None:
    """A thread waits for the reader; beyond what is kept for it, lines are lost, and that is said."""
    reads, begun = threading.Event(), threading.Event()
    written = []

    def write(text: str) -> None:
        begun.set()
        reads.wait()
        written.append(text)

    handler = LineHandler(write)
    log = logging.Logger("heaved.test")
    log.addHandler(handler)
    with handler.in_background():
        log.info("first")
        begun.wait()
        for i in range(QUEUE_LINES + 500):
            log.info("line %d", i)
        assert written == []
        assert handler._lost == 500
    reads.set()  # What waits is left behind, not waited for.


def test_warnings_and_what_nobody_catches_go_into_the_log(capsys: pytest.CaptureFixture[str]) -> None:
    handler = configure_logging("human")
    with handler.in_background():
        thread = threading.Thread(target=boom, name="worker")
        thread.start()
        thread.join()
    shown = capsys.readouterr().err
    assert "the thread worker has ended" in shown
    assert "division by zero" in shown
    assert shown.count("\n") == 1
