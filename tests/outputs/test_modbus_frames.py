"""Modbus frames: what a request gets by the standard, requests found on a busy serial line, results of writes."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st
from modbus_slaves import mbap_answer, pdu_answer, rtu

from heaved.outputs.modbus_frames import (
    NotModbusError,
    RtuRequests,
    TcpFrames,
    asked,
    explain_refusal,
    find_write_result,
    read_answer,
    refusal,
    rtu_frame,
    tcp_frame,
    write_request,
    write_result,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

START, WORDS = 3, 66


def read(first: int, count: int, function: int = 3) -> bytes:
    return struct.pack(">BHH", function, first, count)


@pytest.mark.parametrize(
    ("request_pdu", "code", "wanted"),
    [
        (read(3, 6), 0, range(6)),
        (read(3, 6, 4), 0, range(6)),
        (read(3, 66), 0, range(66)),
        (read(68, 1), 0, range(65, 66)),
        (read(2, 1), 2, range(0)),
        (read(0, 6), 2, range(0)),
        (read(3, 67), 2, range(0)),
        (read(69, 1), 2, range(0)),
        (read(65535, 125), 2, range(0)),
        (read(3, 0), 3, range(0)),
        (read(3, 126), 3, range(0)),
        (read(3, 0xFFFF), 3, range(0)),
        (read(3, 6)[:-1], 3, range(0)),
        (read(3, 6) + b"\0", 3, range(0)),
        (b"\x03", 3, range(0)),
        *(
            (bytes((function,)) + b"\0\3\0\1", 1, range(0))
            for function in (0, 1, 2, 5, 6, 7, 8, 15, 16, 22, 23, 43, 255)
        ),
    ],
)
def test_what_a_request_gets(request_pdu: bytes, code: int, wanted: range) -> None:
    assert asked(request_pdu, START, WORDS) == (code, wanted)


def test_answers() -> None:
    image = bytes(range(132))
    assert read_answer(read(5, 2, 4), image, range(2, 4)) == bytes((4, 4, 4, 5, 6, 7))
    assert refusal(b"\x10\0", 1) == b"\x90\x01"


@given(st.binary(min_size=1, max_size=253))
def test_any_request_gets_an_answer(pdu: bytes) -> None:
    code, wanted = asked(pdu, START, WORDS)
    assert code in (0, 1, 2, 3)
    assert (code == 0) == (len(wanted) > 0)


# ---- TCP -------------------------------------------------------------------------------------------------------------


@given(
    st.lists(st.tuples(st.integers(0, 65535), st.integers(0, 255), st.binary(min_size=1, max_size=253)), max_size=5),
    st.integers(1, 60),
)
def test_frames_come_whole_in_whatever_pieces(sent: list[tuple[int, int, bytes]], size: int) -> None:
    stream = b"".join(mbap_answer(*one) for one in sent)
    assert stream == b"".join(tcp_frame(*one) for one in sent)
    frames, heard = TcpFrames(), []
    for start in range(0, len(stream), size):
        frames.feed(stream[start : start + size])
        while (frame := frames.next()) is not None:
            heard.append((frame.transaction, frame.unit, frame.pdu))
    assert heard == sent


@pytest.mark.parametrize("data", [b"GET / HTTP/1.1\r\n", b"\0\1\0\0\0\1\1", b"\0\1\0\0\0\xff\1\3", b"\xff" * 300])
def test_what_is_no_modbus(data: bytes) -> None:
    frames = TcpFrames()
    frames.feed(data)
    with pytest.raises(NotModbusError):
        frames.next()


# ---- RTU -------------------------------------------------------------------------------------------------------------

OURS, OTHER = 7, 9
REQUESTS = [
    read(3, 6),
    read(3, 66, 4),
    struct.pack(">BHH", 6, 3, 17),
    struct.pack(">BHHB", 16, 3, 2, 4) + b"\1\2\3\4",
    struct.pack(">BHHB", 15, 3, 9, 2) + b"\1\2",
    struct.pack(">BHHH", 22, 3, 1, 2),
    struct.pack(">BHHHHB", 23, 3, 6, 3, 1, 2) + b"\1\2",
    b"\x11",
]


def heard_by_us(chunks: Sequence[bytes], gap_s: float = 0.002) -> list[bytes]:
    """What is taken for a request after each chunk."""
    requests = RtuRequests(OURS)
    return [requests.feed(chunk, i * gap_s) for i, chunk in enumerate(chunks)]


def cut(data: bytes, sizes: Sequence[int]) -> list[bytes]:
    chunks = []
    for size in sizes:
        chunks.append(data[:size])
        data = data[size:]
    return [chunk for chunk in [*chunks, data] if chunk]


@pytest.mark.parametrize("pdu", REQUESTS, ids=lambda pdu: f"function {pdu[0]}")
def test_a_request_is_heard(pdu: bytes) -> None:
    frame = rtu(bytes((OURS,)) + pdu)
    assert frame == rtu_frame(OURS, pdu)
    assert heard_by_us([frame]) == [pdu]
    assert heard_by_us([frame[i : i + 1] for i in range(len(frame))]) == [b""] * (len(frame) - 1) + [pdu]


SIZES = st.lists(st.integers(1, 40), max_size=12)
NOISE = st.binary(max_size=20)


@given(pdu=st.sampled_from(REQUESTS), values=st.lists(st.integers(0, 65535), min_size=1, max_size=100), sizes=SIZES)
def test_it_is_heard_behind_what_others_say_and_that_alone_is_not(
    pdu: bytes, values: list[int], sizes: list[int]
) -> None:
    others = rtu(bytes((OTHER,)) + read(3, len(values))) + rtu(bytes((OTHER,)) + pdu_answer(3, values))
    others += rtu(bytes((0,)) + struct.pack(">BHH", 6, 3, 17)) + rtu(bytes((OTHER, 0x83, 2)))
    chunks = cut(others + rtu(bytes((OURS,)) + pdu), sizes)
    assert heard_by_us(chunks) == [b""] * (len(chunks) - 1) + [pdu]


@given(noise=NOISE, pdu=st.sampled_from(REQUESTS), sizes=SIZES)
def test_it_is_heard_behind_noise(noise: bytes, pdu: bytes, sizes: list[int]) -> None:
    assert heard_by_us(cut(noise + rtu(bytes((OURS,)) + pdu), sizes))[-1] == pdu


@pytest.mark.parametrize(
    "heard",
    [
        rtu(bytes((OTHER,)) + read(3, 6)),
        rtu(bytes((OTHER,)) + pdu_answer(3, [7, 3, 3, 6])),
        rtu(bytes((OURS,)) + read(3, 6))[:-1] + b"\0",
        rtu(bytes((OURS, 0x83, 2))),
        rtu(bytes((OURS,)) + pdu_answer(3, [1, 2, 3])),
        rtu(bytes((OURS,)) + read(3, 6)) + rtu(bytes((OTHER,)) + read(3, 6)),
        bytes((OURS,)) * 500,
        b"\0" * 500,
    ],
)
def test_what_is_no_request_to_us(heard: bytes) -> None:
    assert heard_by_us([heard])[-1] == b""


@given(st.lists(st.binary(max_size=300), max_size=5))
def test_whatever_is_heard_a_request_is_its_end(chunks: list[bytes]) -> None:
    everything = b""
    for chunk, request in zip(chunks, heard_by_us(chunks), strict=True):
        everything += chunk
        assert not request or everything.endswith(rtu(bytes((OURS,)) + request))


def test_of_two_requests_only_the_last_is_still_waited_for() -> None:
    first, last = rtu(bytes((OURS,)) + read(3, 6)), rtu(bytes((OURS,)) + read(4, 1))
    assert heard_by_us([first + last]) == [read(4, 1)]


def test_the_rest_of_a_frame_is_forgotten_after_a_silence() -> None:
    frame = rtu(bytes((OURS,)) + read(3, 6))
    assert heard_by_us([frame[:4], frame[4:]], gap_s=0.2) == [b"", b""]
    assert heard_by_us([frame[:4], frame], gap_s=0.2) == [b"", read(3, 6)]


@pytest.mark.parametrize("size", [1, 3, 8, 300])
def test_our_own_words_that_come_back_are_no_request(size: int) -> None:
    """An answer whose registers are a request to us, of all things, and an adapter that echoes."""
    request = rtu(bytes((OURS,)) + read(3, 6))
    answer = rtu_frame(OURS, bytes((3, 8)) + request)
    requests = RtuRequests(OURS)
    requests.said(answer)
    echo = answer[:-2]  # Up to where it would be taken for one.
    assert [requests.feed(chunk, 0.0) for chunk in cut(echo, [size] * 30)][-1] == b""
    assert requests.feed(answer[-2:] + request, 0.0) == read(3, 6)
    requests.said(answer)
    assert requests.feed(request, 1.0) == read(3, 6)


# ---- writes ----------------------------------------------------------------------------------------------------------

VALUES = bytes.fromhex("0131 FFA8 FFBA 0010 FFC1 009F")


def test_a_write_and_its_results() -> None:
    assert write_request(3, VALUES) == bytes.fromhex("10 0003 0006 0C") + VALUES
    assert write_result(bytes.fromhex("10 0003 0006"), 3, VALUES) == 0
    assert write_result(bytes.fromhex("90 02"), 3, VALUES) == 2
    for other in ("10 0003 0005", "10 0004 0006", "03 0003 0006", "83 02", "90", "", "90 02 00"):
        assert write_result(bytes.fromhex(other), 3, VALUES) is None


@given(before=NOISE, after=NOISE)
def test_the_result_of_a_write_on_a_serial_line(before: bytes, after: bytes) -> None:
    request = rtu_frame(OURS, write_request(3, VALUES))
    assert find_write_result(before + rtu(bytes.fromhex("07 10 0003 0006")) + after, OURS, 3, VALUES) == 0
    assert find_write_result(request + rtu(bytes.fromhex("07 90 06")) + after, OURS, 3, VALUES) == 6
    assert find_write_result(request + rtu(bytes.fromhex("09 10 0003 0006")), OURS, 3, VALUES) is None
    assert find_write_result(request + rtu(bytes.fromhex("07 10 0003 0005")), OURS, 3, VALUES) is None


@pytest.mark.parametrize("code", [1, 2, 3, 4, 5, 6, 10, 11, 99])
def test_a_refusal_says_what_to_do(code: int) -> None:
    assert f"exception {code}, " in explain_refusal(code)
    assert ":" in explain_refusal(code).partition(f"exception {code}, ")[2]
