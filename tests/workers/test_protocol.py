"""Frames against their definition: four bytes of length, then msgpack."""

from __future__ import annotations

import io
import struct

import msgspec
import pytest

from heaved.samples import TrainedNetwork
from heaved.workers import protocol

RESULT = TrainedNetwork(number=3, weights=b"\x00\x01", width=1, hidden=2, seconds=0.5)


def test_a_frame_is_a_length_and_a_record() -> None:
    frame = protocol.encode(RESULT)
    assert struct.unpack(">I", frame[:4])[0] == len(frame) - 4
    assert msgspec.msgpack.decode(frame[4:])["weights"] == b"\x00\x01"
    stream = io.BytesIO(frame + frame)
    assert protocol.read(stream, TrainedNetwork) == RESULT
    assert protocol.read(stream, TrainedNetwork) == RESULT
    assert protocol.read(stream, TrainedNetwork) is None


@pytest.mark.parametrize("kept", range(1, len(protocol.encode(RESULT))))
def test_a_cut_frame_is_an_error(kept: int) -> None:
    with pytest.raises(protocol.FrameError, match="ends"):
        protocol.read(io.BytesIO(protocol.encode(RESULT)[:kept]), TrainedNetwork)


@pytest.mark.parametrize(
    "stream",
    [
        b"Traceback (most recent call last)",  # text where a length should be claims gigabytes
        struct.pack(">I", 1) + b"\xc1",  # never used in msgpack
        struct.pack(">I", 1) + b"\x80",  # an empty map
        struct.pack(">I", 0),
        struct.pack(">I", 9) + b"\x81\xa6number\xa1x"[:9],
        struct.pack(">I", 3) + b"\x81\xa1\xff",  # not UTF-8
    ],
)
def test_garbage_is_an_error(stream: bytes) -> None:
    with pytest.raises(protocol.FrameError):
        protocol.read(io.BytesIO(stream), TrainedNetwork)


def test_a_record_beyond_the_limit_is_refused() -> None:
    with pytest.raises(protocol.FrameError, match="shorten"):
        protocol.encode(TrainedNetwork(number=1, weights=bytes(protocol.MAX_BODY_BYTES + 1)))
