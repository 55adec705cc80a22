"""What a client of the stream may send: one short line, cut out of its bytes and understood or refused. Pure."""

from __future__ import annotations

import math
from typing import Final, Literal, get_args

import msgspec

from heaved.text import printable

MAX_REQUEST_BYTES: Final = 512
"""Longest line that a client may send, its line end included."""

StreamClass = Literal["MOTION", "SEA", "DELAYED", "HULL", "ATTITUDE", "REFERENCE", "QUIET", "STATUS"]
"""What a client may subscribe to. VERSION, ERROR and the answer to ``?STATUS`` are sent to all."""
STREAM_CLASSES: Final[tuple[str, ...]] = get_args(StreamClass)

ACCEPTED: Final = 'send ?WATCH={"classes":["MOTION","SEA"],"rate_hz":10}, ?STATUS or ?VERSION, one per line'


class Subscription(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``?WATCH=``: which classes, and at most how many lines of each a second."""

    classes: tuple[StreamClass, ...] = ("MOTION",)
    rate_hz: float | None = None
    """None: every line."""


class StatusQuery(msgspec.Struct, frozen=True):
    """``?STATUS``"""


class VersionQuery(msgspec.Struct, frozen=True):
    """``?VERSION``"""


class BadRequest(msgspec.Struct, frozen=True):
    """Anything else: what was wrong with it, and what is accepted."""

    message: str


Request = Subscription | StatusQuery | VersionQuery | BadRequest

_subscription_decoder = msgspec.json.Decoder(Subscription)


def parse_request(line: bytes) -> Request:
    """What one line of a client (its line end may be on) asks for. Never raises, whatever the bytes."""
    if len(line) > MAX_REQUEST_BYTES:
        return BadRequest(f"line of {len(line)} bytes, at most {MAX_REQUEST_BYTES} are read; {ACCEPTED}")
    text = line.strip()
    if text == b"?STATUS":
        return StatusQuery()
    if text == b"?VERSION":
        return VersionQuery()
    if text.startswith(b"?WATCH="):
        return _parse_subscription(text[len(b"?WATCH=") :])
    shown = text[:40].decode("utf-8", "backslashreplace")
    return BadRequest(f"not understood: {shown!r}; {ACCEPTED}")


def _parse_subscription(text: bytes) -> Subscription | BadRequest:
    try:
        wanted = _subscription_decoder.decode(text)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        return BadRequest(f"?WATCH: {printable(str(error))}; classes are {', '.join(STREAM_CLASSES)}; {ACCEPTED}")
    if wanted.rate_hz is not None and not 0.0 < wanted.rate_hz < math.inf:
        return BadRequest(f"?WATCH: rate_hz is {wanted.rate_hz}, it must be above 0; {ACCEPTED}")
    return wanted


class LineSplitter:
    """Cuts the bytes of a client into lines, whatever the pieces they arrive in, in bounded memory.

    Attributes:
        overflow: a line longer than MAX_REQUEST_BYTES has begun: nothing further can be read from this client.
    """

    def __init__(self) -> None:
        self.overflow = False
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """The lines that ``data`` completes, in order, without their line ends."""
        if self.overflow:
            return []
        *lines, rest = (self._rest + data).split(b"\n")
        for index, line in enumerate(lines):
            if len(line) >= MAX_REQUEST_BYTES:
                self.overflow, self._rest = True, b""
                return lines[:index]
        self.overflow = len(rest) >= MAX_REQUEST_BYTES
        self._rest = b"" if self.overflow else rest
        return lines
