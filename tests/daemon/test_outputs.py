"""The outputs of a running daemon: many at once, one of them stuck; changed while it runs; one with a bug."""

from __future__ import annotations

import asyncio
import socket
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from output_peers import SerialPort, free_port, nobody_asks
from output_peers import until as until_so
from running import PATIENCE_S, demo_config, get, metric, plant_of, running
from stream_peers import Clock, make_frame
from structlog.testing import capture_logs

from heaved.config import Config
from heaved.daemon.outputs import Outputs
from heaved.outputs.telegrams.spec import OutputSpec, Telegram

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

TSS1_BYTES = 27
"""``:XXAAAA MHHHHQMRRRR MPPPP\\r\\n``"""
STOP_S = 1.0


class Places:
    """Where telegrams can be sent to, each with what it has heard."""

    def __init__(self) -> None:
        self._open = ExitStack()
        self.heard: dict[str, bytes] = {}
        self._accepts: list[tuple[str, socket.socket]] = []
        self._sources: dict[str, socket.socket | SerialPort] = {}

    def udp(self) -> str:
        place = self._open.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        place.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        place.bind(("127.0.0.1", 0))
        return self._had(f"udp://127.0.0.1:{place.getsockname()[1]}", place)

    def serial(self, path: Path) -> str:
        port = SerialPort(path)
        self._open.callback(port.unplug)
        return self._had(f"serial://{path}?baudrate=115200", port)

    def listening(self) -> str:
        place = self._open.enter_context(socket.socket())
        place.bind(("127.0.0.1", 0))
        place.listen(4)
        place.setblocking(False)
        link = f"tcp://127.0.0.1:{place.getsockname()[1]}"
        self._accepts.append((link, place))
        self.heard[link] = b""
        return link

    def connect(self, link: str) -> None:
        """Become a reader of a ``tcp-listen`` link of the daemon's."""
        host, port = link.removeprefix("tcp-listen://").split(":")
        reader = self._open.enter_context(socket.create_connection((host, int(port))))
        self._had(link, reader)

    def _had(self, link: str, source: socket.socket | SerialPort) -> str:
        if isinstance(source, socket.socket):
            source.setblocking(False)
        self._sources[link] = source
        self.heard.setdefault(link, b"")
        return link

    def hear(self) -> dict[str, bytes]:
        """Take whatever has come by now; all that has come."""
        for link, place in self._accepts:
            with suppress(BlockingIOError):
                self._had(link, self._open.enter_context(place.accept()[0]))
        for link, source in self._sources.items():
            if isinstance(source, SerialPort):
                self.heard[link] += source.heard()
                continue
            with suppress(BlockingIOError):
                while data := source.recv(65536):
                    self.heard[link] += data
        return self.heard

    def close(self) -> None:
        self._open.close()


@pytest.fixture
def places() -> Iterator[Places]:
    found = Places()
    yield found
    found.close()


def telegrams(name: str, link: str, **changes: Any) -> OutputSpec:
    spec = OutputSpec(name=name, telegram=Telegram.TSS1, link=link, rate_hz=20.0)
    return msgspec.structs.replace(spec, **changes)


async def test_twenty_at_once_of_which_one_is_a_black_hole(tmp_path: Path, places: Places) -> None:
    """The others get every telegram, and frames keep coming."""
    with socket.socket() as hole:  # Its queue of connections is full: it does not answer.
        hole.bind(("127.0.0.1", 0))
        hole.listen(0)
        fillers = [socket.socket() for _ in range(4)]
        for filler in fillers:
            filler.setblocking(False)
            filler.connect_ex(hole.getsockname())
        listened = [f"tcp-listen://127.0.0.1:{free_port()}" for _ in range(5)]
        links = [*listened, *(places.udp() for _ in range(5)), *(places.listening() for _ in range(5))]
        links += [places.serial(tmp_path / f"tty{i}") for i in range(4)]
        black = f"tcp://127.0.0.1:{hole.getsockname()[1]}"
        outputs = tuple(telegrams(f"output{i}", link) for i, link in enumerate([*links, black]))
        assert len(outputs) == 20
        config = demo_config(tmp_path, output=outputs)
        async with plant_of(config) as (_, config), running(config) as daemon:
            await until_so(lambda: metric(daemon, "heaved_output_up") >= 14)
            for link in listened:
                places.connect(link)

            def enough() -> bool:
                return all(len(places.hear()[link]) >= 60 * TSS1_BYTES for link in links)

            await until_so(enough)
            health = daemon._outputs.health

            def all_of_it() -> bool:
                return all(
                    len(places.hear()[link]) == one.sent * TSS1_BYTES for link, one in zip(links, health, strict=False)
                )

            await until_so(all_of_it)
            status = daemon.status()
            first = daemon.acquisition.frames
            await until_so(lambda: daemon.acquisition.frames > first + 20)
            metrics = (await get(daemon, "/metrics"))[1]
        for filler in fillers:
            filler.close()
    for link, one in zip(links, health, strict=False):
        lines = [places.heard[link][i : i + TSS1_BYTES] for i in range(0, 60 * TSS1_BYTES, TSS1_BYTES)]
        assert all(line.startswith(b":") and line.endswith(b"\r\n") for line in lines), link
        assert not one.lost["slow"], link
        assert f'heaved_output_up{{output="{one.name}"}} 1.0' in metrics
    assert (health[-1].is_up, health[-1].sent) == (False, 0)
    assert "nobody answers" in health[-1].detail
    assert 'heaved_output_up{output="output19"} 0.0' in metrics
    assert [output.name for output in status.outputs] == [output.name for output in outputs]


async def test_a_reload_makes_what_has_changed_anew_and_leaves_the_others(tmp_path: Path, places: Places) -> None:
    one, other, third = places.udp(), places.udp(), places.udp()
    path = tmp_path / "heaved.toml"

    def write(*tables: tuple[str, str, float]) -> None:
        head = f'[stream]\nport = 0\n[http]\nport = 0\n[state]\ndirectory = "{tmp_path}/state"\n'
        lines = [
            f'[[output]]\nname = "{name}"\ntelegram = "tss1"\nlink = "{link}"\nrate_hz = {rate_hz}\n'
            for name, link, rate_hz in tables
        ]
        path.write_text(head + "\n".join(lines))

    write(("a", one, 10.0), ("b", other, 10.0))
    config = demo_config(tmp_path, output=(telegrams("a", one, rate_hz=10.0), telegrams("b", other, rate_hz=10.0)))
    async with plant_of(config) as (_, config), running(config, path) as daemon:
        await until_so(lambda: metric(daemon, "heaved_output_up") == 2)
        before = {health.name: health for health in daemon._outputs.health}
        write(("c", third, 5.0), ("b", other, 5.0), ("a", one, 10.0))
        await daemon.reload()
        after = {health.name: health for health in daemon._outputs.health}
        assert list(after) == ["c", "b", "a"]  # As the file has them.
        assert after["a"] is before["a"]
        assert after["b"] is not before["b"]
        await until_so(lambda: metric(daemon, "heaved_output_up") == 3)
        assert after["a"].connections == 1
        places.heard[one] = places.heard[third] = b""
        sent = after["a"].sent
        await until_so(lambda: after["a"].sent > sent + 5)
        write()
        await daemon.reload()
        assert daemon._outputs.health == []
        assert not [task for task in asyncio.all_tasks() if task.get_name().startswith("output ")]


async def test_a_port_that_is_listened_at_is_free_for_its_successor(tmp_path: Path, places: Places) -> None:
    link = f"tcp-listen://127.0.0.1:{free_port()}"
    outputs = Outputs(lambda t_s: t_s, Clock(), nobody_asks)
    await outputs.have(Config(output=(telegrams("a", link),)), STOP_S)
    await until_so(lambda: outputs.health[0].is_up)
    places.connect(link)
    await outputs.have(Config(output=(telegrams("b", link),)), STOP_S)
    with capture_logs() as logs:
        await until_so(lambda: outputs.health[0].is_up)
    assert [line["event"] for line in logs] == ["output up"]
    assert await outputs.stop(STOP_S)


async def test_a_bug_in_one_is_counted_said_once_and_costs_the_others_nothing(
    monkeypatch: pytest.MonkeyPatch, places: Places
) -> None:
    links = places.udp(), places.udp()
    clock = Clock()
    outputs = Outputs(lambda t_s: t_s, clock, nobody_asks)
    await outputs.have(Config(output=tuple(telegrams(f"o{i}", link) for i, link in enumerate(links))), STOP_S)
    broken, well = outputs._running.values()
    await until_so(lambda: well._sender.has_reader)  # type: ignore[attr-defined]
    monkeypatch.setattr(broken, "publish", lambda _frame: 1 / 0)
    with capture_logs() as logs:
        for i in range(20):
            clock.now_s = 0.05 * i
            outputs.publish(make_frame(0.05 * i))
    await until_so(lambda: len(places.hear()[links[1]]) == 20 * TSS1_BYTES)
    assert [line["event"] for line in logs if line["log_level"] == "error"] == [
        "error in an output: please report it; the others go on"
    ]
    assert outputs.health[0].lost["error"] == 20
    assert await asyncio.wait_for(outputs.stop(STOP_S), PATIENCE_S)
