"""Messages to a broker: a real one (mosquitto), and far ends that are none."""

from __future__ import annotations

import asyncio
import gc
import json
import signal
import socket
import subprocess
import sys
import threading
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import aiomqtt
import msgspec
import pytest
from far_ends import (
    MOSQUITTO,
    MOSQUITTO_PASSWD,
    TIMEOUT_S,
    certificates,
    free_port,
    needs_mosquitto,
    needs_openssl,
    running,
)
from far_ends import until as until_true
from stream_peers import make_frame, make_status

from heaved.outputs import mqtt, wire
from heaved.outputs.mqtt import MqttOutput, MqttParams
from heaved.outputs.output import OutputHealth, Told
from heaved.samples import DelayedHeave, SeaState

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Iterator

    from heaved.samples import MotionFrame


class Clock:
    """Goes on when it is told to."""

    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture(autouse=True)
def _soon_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mqtt, "_FIRST_PAUSE_S", 0.05)
    monkeypatch.setattr(mqtt, "_LONGEST_PAUSE_S", 0.1)


@asynccontextmanager
async def broker(directory: Path, *lines: str, port: int | None = None, listen: bool = True) -> AsyncIterator[int]:
    """mosquitto, with these lines in its configuration; gives its port."""
    port = port or free_port()
    file = directory / f"mosquitto-{port}.conf"
    options = lines if any("allow_anonymous" in line for line in lines) else ("allow_anonymous true", *lines)
    file.write_text("\n".join([f"listener {port} 127.0.0.1", *options, ""]))
    async with running(port, str(MOSQUITTO), "-c", str(file)):
        yield port


@asynccontextmanager
async def output(link: str, **params: Any) -> AsyncIterator[MqttOutput]:
    """One that runs, and is stopped as the daemon does it."""
    made = MqttOutput(
        MqttParams(enabled=True, link=link, **params),
        Told(make_status, lambda t_s: 1.7e9 + t_s, Clock()),
    )
    made.health = Health(made.health)
    task = asyncio.create_task(made.run())
    try:
        yield made
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await asyncio.wait_for(task, TIMEOUT_S)


@asynccontextmanager
async def reader(port: int, *topics: str, **options: Any) -> AsyncIterator[aiomqtt.Client]:
    async with aiomqtt.Client("127.0.0.1", port, identifier="reader", **options) as client:
        for topic in topics or ("heaved/#",):
            await client.subscribe(topic, qos=1)
        yield client


async def message(client: aiomqtt.Client, topic: str) -> aiomqtt.Message:
    """The next one of that topic."""

    async def found() -> aiomqtt.Message:
        async for one in client.messages:
            if str(one.topic) == topic:
                return one
        raise AssertionError("the broker is gone")

    return await asyncio.wait_for(found(), TIMEOUT_S)


class Health(OutputHealth):
    """Remembers what was said."""

    def __init__(self, health: OutputHealth) -> None:
        super().__init__(health.name, health.kind, health.where)
        self.said: list[str] = []

    def down(self, detail: str) -> None:
        self.said.append(detail)
        super().down(detail)


async def until(output: MqttOutput, *, up: bool | None = None, detail: str = "") -> None:
    """It is up or not, and has said that."""
    health = output.health
    assert isinstance(health, Health)

    await until_true(
        lambda: up in (health.is_up, None) and (not detail or any(detail in said for said in health.said)),
        lambda: (health.is_up, health.said),
    )


def payload(message: aiomqtt.Message) -> Any:
    assert isinstance(message.payload, bytes)
    return json.loads(message.payload)


# ---- what is sent ----------------------------------------------------------------------------------------------------


@needs_mosquitto
@pytest.mark.parametrize("protocol", ["3.1.1", "5"])
async def test_a_motion_is_the_line_of_the_stream(tmp_path: Path, protocol: str) -> None:
    async with (
        broker(tmp_path) as port,
        reader(port) as client,
        output(f"mqtt://127.0.0.1:{port}", protocol=protocol) as out,
    ):
        assert (await message(client, "heaved/availability")).payload == b"online"
        await until(out, up=True)
        frame = make_frame(99.75)
        out.publish(frame)
        line = wire.encode_motion(frame, seq=1, utc_s=1.7e9 + 99.75, sent_mono_s=100.0)
        got = await message(client, "heaved/motion")
        assert got.payload == line.rstrip(b"\n")
        assert (got.qos, got.retain) == (0, False)
        assert payload(got)["class"] == "MOTION"


@needs_mosquitto
async def test_status_and_availability_are_kept_for_who_comes_later(tmp_path: Path) -> None:
    async with broker(tmp_path) as port, output(f"mqtt://127.0.0.1:{port}") as out:
        await until(out, up=True)
        async with reader(port, "heaved/status") as first:  # It is there, whenever it came.
            await message(first, "heaved/status")
        async with reader(port) as client:
            status = await message(client, "heaved/status")
            assert status.retain
            assert payload(status) == json.loads(wire.encode_record(make_status()))
        async with reader(port) as client:
            online = await message(client, "heaved/availability")
            assert (online.retain, online.payload) == (True, b"online")


def descriptors() -> int:
    """Open ones of this process."""
    return len(list(Path("/proc/self/fd").iterdir()))


def frame_with_all(t_s: float, sea: SeaState) -> MotionFrame:
    return msgspec.structs.replace(
        make_frame(t_s), sea=sea, delayed=DelayedHeave(t_s=t_s - 60.0, heave_m=0.5, std_m=0.01)
    )


@needs_mosquitto
async def test_what_is_slower_is_sent_when_it_is_new(tmp_path: Path) -> None:
    sea = SeaState(
        significant_height_m=2.0, peak_period_s=9.0, mean_period_s=8.0, systems=(), frequencies_hz=(0.1,),
        spectrum_m2phz=(1.0,), t_s=50.0, window_s=120.0, model="test",
    )  # fmt: skip
    async with (
        broker(tmp_path) as port,
        reader(port, "ship/1/#") as client,
        output(f"mqtt://127.0.0.1:{port}", topic="ship/1", qos=1, retain=True) as out,
    ):
        await until(out, up=True)
        for i in range(3):
            out.publish(frame_with_all(100.0 + i, sea))
        seen: list[str] = []
        while seen.count("ship/1/delayed") < 3:
            got = await asyncio.wait_for(anext(aiter(client.messages)), TIMEOUT_S)
            seen.append(str(got.topic))
            if str(got.topic) == "ship/1/sea":
                assert payload(got)["significant_height_m"] == 2.0
                assert got.qos == 1
        assert seen.count("ship/1/sea") == 1
        assert seen.count("ship/1/motion") == 3


@needs_mosquitto
async def test_the_rate_is_kept_whatever_that_of_the_frames(tmp_path: Path) -> None:
    async with broker(tmp_path) as port, reader(port) as client, output(f"mqtt://127.0.0.1:{port}", rate_hz=2.0) as out:
        await until(out, up=True)
        for i in range(401):
            out.publish(make_frame(100.0 + 0.01 * i))
        times = [payload(await message(client, "heaved/motion"))["mono_s"] for _ in range(9)]
        assert times == pytest.approx([100.0 + 0.5 * i for i in range(9)])


# ---- offline ---------------------------------------------------------------------------------------------------------


@needs_mosquitto
async def test_a_clean_stop_says_offline(tmp_path: Path) -> None:
    async with broker(tmp_path) as port:
        async with output(f"mqtt://127.0.0.1:{port}") as out:
            await until(out, up=True)
        async with reader(port, "heaved/availability") as client:
            assert (await message(client, "heaved/availability")).payload == b"offline"


PUBLISHER = """
import asyncio, sys
from stream_peers import make_status
from heaved.outputs.mqtt import MqttOutput, MqttParams
from heaved.outputs.output import Told

async def main():
    params = MqttParams(enabled=True, link=sys.argv[1])
    await MqttOutput(params, Told(make_status, lambda t_s: t_s)).run()

asyncio.run(main())
"""


@needs_mosquitto
async def test_the_broker_says_offline_when_the_process_is_killed(tmp_path: Path) -> None:
    async with broker(tmp_path) as port, reader(port, "heaved/availability") as client:
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-c", PUBLISHER, f"mqtt://127.0.0.1:{port}", env={"PYTHONPATH": ":".join(sys.path)}
        )
        try:
            assert (await message(client, "heaved/availability")).payload == b"online"
        finally:
            process.kill()
            await process.wait()
        assert (await message(client, "heaved/availability")).payload == b"offline"


# ---- a broker that goes and comes ------------------------------------------------------------------------------------


@needs_mosquitto
async def test_a_broker_that_comes_back_is_told_the_newest_and_no_old_motion(tmp_path: Path) -> None:
    port = free_port()
    async with output(f"mqtt://127.0.0.1:{port}") as out:
        await until(out, up=False, detail="check that an MQTT broker listens on port")
        for _ in range(2):
            lost = out.health.lost.total()
            for i in range(5):
                out.publish(make_frame(100.0 * (lost + 1) + i))
            assert out.health.lost["away"] == lost + 5
            async with broker(tmp_path, port=port), reader(port) as client:
                await until(out, up=True)
                assert payload(await message(client, "heaved/status"))["class"] == "STATUS"
                out.publish(make_frame(100.0 * (lost + 1) + 50.0))
                first = payload(await message(client, "heaved/motion"))
                assert first["mono_s"] == 100.0 * (lost + 1) + 50.0
                assert first["dropped"] == 5
            await until(out, up=False)
        assert out.health.connections == 2


@needs_mosquitto
async def test_two_with_one_id_are_told_so(tmp_path: Path) -> None:
    async with broker(tmp_path) as port, output(f"mqtt://127.0.0.1:{port}", client_id="same", protocol="5") as out:
        await until(out, up=True)
        async with aiomqtt.Client("127.0.0.1", port, identifier="same", protocol=aiomqtt.ProtocolVersion.V5):
            await until(out, detail="ours is 'same', give each its own client_id")


async def test_while_the_broker_is_slow_what_waits_is_bounded() -> None:
    out = MqttOutput(MqttParams(enabled=True, rate_hz=100.0), Told(make_status, lambda t_s: t_s, Clock()))
    out._is_connected = True
    for i in range(1000):
        out.publish(make_frame(100.0 + 0.01 * i))
    assert len(out._waiting) == 256
    assert out.health.lost["slow"] == 1000 - 256
    assert out._waiting[-1].t_s == pytest.approx(109.99)


class EverMore:
    """A broker for which there is another frame with each message that it has taken."""

    def __init__(self, out: MqttOutput) -> None:
        self._out = out
        self.topics: list[str] = []

    async def publish(self, topic: str, *arguments: Any, **options: Any) -> None:
        self.topics.append(topic)
        self._out.publish(make_frame(100.0 + len(self.topics)))
        await asyncio.sleep(0)


async def test_the_status_is_sent_however_much_else_waits() -> None:
    params = MqttParams(enabled=True, rate_hz=100.0, status_period_s=0.02)
    out = MqttOutput(params, Told(make_status, lambda t_s: t_s, Clock()))
    client = EverMore(out)
    sending = asyncio.create_task(out._send(client))  # type: ignore[arg-type]
    await until_true(lambda: client.topics.count("heaved/status") > 2, lambda: client.topics[:20])
    sending.cancel()
    with suppress(asyncio.CancelledError):
        await sending
    assert client.topics.count("heaved/motion") > 2


# ---- who may, and whom we believe ------------------------------------------------------------------------------------


@needs_mosquitto
@pytest.mark.skipif(MOSQUITTO_PASSWD is None, reason="mosquitto_passwd is not installed")
async def test_a_password_that_is_wrong_is_said_and_one_that_is_put_right_counts_at_once(tmp_path: Path) -> None:
    users, secret = tmp_path / "users", tmp_path / "secret"
    made = await asyncio.create_subprocess_exec(str(MOSQUITTO_PASSWD), "-b", "-c", str(users), "ship", "right")
    assert await made.wait() == 0
    users.chmod(0o644)
    secret.write_text("wrong\n")
    locked = ("allow_anonymous false", f"password_file {users}", "user root")
    async with broker(tmp_path, *locked) as port:
        link = f"mqtt://127.0.0.1:{port}"
        async with output(link, username="ship", password_file=str(secret)) as out:
            await until(out, up=False, detail="check username and password_file")
            secret.write_text("right\n")
            await until(out, up=True)
        async with output(link) as out:
            await until(out, up=False, detail="set username and password_file")
        async with output(link, username="ship", password_file=str(tmp_path / "none")) as out:
            await until(out, up=False, detail="none cannot be read (No such file or directory)")


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("keys")
    certificates(directory)
    for file in directory.iterdir():
        file.chmod(0o644)
    return directory


def encrypted(keys: Path) -> tuple[str, ...]:
    files = {"cafile": "ca.pem", "certfile": "server.pem", "keyfile": "server.key"}
    return ("user root", *(f"{key} {keys / name}" for key, name in files.items()))


# paho leaves the socket of a handshake that has failed to be closed when it is freed.
frees_sockets = pytest.mark.filterwarnings("ignore:unclosed <ssl.SSLSocket:ResourceWarning")


@needs_mosquitto
@needs_openssl
@frees_sockets
async def test_no_descriptor_stays_behind_when_certificates_are_wrong(tmp_path: Path, keys: Path) -> None:
    async with broker(tmp_path, *encrypted(keys)) as port:
        gc.collect()
        gc.disable()
        try:
            async with output(f"mqtts://localhost:{port}", ca_file=str(keys / "other.pem")) as out:
                assert isinstance(out.health, Health)
                said = out.health.said
                await until(out, up=False, detail="is not accepted")
                before = descriptors()
                await until_true(lambda: len(said) >= 10, lambda: said)
                assert descriptors() <= before + 1  # That of an attempt that is being made.
        finally:
            gc.enable()


@needs_mosquitto
@needs_openssl
@frees_sockets
async def test_with_tls_it_is_sent_to_the_right_broker_alone(tmp_path: Path, keys: Path) -> None:
    async with broker(tmp_path, *encrypted(keys)) as port:
        async with output(f"mqtts://localhost:{port}", ca_file=str(keys / "ca.pem")) as out:
            await until(out, up=True)
        async with output(f"mqtts://127.0.0.1:{port}", ca_file=str(keys / "ca.pem")) as out:
            await until(out, up=False, detail="link to a name that it is for")
        async with output(f"mqtts://localhost:{port}", ca_file=str(keys / "other.pem")) as out:
            await until(
                out, up=False, detail="is not accepted (self-signed certificate in certificate chain): set ca_file"
            )


@needs_mosquitto
@needs_openssl
async def test_a_broker_may_want_a_certificate_of_ours(tmp_path: Path, keys: Path) -> None:
    ours = {"certificate_file": str(keys / "client.pem"), "key_file": str(keys / "client.key")}
    async with broker(tmp_path, *encrypted(keys), "require_certificate true") as port:
        link, ca = f"mqtts://localhost:{port}", str(keys / "ca.pem")
        async with output(link, ca_file=ca, **ours) as out:
            await until(out, up=True)
        async with output(link, ca_file=ca, **ours | {"key_file": str(keys / "ca.key")}) as out:
            await until(out, up=False, detail="they must be a certificate and its own key")


# ---- far ends that are no broker -------------------------------------------------------------------------------------


@pytest.fixture
def silent() -> Iterator[int]:
    """The port of somebody who takes connections and says nothing."""
    with socket.create_server(("127.0.0.1", 0), backlog=64) as server:
        yield server.getsockname()[1]


FAR_ENDS = {
    "nobody": ("mqtt://127.0.0.1:{nobody}", "connection refused: check that an MQTT broker listens on port {nobody}"),
    "silent": ("mqtt://127.0.0.1:{silent}", "takes the connection and does not answer within"),
    "no such name": ("mqtt://broker.invalid:1883", "host name broker.invalid"),
}


@pytest.mark.parametrize("name", FAR_ENDS)
async def test_a_far_end_that_is_none_is_said_once(name: str, silent: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mqtt, "_ANSWER_S", 0.2)
    ports = {"nobody": free_port(), "silent": silent}
    link, words = FAR_ENDS[name]
    async with output(link.format(**ports)) as out:
        assert isinstance(out.health, Health)
        await until(out, up=False, detail=words.format(**ports))
        said = out.health.said
        await until_true(lambda: len(said) >= 3, lambda: said)
        assert len(set(said)) == 1  # What is said again is not logged again.


@needs_mosquitto
@frees_sockets
async def test_tls_to_a_port_without_it_is_said(tmp_path: Path) -> None:
    async with broker(tmp_path) as port, output(f"mqtts://localhost:{port}") as out:
        await until(out, up=False, detail="is one with TLS (mqtt:// is without)")


@needs_mosquitto
@needs_openssl
async def test_no_tls_to_a_port_with_it_is_said(tmp_path: Path, keys: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mqtt, "_ANSWER_S", 0.5)
    async with broker(tmp_path, *encrypted(keys)) as port, output(f"mqtt://localhost:{port}") as out:
        await until(out, up=False, detail="(else mqtts://)")


async def test_stopped_while_it_connects_it_leaves_no_connection(silent: int, monkeypatch: pytest.MonkeyPatch) -> None:
    connecting, go_on = threading.Event(), threading.Event()
    create_connection = socket.create_connection

    def held(*arguments: Any, **options: Any) -> socket.socket:
        connecting.set()
        go_on.wait(TIMEOUT_S)
        return create_connection(*arguments, **options)

    monkeypatch.setattr(mqtt, "_ANSWER_S", 0.2)
    monkeypatch.setattr(socket, "create_connection", held)
    async with output(f"mqtt://127.0.0.1:{silent}") as out:
        await asyncio.to_thread(connecting.wait, TIMEOUT_S)
    (task,) = out._leaving
    go_on.set()
    await asyncio.wait([task], timeout=TIMEOUT_S)
    await asyncio.sleep(0)
    assert out._leaving == set()


async def test_stopped_while_it_waits_for_an_answer_it_hangs_up() -> None:
    loop = asyncio.get_running_loop()
    errors: list[dict[str, Any]] = []
    loop.set_exception_handler(lambda _, context: errors.append(context))
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        async with output(f"mqtt://127.0.0.1:{server.getsockname()[1]}") as out:
            connection, _ = await asyncio.wait_for(loop.sock_accept(server), TIMEOUT_S)
            said = await asyncio.wait_for(loop.sock_recv(connection, 4096), TIMEOUT_S)
            assert said[4:8] == b"MQTT"
        (connecting,) = out._leaving
        connecting.cancel()  # As the end of the loop does.
        with connection:
            assert await asyncio.wait_for(loop.sock_recv(connection, 4096), TIMEOUT_S) == b""
        assert out._leaving == set()
        assert errors == []


@needs_mosquitto
async def test_a_broker_that_hangs_is_left_and_found_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mqtt, "_ANSWER_S", 0.5)
    port, file = free_port(), tmp_path / "mosquitto.conf"
    file.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")
    async with (
        running(port, str(MOSQUITTO), "-c", str(file)) as process,
        output(f"mqtt://127.0.0.1:{port}", status_period_s=1.0) as out,
    ):
        await until(out, up=True)
        process.send_signal(signal.SIGSTOP)
        await until(out, up=False, detail="does not acknowledge what it is sent")
        await until(out, up=False, detail="takes the connection and does not answer")
        process.send_signal(signal.SIGCONT)
        await until(out, up=True)
        process.send_signal(signal.SIGSTOP)  # It is stopped while nobody answers.
        out.publish(make_frame(100.0))
        await asyncio.sleep(0)


def test_a_daemon_without_it_loads_nothing_of_it() -> None:
    code = "import sys, heaved.daemon.daemon; print([name for name in sys.modules if name in ('aiomqtt', 'paho')])"
    environment = {"PYTHONPATH": ":".join(sys.path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, check=True, timeout=60)
    assert done.stdout == b"[]\n"


async def test_without_the_library_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "aiomqtt", None)
    async with output("mqtt://127.0.0.1:1883") as out:
        await until(out, up=False, detail="pip install 'heaved[mqtt]'")
