"""One line per event, for a person or for a machine."""

import json
import logging
from datetime import UTC, datetime

import pytest
import structlog

from heaved.logs import configure_logging


@pytest.fixture(autouse=True)
def logging_as_before():
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield
    root.handlers[:], root.level = handlers, level
    structlog.reset_defaults()


def boom():
    raise ZeroDivisionError("float division by zero")


@pytest.mark.parametrize("log_format", ["human", "json"])
def test_one_line_per_event_even_with_a_traceback(capsys, log_format):
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


def test_json_fields(capsys):
    configure_logging("json")
    structlog.get_logger("heaved.test").warning("device down", device="imu", away_s=1.5)
    record = json.loads(capsys.readouterr().err)
    moment = datetime.fromisoformat(record.pop("timestamp"))
    assert moment.utcoffset() == datetime.now(UTC).utcoffset()
    assert record == {"event": "device down", "level": "warning", "device": "imu", "away_s": 1.5}


def test_human_fields(capsys):
    configure_logging("human")
    structlog.get_logger("heaved.test").warning("device down", device="imu", away_s=1.23456789, detail="two words")
    line = capsys.readouterr().err.rstrip("\n")
    moment, rest = line.split(" ", 1)
    assert datetime.fromisoformat(moment).tzinfo is not None
    assert rest == "warning  device down  device=imu  away_s=1.23457  detail='two words'"


def test_an_unknown_format_names_the_known_ones():
    with pytest.raises(ValueError, match="human, json"):
        configure_logging("xml")
