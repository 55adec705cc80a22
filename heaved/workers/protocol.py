"""Frames between us and a worker process: a length of four bytes, big-endian, then one msgpack record."""

from __future__ import annotations

import struct
from typing import IO, TypeVar

import msgspec

Record = TypeVar("Record", bound=msgspec.Struct)

HEADER = struct.Struct(">I")
MAX_BODY_BYTES = 64 * 1024 * 1024
"""A window of 50 inputs at 20 Hz over an hour takes 29 MB; anything beyond this is not a frame."""


class FrameError(ValueError):
    """The stream does not carry our frames."""


def encode(record: msgspec.Struct) -> bytes:
    """The whole frame.

    Raises:
        FrameError: the record is larger than MAX_BODY_BYTES.
    """
    body = msgspec.msgpack.encode(record)
    if len(body) > MAX_BODY_BYTES:
        raise FrameError(f"a record of {len(body)} bytes does not fit a frame of {MAX_BODY_BYTES}: shorten the window")
    return HEADER.pack(len(body)) + body


def body_length(header: bytes) -> int:
    """Length of the body that follows this header.

    Raises:
        FrameError: no frame is that long.
    """
    length: int = HEADER.unpack(header)[0]
    if length > MAX_BODY_BYTES:
        raise FrameError(f"a frame claims {length} bytes, more than {MAX_BODY_BYTES}: not a frame")
    return length


def decode(body: bytes, record: type[Record]) -> Record:
    """The record inside a body.

    Raises:
        FrameError: the body is not such a record.
    """
    try:
        return msgspec.msgpack.decode(body, type=record)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise FrameError(f"a frame holds no {record.__name__}: {error}") from error


def read(stream: IO[bytes], record: type[Record]) -> Record | None:
    """The next record of a blocking stream; None at its end.

    Raises:
        FrameError: the stream ends inside a frame, or carries something else.
    """
    header = stream.read(HEADER.size)
    if not header:
        return None
    if len(header) < HEADER.size:
        raise FrameError("the stream ends inside the length of a frame")
    length = body_length(header)
    body = stream.read(length)
    if len(body) < length:
        raise FrameError(f"the stream ends after {len(body)} of {length} bytes of a frame")
    return decode(body, record)
