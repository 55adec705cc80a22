"""Slaves that mean harm: what they send without end costs no memory, no poll its end, and no other bus anything."""

from __future__ import annotations

import asyncio
import contextlib
import os
from typing import TYPE_CHECKING, Final

import pytest
from modbus_slaves import (
    Results,
    RtuSlave,
    TcpSlave,
    count_of,
    device,
    mbap_answer,
    pdu_answer,
    rtu_answer,
    running,
    tcp_answer,
)

from heaved.devices import frames
from heaved.devices.bus import Bus, OpenLink, PollResult
from heaved.devices.frames import Request
from heaved.links import SerialLink
from heaved.samples import Fault

if TYPE_CHECKING:
    from collections.abc import Callable

MOST_KEPT_BYTES: Final = 16384
GOOD: Final = [7, 8, 9]


def is_well(result: PollResult) -> bool:
    return result.fault is Fault.NONE


class Watched(Results):
    """Keeps how many bytes the bus has kept at the most, as seen at each result."""

    def __init__(self) -> None:
        super().__init__()
        self.bus: Bus | None = None
        self.most_kept = 0

    def __call__(self, result: PollResult) -> None:
        connection = self.bus._connection if self.bus is not None else None
        if connection is not None:
            self.most_kept = max(self.most_kept, len(connection._heard) + len(connection._spare))
        super().__call__(result)


async def endlessly(say: Callable[[bytes], None], piece: bytes, pause_s: float) -> None:
    """For ever, and as fast as the loop turns without a pause; in pieces of a byte with one."""
    while True:
        for part in [piece] if not pause_s else [bytes([byte]) for byte in piece]:
            with contextlib.suppress(BlockingIOError):
                say(part)
            await asyncio.sleep(pause_s)


async def outlived(
    link: str, say: Callable[[bytes], None], piece: bytes, pause_s: float, mend: Callable[[], None]
) -> None:
    """Polls end while this is sent, a neighbour is read as if nothing were, and when it is over the slave is, too."""
    neighbour = TcpSlave(lambda request: tcp_answer(request, GOOD))
    await neighbour.start()
    sending = asyncio.create_task(endlessly(say, piece, pause_s))
    results, others = Watched(), Results()
    hostile = device(link, timeout_ms=30.0, rate_hz=20.0)
    async with (
        running([hostile], results) as results.bus,
        running([device(f"tcp://127.0.0.1:{neighbour.port}", rate_hz=50.0)], others),
    ):
        await results.number(8)
        await others.number(20)
        heard = list(results.all)
        sending.cancel()
        mend()
        await results.until(is_well, since=len(heard))
    await neighbour.stop()
    assert not any(map(is_well, heard))
    assert all(result.detail.isprintable() and len(result.detail) < 400 for result in heard)
    assert results.most_kept <= MOST_KEPT_BYTES
    assert all(map(is_well, others.all))


TCP = {
    "bytes without end": (bytes(range(256)) * 256, 0.0),
    "answers to others without end": (mbap_answer(0xFFF0, 80, pdu_answer(3, GOOD)) * 5000, 0.0),
    "the smallest answers without end": (mbap_answer(0xFFF0, 80, b"\x83\x06") * 5000, 0.0),
    "a head that announces 65535 bytes": (b"\x00\x01\x00\x00\xff\xff\x50\x03\x06" + bytes(60_000), 0.0),
    "a byte at a time": (mbap_answer(1, 80, pdu_answer(3, GOOD)), 0.01),
}


@pytest.mark.parametrize("name", TCP)
async def test_on_tcp(name: str) -> None:
    piece, pause_s = TCP[name]
    is_mended = False
    slave = TcpSlave(lambda request: tcp_answer(request, GOOD) if is_mended else b"")
    await slave.start()

    def mend() -> None:
        nonlocal is_mended
        is_mended = True

    await outlived(f"tcp://127.0.0.1:{slave.port}", slave.say_to_all, piece, pause_s, mend)
    await slave.stop()


RTU = {
    "bytes without end": (bytes(range(256)) * 8, 0.0),
    "what looks like the head of an answer at every byte": (b"\x03\xff" * 1024, 0.0),
    "answers of others without end": (rtu_answer(b"\x07\x03", GOOD) * 100, 0.0),
    "a byte at a time": (rtu_answer(b"\x50\x03", GOOD)[:-1], 0.01),
}


@pytest.mark.parametrize("name", RTU)
async def test_on_a_serial_line(name: str) -> None:
    piece, pause_s = RTU[name]
    is_mended = False
    slave = RtuSlave(lambda request: rtu_answer(request, GOOD[: count_of(request)]) if is_mended else b"")
    os.set_blocking(slave._master, False)

    def mend() -> None:
        nonlocal is_mended
        is_mended = True

    await outlived(f"rtu://{slave.path}?baudrate=115200", slave.say, piece, pause_s, mend)
    slave.close()


def test_the_work_for_a_babble_does_not_grow_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """However long the time-out: each piece is worth as much as the one before."""
    checked = 0
    crc16 = frames.crc16

    def counted(data: bytes) -> int:
        nonlocal checked
        checked += len(data)
        return crc16(data)

    monkeypatch.setattr(frames, "crc16", counted)
    link = OpenLink(SerialLink("/dev/null"), None, lambda: 0.0, lambda: None)  # type: ignore[arg-type]
    link._request = Request(80, 3, 3)
    costs = []
    for _ in range(300):
        checked = 0
        link._on_bytes(b"\x03\xff" * 32)
        costs.append(checked)
    assert costs[20] == costs[-1] > 0
    checked = 0
    frames.explain_rtu_silence(link._heard, link._request)
    assert 0 < checked < 600_000


@pytest.mark.parametrize("before", [0, 1, 200, 900, 1024, 5000])
@pytest.mark.parametrize("size", [1, 7, 64, 4096])
def test_an_answer_is_found_behind_any_noise_in_any_pieces(before: int, size: int) -> None:
    answer = rtu_answer(b"\x50\x03", GOOD)
    link = OpenLink(SerialLink("/dev/null"), None, lambda: 0.0, lambda: None)  # type: ignore[arg-type]
    link._request = Request(80, 3, 3)
    said = b"\xff" * before + answer
    for start in range(0, len(said), size):
        link._on_bytes(said[start : start + size])
    assert link._found == answer
