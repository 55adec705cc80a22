"""What goes from the daemon to the process that records: small packed messages, many in one write. Pure.

Each is its length and kind, then its body. Packing is all that it costs the daemon's loop; what becomes a column, a
batch and a file of it is the work of the other process.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterator


class Kind(IntEnum):
    """Of a message."""

    SETTINGS = 0
    """JSON of :class:`heaved.recorder.layout.Settings`; the first."""
    HEADER = 1
    """JSON of :class:`heaved.recorder.layout.Header`: what follows is of another pair of files."""
    OFFSET = 2
    """UTC minus the monotonic clock, s, of what follows."""
    SAMPLE = 3
    CALL = 4
    FRAME = 5
    TEXT = 6
    """Of the next frame: number of the column, UTF-8."""


HEAD: Final = struct.Struct("<IB")
MOST_BYTES: Final = 64 << 20
"""A message is never so long: what claims to be is none."""
OFFSET: Final = struct.Struct("<d")
SAMPLE: Final = struct.Struct("<BqBd")
"""Number of the device, of the call, of the fault, time; then the values, doubles."""
CALL: Final = struct.Struct("<qBd")
"""Number of the call, what it is, time (nan: none); then its record."""
TIME: Final = struct.Struct("<d")
"""Of a frame; then its numbers, doubles."""


class MessageError(Exception):
    """Bytes that are no messages of ours."""


def packed(kind: Kind, body: bytes) -> bytes:
    """A message."""
    return HEAD.pack(len(body), kind) + body


class Splitter:
    """Messages from bytes that come in pieces."""

    def __init__(self) -> None:
        self._held = bytearray()

    def push(self, data: bytes) -> Iterator[tuple[Kind, bytes]]:
        """The messages that are whole now.

        Raises:
            MessageError: they are none of ours.
        """
        held = self._held
        held += data
        at = 0
        try:
            while len(held) - at >= HEAD.size:
                length, kind = HEAD.unpack_from(held, at)
                if length > MOST_BYTES or kind > Kind.TEXT:
                    raise MessageError(f"a message of kind {kind} and {length} bytes: not from this daemon")
                end = at + HEAD.size + length
                if end > len(held):
                    break
                yield Kind(kind), bytes(held[at + HEAD.size : end])
                at = end
        finally:
            del held[:at]
