"""Logging: one line per event on standard error, for a person or as JSON."""

from __future__ import annotations

import logging
import sys
from typing import Any

import structlog
from structlog.typing import EventDict, Processor

LOG_FORMATS = ("human", "json")

_CHATTY = {"pymodbus": logging.CRITICAL, "aiohttp.access": logging.WARNING}
"""Libraries that log every failed poll or request: the daemon logs the transitions itself."""


def configure_logging(log_format: str) -> None:
    """Send the daemon's events, and those of the libraries, to standard error.

    Raises:
        ValueError: ``log_format`` is neither ``human`` nor ``json``.
    """
    if log_format not in LOG_FORMATS:
        raise ValueError(f"log format {log_format!r}: choose one of {', '.join(LOG_FORMATS)}")
    shared: list[Processor] = [
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        structlog.processors.format_exc_info,
    ]
    render: Processor = structlog.processors.JSONRenderer() if log_format == "json" else render_human
    structlog.configure(
        processors=[*shared, structlog.stdlib.ProcessorFormatter.wrap_for_formatter],
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        logger_factory=structlog.stdlib.LoggerFactory(),
        cache_logger_on_first_use=False,
    )
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=shared,
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, render],
        )
    )
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.INFO)
    for name, level in _CHATTY.items():
        logging.getLogger(name).setLevel(level)


def render_human(_logger: Any, _method: str, event: EventDict) -> str:
    """``2026-01-01T00:00:00.000000Z warning  device down: imu  fault=timeout polls=3``, always one line."""
    time, level, text = event.pop("timestamp", ""), event.pop("level", ""), event.pop("event", "")
    head = f"{time} {level:<8} {_one_line(str(text))}"
    return "  ".join([head, *(f"{key}={_value(value)}" for key, value in event.items())])


def _value(value: object) -> str:
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return repr(text) if " " in text or "\n" in text or not text else text


def _one_line(text: str) -> str:
    return text.replace("\n", "\\n")
