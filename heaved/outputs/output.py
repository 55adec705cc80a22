"""What every output beside the stream is to the daemon, and how it fares: one record for status, metrics and log."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

import msgspec
import structlog

from heaved.outputs.records import StatusRecord

if TYPE_CHECKING:
    from heaved.samples import MotionFrame

_log = structlog.get_logger(__name__)


class Output(Protocol):
    """Something that is told each frame.

    Attributes:
        health: how it fares.
    """

    health: OutputHealth

    def publish(self, frame: MotionFrame) -> None:
        """Take a frame: hand over, never wait, whatever the far end does."""

    async def run(self) -> None:
        """Keep what it needs (a connection, a port), for ever; when cancelled, give all of it back."""


class Told(msgspec.Struct, frozen=True):
    """What an output may ask the daemon."""

    status: Callable[[], StatusRecord]
    """Makes the STATUS of now."""
    utc_s: Callable[[float], float]
    """UTC, seconds since 1970, of a time on ..."""
    clock: Callable[[], float] = time.monotonic
    """... the monotonic clock of the frames."""


class OutputHealth:
    """How an output fares; changes are logged, and nothing else is.

    Attributes:
        name: of the output, as configured.
        kind: what it speaks, for people.
        where: its link, for people.
        is_up: whether what it says goes out.
        detail: why not, and what to do; empty when well.
        sent: messages that went out.
        lost: that did not, by reason.
        connections: times that it came up.
    """

    def __init__(self, name: str, kind: str, where: str) -> None:
        self.name, self.kind, self.where = name, kind, where
        self.is_up = False
        self.detail = "not connected yet"
        self.sent = 0
        self.lost: Counter[str] = Counter()
        self.connections = 0

    def up(self) -> None:
        """It works (again)."""
        if not self.is_up:
            self.is_up, self.detail = True, ""
            self.connections += 1
            _log.info("output up", output=self.name, kind=self.kind, where=self.where)

    def down(self, detail: str) -> None:
        """It does not: what, and what to do."""
        if self.is_up or detail != self.detail:
            _log.warning("output down", output=self.name, kind=self.kind, where=self.where, detail=detail)
        self.is_up, self.detail = False, detail
