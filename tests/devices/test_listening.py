"""Devices that speak by themselves, over real sockets and pseudo-terminals. Oracle: what was sent."""

import asyncio
import contextlib
import os
import pty
import socket
import time
import tty
from collections.abc import AsyncIterator, Callable, Iterable
from math import radians
from pathlib import Path

import msgspec
import pytest

from heaved.devices.listening import Listening
from heaved.devices.profile import DeviceSpec, Profile, Sentence, SentenceField
from heaved.devices.station import PollResult
from heaved.networks import Network
from heaved.samples import CraftSample, Fault

PROFILE = Profile(
    name="box",
    sentences=(
        Sentence(
            header="$--XDR",
            fields=(
                SentenceField(quantity="pitch_rad", transducer="PTCH", unit="deg"),
                SentenceField(quantity="temperature_c", transducer="AIR", unit="degC"),
            ),
        ),
    ),
)


def device(link: str, **keys: object) -> DeviceSpec:
    return msgspec.convert(
        {
            "name": "box",
            "role": "craft",
            "link": link,
            "profile": PROFILE,
            "rate_hz": 50.0,
            "stuck_after_s": 0.0,
            **keys,
        },
        DeviceSpec,
    )


def sentence(pitch_deg: float) -> bytes:
    return b"$YXXDR,A,%.2f,D,PTCH,C,21.5,C,AIR\r\n" % pitch_deg


class Heard:
    def __init__(self) -> None:
        self.results: list[PollResult] = []
        self._more = asyncio.Event()

    def __call__(self, result: PollResult) -> None:
        self.results.append(result)
        self._more.set()

    async def until(self, is_it: Callable[[PollResult], bool]) -> PollResult:
        """The first result, from those that are here already on, that is it."""
        seen = 0
        async with asyncio.timeout(20.0):
            while True:
                for result in self.results[seen:]:
                    seen += 1
                    if is_it(result):
                        return result
                self._more.clear()
                await self._more.wait()

    def forget(self) -> None:
        self.results.clear()


def is_good(result: PollResult) -> bool:
    return result.fault is Fault.NONE


def is_fault(fault: Fault, words: str = "") -> Callable[[PollResult], bool]:
    return lambda result: result.fault is fault and words in result.detail


@contextlib.asynccontextmanager
async def listening(spec: DeviceSpec) -> AsyncIterator[Heard]:
    heard = Heard()
    task = asyncio.create_task(Listening([spec], heard).run())
    try:
        yield heard
        assert not task.done(), task.exception()
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


def free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


async def test_datagrams_give_samples_with_their_times() -> None:
    port = free_udp_port()
    async with listening(device(f"udp-listen://127.0.0.1:{port}", latency_ms=-20.0)) as heard:
        await heard.until(is_fault(Fault.TIMEOUT, "no $--XDR for"))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as box:
            sent_s = time.monotonic()
            box.sendto(sentence(3.0), ("127.0.0.1", port))
            result = await heard.until(is_good)
    assert isinstance(result.sample, CraftSample)
    assert result.sample.pitch_rad == pytest.approx(radians(3.0))
    assert result.extra == {"temperature_c": 21.5}
    assert sent_s - 0.02 <= result.sample.t_s <= time.monotonic() - 0.02
    assert not result.reconnected


async def test_silence_is_a_fault_that_says_what_is_heard_instead() -> None:
    port = free_udp_port()
    async with listening(device(f"udp-listen://127.0.0.1:{port}")) as heard:
        await heard.until(is_fault(Fault.TIMEOUT))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as box:
            box.sendto(b"$GPHDT,123.4,T*2B\r\n", ("127.0.0.1", port))
            result = await heard.until(is_fault(Fault.TIMEOUT, "but $GPHDT"))
            assert "correct the profile's header" in result.detail
            box.sendto(b"$YXXDR,A,1.0,D,PTCH*00\r\n", ("127.0.0.1", port))
            await heard.until(is_fault(Fault.CRC))
            box.sendto(sentence(1.0), ("127.0.0.1", port))
            await heard.until(is_good)


async def test_a_port_in_use_is_named_and_taken_once_it_is_free() -> None:
    holder = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    holder.bind(("127.0.0.1", 0))
    port = holder.getsockname()[1]
    async with listening(device(f"udp-listen://127.0.0.1:{port}")) as heard:
        result = await heard.until(is_fault(Fault.DISCONNECTED, "in use"))
        assert f"port {port} is in use: stop the other program" in result.detail
        holder.close()
        await heard.until(is_fault(Fault.TIMEOUT))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as box:
            box.sendto(sentence(1.0), ("127.0.0.1", port))
            await heard.until(is_good)


async def test_strangers_are_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, tuple[str, ...]]] = []

    def nobody(address: str, networks: Iterable[Network]) -> bool:
        asked.append((address, tuple(map(str, networks))))
        return False

    monkeypatch.setattr("heaved.devices.listening.is_allowed", nobody)
    port = free_udp_port()
    async with listening(device(f"udp-listen://127.0.0.1:{port}", allow=("10.1.2.0/24",))) as heard:
        await heard.until(is_fault(Fault.TIMEOUT))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as box:
            box.sendto(sentence(1.0), ("127.0.0.1", port))
            await heard.until(is_fault(Fault.TIMEOUT, "sentences from 127.0.0.1 are not taken: name its network"))
        assert not any(map(is_good, heard.results))
    assert asked == [("127.0.0.1", ("10.1.2.0/24",))]


class Line:
    """A serial line: a pseudo-terminal under a name that stays, whatever is plugged in behind it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.plug()

    def plug(self) -> None:
        self.master, slave = pty.openpty()
        tty.setraw(self.master)
        tty.setraw(slave)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(slave))
        os.close(slave)

    def unplug(self) -> None:
        self.path.unlink()
        os.close(self.master)

    def write(self, data: bytes) -> None:
        os.write(self.master, data)


async def test_a_serial_line_that_goes_and_comes_back(tmp_path: Path) -> None:
    line = Line(tmp_path / "tty")
    async with listening(device(f"serial://{line.path}?baudrate=9600")) as heard:
        await heard.until(is_fault(Fault.TIMEOUT))
        data = sentence(2.0)
        line.write(data[:9])
        line.write(data[9:])
        assert (await heard.until(is_good)).sample == heard.results[-1].sample
        line.write(sentence(3.0)[:12])  # Half of it, and the plug is out.
        line.unplug()
        result = await heard.until(is_fault(Fault.DISCONNECTED, "is not there"))
        assert "plug the adapter in" in result.detail
        heard.forget()
        line.plug()
        await heard.until(is_fault(Fault.TIMEOUT))
        line.write(sentence(4.0))
        result = await heard.until(is_good)
        assert result.reconnected
        assert isinstance(result.sample, CraftSample)
        assert result.sample.pitch_rad == pytest.approx(radians(4.0))
    line.unplug()


async def test_a_box_on_the_network_that_closes_and_comes_back() -> None:
    arrived: asyncio.Queue[asyncio.StreamWriter] = asyncio.Queue()

    async def serve(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await arrived.put(writer)

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    async with listening(device(f"tcp://127.0.0.1:{port}")) as heard:
        writer = await arrived.get()
        writer.write(sentence(2.0))
        await heard.until(is_good)
        heard.forget()
        server.close()
        writer.close()
        result = await heard.until(is_fault(Fault.DISCONNECTED, "connection refused"))
        assert f"serves its serial line on port {port}" in result.detail
        server = await asyncio.start_server(serve, "127.0.0.1", port)
        writer = await arrived.get()
        writer.write(sentence(5.0))
        assert (await heard.until(is_good)).reconnected
        writer.close()
    server.close()


async def test_a_name_that_does_not_resolve_is_said() -> None:
    async with listening(device("tcp://no-such-box.invalid:4001")) as heard:
        result = await heard.until(is_fault(Fault.DISCONNECTED, "no-such-box.invalid"))
        assert "host name" in result.detail


async def test_a_flood_is_taken_in_pieces() -> None:
    port = free_udp_port()
    async with listening(device(f"udp-listen://127.0.0.1:{port}")) as heard:
        await heard.until(is_fault(Fault.TIMEOUT))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as box:
            for _ in range(500):
                box.sendto(os.urandom(900), ("127.0.0.1", port))
            box.sendto(sentence(1.0), ("127.0.0.1", port))
            for _ in range(50):  # The kernel may have thrown the first one away.
                if any(map(is_good, heard.results)):
                    break
                box.sendto(sentence(1.0), ("127.0.0.1", port))
                await asyncio.sleep(0.01)
        await heard.until(is_good)


def test_one_device_has_the_line_alone() -> None:
    spec = device("udp-listen://127.0.0.1:5601")
    with pytest.raises(ValueError, match="too many values"):
        Listening([spec, spec], lambda _result: None)
