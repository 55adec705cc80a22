"""Which bytes are the answer to the read that was asked, and what the others say. Pure.

A Modbus client that takes whatever comes next for its answer reads a late answer as a new one. Here a frame counts
only if it carries the slave's id, the function and, on a serial line, the number of registers and a good CRC; on TCP
the transaction number decides.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from heaved.samples import Fault

_MBAP_BYTES = 7
"""Transaction (2), protocol (2), length (2), unit id."""


class Request(msgspec.Struct, frozen=True):
    """The one read that is outstanding."""

    device_id: int
    function: int
    """3 or 4."""
    count: int
    """Registers."""


_EXCEPTIONS = {
    1: "illegal function: the profile's function (holding or input) does not fit the device",
    2: "illegal data address: the profile's registers do not fit the device",
    3: "illegal data value: the profile's block is too long for the device",
    4: "device failure: see the device's manual",
    5: "acknowledge: the device needs longer",
    6: "device busy: lower rate_hz",
    10: "gateway path unavailable: check the gateway's set-up",
    11: "gateway target did not respond: check the device behind the gateway, and device_id",
}


def explain_exception(code: int) -> str:
    """The exception's name and what to do about it."""
    return f"exception {code}, {_EXCEPTIONS.get(code, 'unknown')}"


class Explanation(msgspec.Struct, frozen=True):
    """Why there was no answer."""

    fault: Fault
    detail: str


def _crc_table() -> tuple[int, ...]:
    table = []
    for crc in range(256):
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
        table.append(crc)
    return tuple(table)


_CRC = _crc_table()


def crc16(data: bytes) -> int:
    """CRC of a serial frame (Modbus over serial line V1.02, 6.2.2); it stands on the line low byte first, so that the
    CRC of a whole good frame is 0."""
    crc = 0xFFFF
    for byte in data:
        crc = (crc >> 8) ^ _CRC[(crc ^ byte) & 0xFF]
    return crc


# ---- serial line -----------------------------------------------------------------------------------------------------


def find_rtu_answer(heard: bytes, request: Request) -> bytes:
    """The answer's frame, wherever it stands between noise and late answers; empty while it has not come."""
    header = bytes((request.device_id, request.function, 2 * request.count))
    refusal = bytes((request.device_id, request.function | 0x80))
    for frame in _rtu_frames(heard):
        if frame.startswith((header, refusal)):
            return frame
    return b""


def explain_rtu_silence(heard: bytes, request: Request) -> Explanation:
    """What the bytes say that came instead of an answer."""
    if not heard:
        return Explanation(Fault.TIMEOUT, "no answer: check power, wiring (A/B), device_id and baudrate")
    frames = list(_rtu_frames(heard))
    for frame in frames:
        if frame[:2] == bytes((request.device_id, request.function)):
            return Explanation(
                Fault.LENGTH,
                f"an answer of {frame[2] // 2} registers instead of {request.count}: "
                "it came too late (raise timeout_ms), or the device has another map",
            )
    if frames:
        others = ", ".join(sorted({str(frame[0]) for frame in frames}))
        return Explanation(Fault.TIMEOUT, f"no answer, but one from device id {others}: check device_id and timeout_ms")
    return Explanation(
        Fault.CRC,
        f"{len(heard)} bytes that are no valid frame ({heard[:16].hex(' ')}): "
        "check baudrate, parity, wiring and termination",
    )


def _rtu_frames(heard: bytes) -> Iterator[bytes]:
    """Frames of read answers and exceptions with a good CRC, none overlapping."""
    start = 0
    while start + 5 <= len(heard):
        function = heard[start + 1]
        if function in (3, 4):
            end = start + 5 + heard[start + 2]
        elif function in (0x83, 0x84):
            end = start + 5
        else:
            start += 1
            continue
        if end <= len(heard) and crc16(heard[start:end]) == 0:
            yield heard[start:end]
            start = end
        else:
            start += 1


# ---- TCP -------------------------------------------------------------------------------------------------------------


def find_tcp_answer(heard: bytes, transaction: int, request: Request) -> bytes:
    """The answer's frame, past late answers to earlier requests; empty while it has not come."""
    for frame in _tcp_frames(heard):
        same_unit = request.device_id in (0, frame[6])
        if int.from_bytes(frame[:2]) == transaction and same_unit and frame[7] & 0x7F == request.function:
            return frame
    return b""


def explain_tcp_silence(heard: bytes, transaction: int, request: Request) -> Explanation:
    """What the bytes say that came instead of an answer."""
    if not heard:
        return Explanation(Fault.TIMEOUT, "no answer: check device_id and timeout_ms, and that the device is not busy")
    frames = list(_tcp_frames(heard))
    if len(b"".join(frames)) < len(heard):
        shown = heard[:16].hex(" ")
        return Explanation(
            Fault.CRC, f"{len(heard)} bytes that are no whole Modbus TCP frame ({shown}): check the port"
        )
    if any(int.from_bytes(frame[:2]) == transaction for frame in frames):
        return Explanation(
            Fault.EXCEPTION,
            f"an answer with another unit id or function ({frames[-1][6]}, {frames[-1][7]}) than asked "
            f"({request.device_id}, {request.function}): check device_id",
        )
    return Explanation(Fault.TIMEOUT, "no answer, but late ones to earlier requests: raise timeout_ms")


def tcp_stream_is_whole(heard: bytes) -> bool:
    """Whether the stream stands between two frames. If not, the rest of one would be read as a header: reconnect."""
    return sum(len(frame) for frame in _tcp_frames(heard)) == len(heard)


def _tcp_frames(heard: bytes) -> Iterator[bytes]:
    """Whole frames from the start; ends at the first that is not one (yet)."""
    start = 0
    while start + _MBAP_BYTES < len(heard):
        protocol = int.from_bytes(heard[start + 2 : start + 4])
        length = int.from_bytes(heard[start + 4 : start + 6])
        end = start + 6 + length
        if protocol != 0 or not 3 <= length <= 254 or end > len(heard):
            return
        yield heard[start:end]
        start = end
