"""Which bytes are the answer to the read that was asked, and what the others say. Pure.

A Modbus client that takes whatever comes next for its answer reads a late answer as a new one. Here a frame counts
only if it carries the slave's id, the function and, on a serial line, the number of registers and a good CRC; on TCP
the transaction number decides.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from heaved.devices.link import READ_ANSWER_BYTES
from heaved.samples import Fault

if TYPE_CHECKING:
    from collections.abc import Iterator

MOST_RTU_BYTES = 260
"""As its byte count may say: 255, and five around them."""
_MBAP_BYTES = 7
"""Transaction (2), protocol (2), length (2), unit id."""


class Request(msgspec.Struct, frozen=True):
    """The one read that is outstanding."""

    device_id: int
    function: int
    """3 or 4."""
    count: int
    """Registers."""


class Sender(msgspec.Struct, frozen=True):
    """Who sent a frame, and what tells it from that slave's others."""

    device_id: int
    count: int
    """Registers; 0: an exception."""
    number: int = 0
    """Transaction; 0 on a serial line."""


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
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
        table.append(crc)
    return tuple(table)


_CRC = _crc_table()


def crc16(data: bytes) -> int:
    """CRC of a serial frame (Modbus over serial line V1.02, 6.2.2); it stands on the line low byte first, so that the
    CRC of a whole good frame is 0.
    """
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


def explain_rtu_silence(  # Each cause has its own words.  # noqa: PLR0911
    heard: bytes, request: Request, *, sent: bytes = b"", late_s: float = 0.0
) -> Explanation:
    """What the bytes say that came instead of an answer.

    ``sent``: the request as it was sent, by which an echo is known. ``late_s``: how long after its request the slave's
    latest answer came, if that was too late; else 0.
    """
    if late_s and heard in (b"", sent):
        return _too_late(late_s)
    if not heard:
        return Explanation(Fault.TIMEOUT, "no answer: check power, wiring (A/B), device_id and baudrate")
    if heard == sent:
        return Explanation(
            Fault.TIMEOUT,
            "only the own request came back, and no answer: the adapter echoes (harmless in itself), or its wires are "
            "shorted; check power, wiring (A/B), device_id and baudrate",
        )
    heard = heard.removeprefix(sent)
    frames = list(_rtu_frames(heard))
    for frame in frames:
        if frame[:2] == bytes((request.device_id, request.function)):
            return Explanation(
                Fault.LENGTH,
                f"an answer of {frame[2] // 2} registers instead of {request.count}: "
                "it came too late (raise timeout_ms), or the device has another map",
            )
    for frame in frames:
        if frame[0] == request.device_id and frame[1] & 0x7F != request.function:
            return Explanation(
                Fault.TIMEOUT,
                f"no answer, but one to another function ({frame[1] & 0x7F}) than asked ({request.function}): "
                "check device_id (does another program use the line?) and timeout_ms",
            )
    if frames:
        others = ", ".join(sorted({str(frame[0]) for frame in frames}))
        return Explanation(Fault.TIMEOUT, f"no answer, but one from device id {others}: check device_id and timeout_ms")
    if begun := _begun(heard, request):
        whole = READ_ANSWER_BYTES + 2 * request.count
        return Explanation(Fault.TIMEOUT, f"the answer had only begun ({begun} of {whole} bytes): raise timeout_ms")
    return Explanation(
        Fault.CRC,
        f"{len(heard)} bytes that are no valid frame ({heard[:16].hex(' ')}): "
        "check baudrate, parity, wiring and termination; if they are the rest of a late answer, raise timeout_ms",
    )


def _too_late(late_s: float) -> Explanation:
    return Explanation(
        Fault.TIMEOUT, f"no answer in time: the latest came {late_s * 1e3:.0f} ms after its request: raise timeout_ms"
    )


def _begun(heard: bytes, request: Request) -> int:
    """How many bytes of the answer stand at the end of what was heard."""
    header = bytes((request.device_id, request.function, 2 * request.count))
    start = heard.rfind(header)
    if start >= 0:
        begun = len(heard) - start
        return begun if begun < READ_ANSWER_BYTES + 2 * request.count else 0
    return len(heard) if header.startswith(heard) else 0


def rtu_senders(heard: bytes) -> list[Sender]:
    """Of the whole frames in ``heard``."""
    return [Sender(frame[0], frame[2] // 2 if frame[1] < 0x80 else 0) for frame in _rtu_frames(heard)]


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
    """The answer's frame, past late answers to earlier requests; empty while it has not come. A frame whose byte count
    contradicts its length is none, see :func:`contradicts_itself`.
    """
    frame = _tcp_reply(heard, transaction, request)
    return b"" if contradicts_itself(frame) else frame


def find_tcp_contradiction(heard: bytes, transaction: int, request: Request) -> bytes:
    """The frame that stands in the answer's place with a byte count that contradicts its length; empty if none does."""
    frame = _tcp_reply(heard, transaction, request)
    return frame if contradicts_itself(frame) else b""


def contradicts_itself(frame: bytes) -> bool:
    """Whether the byte count of a read answer is not the number of bytes that follow it in its frame, or is odd."""
    return len(frame) > _MBAP_BYTES and frame[7] < 0x80 and (frame[8] != len(frame) - 9 or frame[8] % 2 != 0)


def _tcp_reply(heard: bytes, transaction: int, request: Request) -> bytes:
    """The frame with the number, unit and function of the request."""
    for frame in _tcp_frames(heard):
        same_unit = request.device_id in (0, frame[6])
        if int.from_bytes(frame[:2]) == transaction and same_unit and frame[7] & 0x7F == request.function:
            return frame
    return b""


def explain_tcp_silence(  # Each cause has its own words.  # noqa: PLR0911
    heard: bytes, transaction: int, request: Request, *, late_s: float = 0.0
) -> Explanation:
    """What the bytes say that came instead of an answer. ``late_s``: as for :func:`explain_rtu_silence`."""
    if not heard:
        if late_s:
            return _too_late(late_s)
        return Explanation(Fault.TIMEOUT, "no answer: check device_id and timeout_ms, and that the device is not busy")
    if frame := find_tcp_contradiction(heard, transaction, request):
        return Explanation(
            Fault.LENGTH,
            f"an answer whose byte count says {frame[8]} where {len(frame) - 9} follow and {2 * request.count} are "
            "wanted: the device or its gateway is faulty: restart it, renew its firmware",
        )
    frames = list(_tcp_frames(heard))
    if len(b"".join(frames)) < len(heard):
        shown = heard[:16].hex(" ")
        return Explanation(
            Fault.CRC,
            f"{len(heard)} bytes that are no whole Modbus TCP frame ({shown}): check the port, and timeout_ms if the "
            "rest comes later",
        )
    numbers = [int.from_bytes(frame[:2]) for frame in frames]
    if find_tcp_answer(heard, transaction, request):
        # It came between the end of the waiting and this look at what has been heard.
        return Explanation(Fault.TIMEOUT, "the answer came just too late: raise timeout_ms")
    if transaction in numbers:
        other = frames[numbers.index(transaction)]
        return Explanation(
            Fault.EXCEPTION,
            f"an answer with another unit id or function ({other[6]}, {other[7]}) than asked "
            f"({request.device_id}, {request.function}): check device_id",
        )
    if not all(0 < number < transaction for number in numbers):
        return Explanation(
            Fault.EXCEPTION,
            f"an answer with another transaction number ({numbers[-1]}) than the request's ({transaction}): "
            "the device or its gateway does not repeat it: renew its firmware, or use another gateway",
        )
    return Explanation(Fault.TIMEOUT, "no answer, but late ones to earlier requests: raise timeout_ms")


def tcp_stream_is_whole(heard: bytes) -> bool:
    """Whether the stream stands between two frames. If not, the rest of one would be read as a header: reconnect."""
    return sum(len(frame) for frame in _tcp_frames(heard)) == len(heard)


def tcp_senders(heard: bytes) -> list[Sender]:
    """Of the whole frames in ``heard``."""
    return [
        Sender(frame[6], frame[8] // 2 if frame[7] < 0x80 else 0, int.from_bytes(frame[:2]))
        for frame in _tcp_frames(heard)
    ]


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
