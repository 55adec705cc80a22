"""Modbus frames from both ends: what a server hears and says, what a client writes and is told. Pure.

(Modbus Application Protocol V1.1b3; Modbus Messaging on TCP/IP V1.0b; Modbus over Serial Line V1.02.) The sensors'
side, where late and foreign answers are told from due ones, is in :mod:`heaved.devices.frames`.
"""

from __future__ import annotations

import struct
from math import inf
from typing import TYPE_CHECKING, Final

import msgspec
from pymodbus.framer import FramerRTU

if TYPE_CHECKING:
    from collections.abc import Iterator

LONGEST_TCP_BYTES: Final = 260
LONGEST_RTU_BYTES: Final = 256
ILLEGAL_FUNCTION: Final = 1
ILLEGAL_ADDRESS: Final = 2
ILLEGAL_VALUE: Final = 3
NO_SUCH_DEVICE: Final = 11
"""What a gateway says for a device that is not behind it."""
REFUSALS: Final = {
    ILLEGAL_FUNCTION: "illegal_function",
    ILLEGAL_ADDRESS: "illegal_address",
    ILLEGAL_VALUE: "illegal_value",
    NO_SUCH_DEVICE: "wrong_device_id",
}
WRITES: Final = (5, 6, 15, 16, 21, 22, 23)
"""Functions that change something."""
_READS: Final = (3, 4)
_MOST_READ: Final = 125
_WRITE: Final = 16
_ASK: Final = struct.Struct(">BHH")
"""Function, first register, number of registers: of a request to read, of the answer to a write."""
_MBAP: Final = struct.Struct(">HHHB")
"""Transaction, protocol, bytes that follow, unit."""
_HEADER_BYTES: Final = 6
_FRAGMENT_S: Final = 0.05
"""After such a silence a frame begins. (By the standard 1.5 characters are enough; USB adapters hand bytes over in
lumps 16 ms apart, and the loop may be late.)"""
_SHORT: Final = (7, 11, 12, 17)
"""Functions whose request has nothing but the function."""


# ---- the server's answers --------------------------------------------------------------------------------------------


def refusal(request: bytes, code: int) -> bytes:
    """The exception that answers a request; both without id and checksum."""
    return bytes((request[0] | 0x80, code))


def asked(request: bytes, start: int, words: int) -> tuple[int, range]:
    """What a request, without id and checksum, wants of ``words`` registers from ``start`` on, which can only be read:
    0 and the numbers of the words among them, or the code of the exception that it is answered with.

    Holding and input registers are the same ones: many PLCs can read one kind alone.
    """
    if request[0] not in _READS:
        return ILLEGAL_FUNCTION, range(0)
    if len(request) != _ASK.size:
        return ILLEGAL_VALUE, range(0)
    _, first, count = _ASK.unpack(request)
    if not 1 <= count <= _MOST_READ:
        return ILLEGAL_VALUE, range(0)
    if first < start or first + count > start + words:
        return ILLEGAL_ADDRESS, range(0)
    return 0, range(first - start, first - start + count)


def read_answer(request: bytes, image: bytes, wanted: range) -> bytes:
    """The answer with these words of ``image`` (two bytes each)."""
    return bytes((request[0], 2 * len(wanted))) + image[2 * wanted.start : 2 * wanted.stop]


# ---- TCP -------------------------------------------------------------------------------------------------------------


class TcpFrame(msgspec.Struct, frozen=True, gc=False):
    """A request or an answer."""

    transaction: int
    unit: int
    pdu: bytes


class NotModbusError(ValueError):
    """What came is no Modbus TCP: where the next frame begins cannot be known."""


class TcpFrames:
    """Frames of a stream of bytes, in whatever pieces it comes."""

    def __init__(self) -> None:
        self._heard = b""

    def feed(self, data: bytes) -> None:
        """More bytes."""
        self._heard += data

    def next(self) -> TcpFrame | None:
        """The next frame, if it is whole.

        Raises:
            NotModbusError: what has come instead.
        """
        heard = self._heard
        if len(heard) < _HEADER_BYTES:
            return None
        transaction, protocol, length = struct.unpack_from(">HHH", heard)
        if protocol != 0 or not 2 <= length <= LONGEST_TCP_BYTES - _HEADER_BYTES:
            raise NotModbusError(f"no Modbus TCP: {heard[:16].hex(' ')}")
        end = _HEADER_BYTES + length
        if len(heard) < end:
            return None
        self._heard = heard[end:]
        return TcpFrame(transaction, heard[6], heard[7:end])


def tcp_frame(transaction: int, unit: int, pdu: bytes) -> bytes:
    """As it goes on the wire."""
    return _MBAP.pack(transaction, 0, 1 + len(pdu), unit) + pdu


# ---- RTU -------------------------------------------------------------------------------------------------------------


def _checksum(body: bytes) -> bytes:
    return FramerRTU.compute_CRC(body).to_bytes(2)


def rtu_frame(device_id: int, pdu: bytes) -> bytes:
    """As it goes on the wire."""
    body = bytes((device_id,)) + pdu
    return body + _checksum(body)


def _request_bytes(begun: bytes) -> int:
    """How long a request is that begins like this, id and checksum included; 0: not known, or none."""
    function = begun[1]
    if function in _SHORT:
        return 4
    if function == 22:
        return 10
    if function in (15, 16, 23):
        counted = 6 if function != 23 else 10
        return counted + 3 + begun[counted] if len(begun) > counted else 0
    return 8 if function < 0x80 else 0


class RtuRequests:
    """Requests to one slave among all that is said on a line: by the master to others, by others to the master, our own
    words where the adapter echoes them, and noise.

    Frames have no mark of their beginning, and the silences between them do not survive adapters and schedulers. But
    whoever asks us then waits for our answer: so a request to us is what has been heard *last*. Whether it is the last
    is known when a silence has followed it.
    """

    def __init__(self, device_id: int) -> None:
        self._device_id = device_id
        self._heard = b""
        self._heard_s = -inf
        self._said = b""

    def said(self, frame: bytes) -> None:
        """What we have sent ourselves: it may come back."""
        self._heard, self._said = b"", frame

    def feed(self, data: bytes, now_s: float) -> bytes:
        """More bytes, heard at ``now_s``; returns the request, without id and checksum, if they end with one to us."""
        if now_s - self._heard_s > _FRAGMENT_S:
            self._heard = b""
        self._heard_s = now_s
        heard = self._heard + data
        if self._said:
            if self._said.startswith(heard):
                self._heard = heard
                return b""
            heard, self._said = heard.removeprefix(self._said), b""
        self._heard = heard = heard[-LONGEST_RTU_BYTES:]
        for start in self._beginnings(heard):
            frame = heard[start:]
            if _request_bytes(frame) == len(frame) and _checksum(frame[:-2]) == frame[-2:]:
                return frame[1:-2]
        return b""

    def _beginnings(self, heard: bytes) -> Iterator[int]:
        start = heard.find(self._device_id)
        while 0 <= start <= len(heard) - 4:
            yield start
            start = heard.find(self._device_id, start + 1)


# ---- the client's writes ---------------------------------------------------------------------------------------------


def write_request(start: int, words: bytes) -> bytes:
    """Write these registers (two bytes each) from ``start`` on, all at once; without id and checksum."""
    return _ASK.pack(_WRITE, start, len(words) // 2) + bytes((len(words),)) + words


def write_result(answer: bytes, start: int, words: bytes) -> int | None:
    """What an answer, without id and checksum, says to that request: 0 done, else the exception's code; None: it
    answers something else.
    """
    if answer == _ASK.pack(_WRITE, start, len(words) // 2):
        return 0
    return answer[1] if len(answer) == 2 and answer[0] == _WRITE | 0x80 else None


def find_write_result(heard: bytes, device_id: int, start: int, words: bytes) -> int | None:
    """As :func:`write_result`, of what has come on a serial line, noise and an echo of the request included."""
    done = rtu_frame(device_id, _ASK.pack(_WRITE, start, len(words) // 2))
    if done in heard:
        return 0
    beginning = bytes((device_id, _WRITE | 0x80))
    at = heard.find(beginning)
    while at >= 0:
        frame = heard[at : at + 5]
        if len(frame) == 5 and _checksum(frame[:3]) == frame[3:]:
            return frame[2]
        at = heard.find(beginning, at + 1)
    return None


_REFUSED: Final = {
    1: "illegal function: the PLC does not take function 16 (write multiple registers): check its Modbus settings",
    2: "illegal data address: the PLC has no such registers there: correct [registers] start and count, or its map",
    3: "illegal data value: the PLC takes fewer registers at once: lower [registers] count",
    4: "device failure: see the PLC's diagnosis",
    5: "acknowledge: the PLC needs longer: lower [registers] rate_hz",
    6: "busy: lower [registers] rate_hz",
    10: "gateway path unavailable: check the gateway's set-up",
    11: "gateway target did not respond: check the PLC behind the gateway, and [registers] device_id",
}


def explain_refusal(code: int) -> str:
    """The exception's name and what to do about it."""
    return f"the PLC refuses the write: exception {code}, {_REFUSED.get(code, 'unknown: see its manual')}"
