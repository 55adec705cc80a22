"""Serial lines: whole telegrams, the newest of those that wait, unplugged and back."""

from __future__ import annotations

import asyncio
import os
import termios
from contextlib import suppress
from typing import TYPE_CHECKING

import pytest
from output_peers import LINE, SerialPort, kept, make_health, until
from stream_peers import Clock
from structlog.testing import capture_logs

from heaved.links import SerialLink, character_s
from heaved.outputs.senders.sender import STUCK_S
from heaved.outputs.senders.serial_line import SerialSender

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

FAST = 4_000_000


@pytest.fixture
def port(tmp_path: Path) -> Iterator[SerialPort]:
    found = SerialPort(tmp_path / "ttyUSB0")
    yield found
    found.unplug()


async def heard(port: SerialPort, size: int) -> bytes:
    found = bytearray()

    def enough() -> bool:
        found.extend(port.heard())
        return len(found) >= size

    await until(enough)
    return bytes(found)


async def test_telegrams_leave_with_the_settings_of_the_link(port: SerialPort) -> None:
    health = make_health()
    sender = SerialSender(SerialLink(str(port.path), 38400, "E", 2), health)
    async with kept(sender):
        await until(lambda: sender.has_reader)
        sender.send(b"$PRDID,-0.50,+1.20,123.45*7E\r\n")
        assert await heard(port, 30) == b"$PRDID,-0.50,+1.20,123.45*7E\r\n"
        _, output, control, local, _, speed, _ = termios.tcgetattr(port._near)
        assert speed == termios.B38400
        assert control & termios.CSTOPB  # A pseudo-terminal knows of no parity.
        assert not output & termios.OPOST  # No byte is changed on its way,
        assert not local & termios.ECHO  # and none comes back.
        sender.send(bytes(range(256)))
        assert await heard(port, 256) == bytes(range(256))
    assert (health.is_up, health.sent, health.connections, dict(health.lost)) == (True, 2, 1, {})


async def test_a_slow_line_takes_the_first_and_the_newest(port: SerialPort) -> None:
    """A telegram of 100 bytes takes 104 ms at 9600 baud; what came meanwhile is old when the line is free."""
    health, clock = make_health(), Clock()
    sender = SerialSender(SerialLink(str(port.path), 9600), health, clock)
    async with kept(sender):
        await until(lambda: sender.has_reader)
        for i in range(10):
            sender.send(LINE % i)
        assert await heard(port, 100) == LINE % 0
        assert (health.sent, dict(health.lost)) == (1, {"slow": 8})
        clock.now_s += 0.11
        await until(lambda: health.sent == 2)
        assert await heard(port, 100) == LINE % 9


@pytest.mark.parametrize(("rate_hz", "share"), [(9.0, 1.0), (9.6, 1.0), (19.2, 0.5), (96.0, 0.1)])
async def test_a_line_is_never_given_more_than_it_carries(port: SerialPort, rate_hz: float, share: float) -> None:
    """9600 baud are 960 bytes a second; what the system would take beyond that would only come later and later."""
    health, clock = make_health(), Clock()
    link = SerialLink(str(port.path), 9600)
    sender = SerialSender(link, health, clock)
    async with kept(sender):
        await until(lambda: sender.has_reader)
        count = 0
        for millisecond in range(20_000):
            clock.now_s = 1e-3 * millisecond
            if sender._timer is not None:  # It runs on the clock of the event loop.
                sender._timer.cancel()
                sender._go_on()
            if clock.now_s >= count / rate_hz:
                sender.send(LINE % count)
                count += 1
            port.heard()
            assert (health.sent - 1) * 100 * character_s(link) <= clock.now_s + 0.002 + 1e-9
    assert health.sent / count == pytest.approx(share, rel=0.01)
    assert count - health.sent - health.lost["slow"] in (0, 1)


async def test_partial_writes_are_finished_and_telegrams_never_halved(port: SerialPort) -> None:
    """Its far end reads only now and then, so the line takes what it has room for."""
    health, clock = make_health(), Clock()
    sender = SerialSender(SerialLink(str(port.path), FAST), health, clock)
    async with kept(sender):
        await until(lambda: sender.has_reader)
        found = b""
        for i in range(3000):
            clock.now_s += 0.001
            sender.send(LINE % i)
            if i % 500 == 499:
                await asyncio.sleep(0)
                found += port.heard()
                await asyncio.sleep(0)
        found += port.heard()

        def all_of_it() -> bool:
            nonlocal found
            found += port.heard()
            return found.endswith(LINE % 2999)

        await until(all_of_it)
    lines = [found[i : i + 100] for i in range(0, len(found), 100)]
    numbers = [int(line[:6]) for line in lines]
    assert lines == [LINE % number for number in numbers]
    assert numbers == sorted(set(numbers))
    assert health.lost["slow"] > 500
    assert len(numbers) + health.lost["slow"] == 3000
    assert health.sent == len(numbers)


async def test_unplugged_and_back_as_another_device(port: SerialPort) -> None:
    health = make_health()
    sender = SerialSender(SerialLink(str(port.path), FAST), health)
    with capture_logs() as logs:
        async with kept(sender):
            await until(lambda: sender.has_reader)
            port.let_go()
            sender.send(b"before")
            assert await heard(port, 6) == b"before"
            before = port.path.readlink()
            port.unplug()
            port.path.unlink()
            await until(lambda: not health.is_up)
            assert "ttyUSB0 has gone" in health.detail
            assert not sender.has_reader
            await until(lambda: "is not there: plug the adapter in" in health.detail)
            sender.send(b"meanwhile")
            other = os.openpty()  # So that it comes back under another name.
            port.plug_in()
            assert port.path.readlink() != before
            await until(lambda: sender.has_reader)
            sender.send(b"after")
            assert await heard(port, 5) == b"after"
            for descriptor in other:
                os.close(descriptor)
    assert (health.connections, health.sent, dict(health.lost)) == (2, 2, {"down": 1})
    assert [line["event"] for line in logs] == ["output up", "output down", "output down", "output up"]


async def test_a_write_that_finds_it_gone(port: SerialPort) -> None:
    health = make_health()
    sender = SerialSender(SerialLink(str(port.path), FAST), health)
    async with kept(sender):
        await until(lambda: sender.has_reader)
        port.unplug()
        for _ in range(3):
            sender.send(b"into the void")  # Before the event loop has told that it has gone.
        await until(lambda: not sender.has_reader)
        assert "has gone" in health.detail


async def test_a_port_that_is_not_there_is_said_once() -> None:
    health = make_health()
    with capture_logs() as logs:
        async with kept(SerialSender(SerialLink("/dev/ttyNowhere"), health)):
            await until(lambda: not health.is_up and health.detail != "not connected yet")
            assert health.detail == "/dev/ttyNowhere is not there: plug the adapter in, or correct the link"
    assert len(logs) == 1


async def test_no_two_on_one_port(port: SerialPort) -> None:
    first, second = make_health("first"), make_health("second")
    link = SerialLink(str(port.path), FAST)
    one, other = SerialSender(link, first), SerialSender(link, second)
    async with kept(one):
        await until(lambda: one.has_reader)
        async with kept(other):
            await until(lambda: "in use by another program" in second.detail)
    async with kept(other):  # It was given back.
        await until(lambda: other.has_reader)


async def test_a_line_that_takes_nothing_is_said_once_and_goes_on_when_it_does(port: SerialPort) -> None:
    health, clock = make_health(), Clock()
    sender = SerialSender(SerialLink(str(port.path), FAST), health, clock)
    with capture_logs() as logs:
        async with kept(sender):
            await until(lambda: sender.has_reader)
            while not health.lost["slow"]:
                clock.now_s += 0.001
                sender.send(LINE % 1)
            assert health.is_up
            for _ in range(100):
                clock.now_s += 0.011 * STUCK_S
                sender.send(LINE % 2)
            assert "has taken nothing for 10 s" in health.detail
            await until(lambda: port.heard() and health.is_up)
    assert [line["event"] for line in logs] == ["output up", "output down", "output up"]


async def test_what_comes_in_is_thrown_away(port: SerialPort) -> None:
    sender = SerialSender(SerialLink(str(port.path), FAST), make_health())
    async with kept(sender):
        await until(lambda: sender.has_reader)
        written = 0
        while written < 50_000:
            with suppress(BlockingIOError):
                written += os.write(port.far, b"\x00garbage\r\n" * 50)
            await asyncio.sleep(0)
        sender.send(b"well")
        assert await heard(port, 4) == b"well"


async def test_at_the_end_nothing_is_waited_for(port: SerialPort) -> None:
    """What the line has not taken yet is thrown away: closing would wait for it."""
    sender = SerialSender(SerialLink(str(port.path), 300), make_health())
    async with kept(sender):
        await until(lambda: sender.has_reader)
        for i in range(100):
            sender.send(LINE % i)
    assert not sender.has_reader
