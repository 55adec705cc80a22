"""Line protocol, read by a parser of the tests' own and by a real InfluxDB; far ends that refuse, hang and vanish."""

from __future__ import annotations

import asyncio
import base64
import json
import socket
from contextlib import asynccontextmanager, suppress
from typing import TYPE_CHECKING, Any

import aiohttp
import msgspec
import pytest
from aiohttp import web
from far_ends import INFLUXD, TIMEOUT_S, certificates, free_port, needs_influxd, needs_openssl, running, until
from hypothesis import given
from hypothesis import strategies as st
from stream_peers import make_frame, make_status

from heaved.outputs import influx
from heaved.outputs.influx import InfluxOutput, InfluxParams
from heaved.outputs.line_protocol import Lines, encode
from heaved.outputs.output import Told
from heaved.samples import DelayedHeave, PointMotion, SeaState, WaveSystem

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable
    from pathlib import Path

UTC_S = 1767225600.123456


# ---- an independent reader ------------------------------------------------------------------------------------------


def split(text: str, sign: str) -> list[str]:
    """At each ``sign`` that stands neither behind a backslash nor between quotes."""
    parts: list[str] = []
    part, quoted, i = "", False, 0
    while i < len(text):
        if text[i] == "\\" and i + 1 < len(text):
            part, i = part + text[i : i + 2], i + 2
            continue
        quoted ^= text[i] == '"'
        if text[i] == sign and not quoted:
            parts, part = [*parts, part], ""
        else:
            part += text[i]
        i += 1
    return [*parts, part]


def plain(text: str, signs: str) -> str:
    for sign in signs:
        text = text.replace("\\" + sign, sign)
    return text


def parsed(line: bytes) -> tuple[str, dict[str, str], dict[str, Any], int]:
    """Measurement, tags, fields, nanoseconds."""
    text = line.decode()
    assert text.endswith("\n")
    assert text.count("\n") == 1
    head, values, time_ns = split(text[:-1], " ")
    name, *tags = split(head, ",")

    def value(text: str) -> Any:
        if text.startswith('"'):
            assert text.endswith('"')
            return text[1:-1].replace('\\"', '"').replace("\\\\", "\\")
        if text in ("true", "false"):
            return text == "true"
        return int(text[:-1]) if text.endswith("i") else float(text)

    def pair(text: str) -> tuple[str, str]:
        key, found = split(text, "=")
        return plain(key, ",= "), found

    return (
        plain(name, ", "),
        {key: plain(tag, ",= ") for key, tag in map(pair, tags)},
        {key: value(found) for key, found in map(pair, split(values, ","))},
        int(time_ns),
    )


# ---- the encoder -----------------------------------------------------------------------------------------------------


GOLDEN: dict[str, tuple[tuple[str, dict[str, str], dict[str, Any]], bytes]] = {
    "as documented": (("m", {"host": "ship"}, {"heave_m": 0.5}), b"m,host=ship heave_m=0.5 1767225600123456000\n"),
    "tags in order": (("m", {"b": "2", "a": "1"}, {"x": 1}), b"m,a=1,b=2 x=1i 1767225600123456000\n"),
    "an empty tag is none": (("m", {"a": ""}, {"x": True}), b"m x=true 1767225600123456000\n"),
    "signs in names": (("a, b=", {"k =,": "v =,"}, {"f =,": 1.0}),
        b"a\\,\\ b=,k\\ \\=\\,=v\\ \\=\\, f\\ \\=\\,=1.0 1767225600123456000\n"),
    "signs in text": (("m", {}, {"t": 'say "a\\b", c=d'}), b'm t="say \\"a\\\\b\\", c=d" 1767225600123456000\n'),
    "no line breaks": (("m", {"a": "x\ny"}, {"t": "x\r\ny"}), b'm,a=x_y t="x  y" 1767225600123456000\n'),
    "nothing known": (("m", {"host": "ship"}, {}), b""),
}  # fmt: skip


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_lines(name: str) -> None:
    (measurement, tags, values), line = GOLDEN[name]
    assert encode(measurement, tags, values, UTC_S) == line


NAMES = st.text(st.characters(exclude_categories=["Cc", "Cs"], exclude_characters='\\"'), min_size=1, max_size=20)
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=30)
VALUES = st.one_of(st.floats(-1e9, 1e9), st.integers(-(2**63), 2**63 - 1), st.booleans(), TEXTS)


@given(NAMES, st.dictionaries(NAMES, NAMES, max_size=4), st.dictionaries(NAMES, VALUES, min_size=1, max_size=4))
def test_whatever_is_sent_is_read_back(name: str, tags: dict[str, str], values: dict[str, Any]) -> None:
    read = parsed(encode(name, tags, values, UTC_S))
    one_line = {
        key: value.replace("\n", " ").replace("\r", " ") if isinstance(value, str) else value
        for key, value in values.items()
    }
    assert read == (name, tags, one_line, 1767225600123456000)
    assert [type(value) for value in read[2].values()] == [type(value) for value in values.values()]


def full_frame(t_s: float) -> Any:
    sea = SeaState(
        significant_height_m=2.0, peak_period_s=9.0, mean_period_s=8.0, frequencies_hz=(0.1,), spectrum_m2phz=(1.0,),
        systems=(WaveSystem(kind="swell", significant_height_m=1.5, peak_period_s=9.0),), t_s=t_s - 10.0,
        window_s=120.0, model="test",
    )  # fmt: skip
    return msgspec.structs.replace(
        make_frame(t_s),
        sea=sea,
        delayed=DelayedHeave(t_s=t_s - 60.0, heave_m=0.5, std_m=0.01),
        points=(PointMotion(name="crane-tip", heave_m=2.0), PointMotion(name="unknown")),
    )


def test_lines_say_what_the_stream_says_under_its_names() -> None:
    frame = full_frame(100.0)
    lines = [parsed(line) for line in Lines("heaved", {"host": "ship"}).motion(frame, UTC_S)]
    assert [name for name, *_ in lines] == ["heaved_motion", "heaved_point"] + 7 * ["heaved_rock"] + 4 * [
        "heaved_forecast"
    ]
    _, tags, motion, time_ns = lines[0]
    assert (tags, time_ns) == ({"host": "ship"}, 1767225600123456000)
    assert motion == {
        "heave_m": 1.25, "heave_std_m": 0.02, "heave_velocity_mps": -0.5, "roll_deg": 5.729578, "pitch_deg": -2.864789,
        "quality": "valid", "laser": "valid", "correction": "active", "reasons": "",
    }  # fmt: skip
    assert lines[1][1:3] == ({"host": "ship", "point": "crane-tip"}, {"heave_m": 2.0})
    assert lines[-1][1:3] == ({"host": "ship", "horizon_s": "5"}, {"heave_m": 1.0, "std_m": 0.1})


def test_nothing_unknown_is_sent() -> None:
    frame = msgspec.structs.replace(
        make_frame(100.0), heave_m=float("nan"), heave_std_m=float("inf"), rock=(), forecast=()
    )
    ((_, _, motion, _),) = [parsed(line) for line in Lines("heaved", {}).motion(frame, UTC_S)]
    assert "heave_m" not in motion
    assert "heave_std_m" not in motion


def test_the_status_has_a_line_for_each_device() -> None:
    lines = [parsed(line) for line in Lines("x", {}).status(make_status(), UTC_S)]
    assert [name for name, *_ in lines] == ["x_status", "x_device"]
    assert lines[1][1:3] == (
        {"device": "imu", "role": "imu"}, {"up": True, "rate_hz": 99.5, "polls_none": 6000, "polls_crc": 2},
    )  # fmt: skip


# ---- sending ---------------------------------------------------------------------------------------------------------


@asynccontextmanager
async def output(link: str, **params: Any) -> AsyncIterator[InfluxOutput]:
    """One that runs, and is stopped as the daemon does it."""
    made = InfluxOutput(
        InfluxParams(enabled=True, link=link, **{"batch_s": 0.1, **params}),
        Told(make_status, lambda t_s: 1.7e9 + t_s, lambda: 100.0),
    )
    task = asyncio.create_task(made.run())
    try:
        yield made
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await asyncio.wait_for(task, TIMEOUT_S)


async def until_down(out: InfluxOutput, detail: str) -> None:
    await until(lambda: detail in out.health.detail and not out.health.is_up, lambda: out.health.detail)


class Database:
    """Takes lines as InfluxDB does, or answers as it is told."""

    def __init__(self) -> None:
        self.answer: tuple[int, str] = (204, "")
        self.may_answer = asyncio.Event()
        self.may_answer.set()
        self.lines: list[bytes] = []
        self.requests: list[web.BaseRequest] = []
        self.port = 0

    async def take(self, request: web.BaseRequest) -> web.StreamResponse:
        body = await request.read()
        self.requests.append(request)
        await self.may_answer.wait()
        status, text = self.answer
        if status == 204:
            self.lines += body.splitlines(keepends=True)
        return web.Response(status=status, text=text)

    def names(self) -> set[str]:
        return {parsed(line)[0] for line in self.lines}


@asynccontextmanager
async def served(database: Database, port: int = 0, **options: Any) -> AsyncIterator[Database]:
    runner = web.ServerRunner(web.Server(database.take), shutdown_timeout=0.1)
    await runner.setup()
    site = web.TCPSite(runner, "127.0.0.1", port, **options)
    await site.start()
    database.port = runner.addresses[0][1]
    try:
        yield database
    finally:
        await runner.cleanup()


async def test_frames_come_in_batches_to_influxdb_2(tmp_path: Path) -> None:
    (tmp_path / "token").write_text("secret\n")
    async with (
        served(Database()) as database,
        output(
            f"http://127.0.0.1:{database.port}",
            bucket="ship",
            org="my org",
            token_file=str(tmp_path / "token"),
            rate_hz=10.0,
        ) as out,
    ):
        for i in range(11):
            out.publish(full_frame(100.0 + 0.1 * i))
        everything = {
            f"heaved_{name}"
            for name in ("motion", "point", "rock", "forecast", "sea", "wave_system", "delayed", "status", "device")
        }
        await until(lambda: everything <= database.names(), database.names)
        request = database.requests[0]
        assert request.path == "/api/v2/write"
        assert dict(request.query) == {"bucket": "ship", "org": "my org", "precision": "ns"}
        assert request.headers["Authorization"] == "Token secret"
        assert len(database.requests) < 4
        motions = [parsed(line) for line in database.lines if line.startswith(b"heaved_motion,")]
        assert [time_ns for *_, time_ns in motions] == [1_700_000_100_000_000_000 + i * 100_000_000 for i in range(11)]
        await until(lambda: out.health.sent == len(database.lines), lambda: out.health.sent)
        assert out.health.is_up


async def test_influxdb_1_with_a_password(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("pass")
    async with (
        served(Database()) as database,
        output(
            f"http://127.0.0.1:{database.port}", database="sea", username="ship", password_file=str(tmp_path / "secret")
        ),
    ):
        await until(lambda: database.requests, lambda: "no request")
        assert (database.requests[0].path, database.requests[0].query["db"]) == ("/write", "sea")
        assert database.requests[0].headers["Authorization"] == f"Basic {base64.b64encode(b'ship:pass').decode()}"


REFUSALS = {
    "a line": (400, '{"error":"unable to parse \'x\': missing fields"}',
        "400 Bad Request: unable to parse 'x': missing fields; see its log", "refused"),
    "a token": (401, '{"code":"unauthorized","message":"unauthorized access"}', "unauthorized access; check", ""),
    "a database": (404, '{"error":"database not found: \\"heaved\\""}',
        'database not found: "heaved"; check database, and create it', ""),
    "no database": (301, "", "is the link that of an InfluxDB?", ""),
    "an overload": (503, "too\n busy", "503 Service Unavailable: too busy; see its log; the lines wait", ""),
    "not text": (500, "\x00\x01", "500 Internal Server Error", ""),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSALS)
async def test_a_refusal_is_said_in_the_words_of_the_server(name: str) -> None:
    status, text, words, lost = REFUSALS[name]
    database = Database()
    database.answer = status, text
    async with served(database), output(f"http://127.0.0.1:{database.port}") as out:
        await until_down(out, words)
        if lost:
            await until(lambda: out.health.lost[lost] > 0, lambda: out.health.lost)
        database.answer = 204, ""
        out.publish(make_frame(200.0))
        await until(lambda: out.health.is_up, lambda: out.health.detail)
        assert ("heaved_status" in database.names()) is not bool(lost)  # What was refused for good does not come again.


async def test_while_the_database_is_away_the_newest_lines_are_kept() -> None:
    port = free_port()
    async with output(f"http://127.0.0.1:{port}", most_lines=100, rate_hz=100.0) as out:
        await until_down(out, f"check that a database listens on port {port}")
        for i in range(200):
            out.publish(msgspec.structs.replace(make_frame(100.0 + 0.01 * i), rock=(), forecast=()))
        assert out.health.lost["full"] == 200 + 2 - 100
        async with served(Database(), port) as database:
            await until(lambda: len(database.lines) >= 100, lambda: len(database.lines))
            times = [parsed(line)[3] for line in database.lines if line.startswith(b"heaved_motion")]
            assert times == [1_700_000_101_000_000_000 + i * 10_000_000 for i in range(100)]


async def test_what_is_dropped_while_it_is_under_way_takes_nothing_else_with_it() -> None:
    database = Database()
    database.may_answer.clear()
    async with served(database), output(f"http://127.0.0.1:{database.port}", most_lines=100, rate_hz=100.0) as out:
        await until(lambda: database.requests, lambda: "no request")
        for i in range(150):  # Pushes the two lines of the status out, which are under way, and fifty of its own.
            out.publish(msgspec.structs.replace(make_frame(100.0 + 0.01 * i), rock=(), forecast=()))
        database.may_answer.set()
        await until(lambda: out.health.sent == 102, lambda: out.health.sent)
        times = [parsed(line)[3] for line in database.lines if line.startswith(b"heaved_motion")]
        assert times == [1_700_000_100_500_000_000 + i * 10_000_000 for i in range(100)]


async def test_a_connection_that_the_server_closes_between_batches_is_no_failure() -> None:
    bodies: list[bytes] = []

    async def once(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Takes one request, and goes when there is another."""
        head = await reader.readuntil(b"\r\n\r\n")
        length = next(line for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:"))
        bodies.append(await reader.readexactly(int(length.split(b":")[1])))
        writer.write(b"HTTP/1.1 204 No Content\r\n\r\n")
        await reader.read(1)
        writer.close()

    server = await asyncio.start_server(once, "127.0.0.1", 0)
    async with server, output(f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}") as out:

        async def taken(count: int) -> None:
            await until(lambda: len(bodies) == count and not out._waiting, lambda: (bodies, out.health.detail))

        for i in range(3):
            await taken(i + 1)
            out.publish(make_frame(100.0 + i))
        await taken(4)
        assert (out.health.connections, out.health.lost.total()) == (1, 0)


async def test_a_server_that_never_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(influx, "_ANSWER_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        async with output(f"http://127.0.0.1:{silent.getsockname()[1]}") as out:
            await until_down(out, "does not answer within 0.2 s")


async def test_a_name_that_is_none() -> None:
    for scheme in ("http", "udp"):
        async with output(f"{scheme}://database.invalid:8086") as out:
            await until_down(out, "host name database.invalid")


@needs_openssl
async def test_with_tls_the_certificate_must_be_right(tmp_path: Path) -> None:
    import ssl

    certificates(tmp_path)
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(tmp_path / "server.pem", tmp_path / "server.key")
    async with served(Database(), ssl_context=context) as database:
        link = f"https://localhost:{database.port}"
        async with output(link, ca_file=str(tmp_path / "ca.pem")) as out:
            await until(lambda: out.health.is_up, lambda: out.health.detail)
        async with output(link) as out:
            await until_down(out, "the certificate of localhost is not accepted")
        async with output(link, ca_file=str(tmp_path / "server.key")) as out:
            await until_down(out, "it must hold certificates, as PEM text")
        async with output(link, ca_file=str(tmp_path / "none.pem")) as out:
            await until_down(out, "none.pem cannot be read")


async def test_tls_to_a_port_without_it_is_said() -> None:
    async with served(Database()) as database, output(f"https://localhost:{database.port}") as out:
        await until_down(out, "is one with TLS (http:// is without)")


async def test_what_is_left_is_sent_at_the_stop() -> None:
    async with served(Database()) as database:
        async with output(f"http://127.0.0.1:{database.port}", batch_s=60.0) as out:
            out._params = msgspec.structs.replace(out._params, batch_s=0.1)
            await until(lambda: out.health.is_up, lambda: out.health.detail)
            out._params = msgspec.structs.replace(out._params, batch_s=60.0)
            out.publish(make_frame(300.0))
        assert "heaved_motion" in database.names()


@needs_influxd
async def test_a_real_influxdb_gives_back_what_it_was_sent(tmp_path: Path) -> None:
    port = free_port()
    file = tmp_path / "influxdb.conf"
    file.write_text(
        f'bind-address = "127.0.0.1:{free_port()}"\nreporting-disabled = true\n'
        f'[meta]\ndir = "{tmp_path}/meta"\n[data]\ndir = "{tmp_path}/data"\nwal-dir = "{tmp_path}/wal"\n'
        f'[http]\nbind-address = "127.0.0.1:{port}"\n'
    )
    async with running(port, str(INFLUXD), "-config", str(file)), aiohttp.ClientSession() as session:

        async def asked(query: str) -> list[dict[str, Any]]:
            url = f"http://127.0.0.1:{port}/query"
            async with session.post(url, params={"db": "heaved", "epoch": "ns", "q": query}) as answer:
                result = json.loads(await answer.read())["results"][0]
                return [
                    dict(zip(series["columns"], row, strict=True))
                    for series in result.get("series", [])
                    for row in series["values"]
                ]

        async with output(f"http://127.0.0.1:{port}", tags={"vessel": "Ann, of = X"}, rate_hz=10.0) as out:
            await until_down(out, 'database not found: "heaved"')
            await asked('CREATE DATABASE "heaved"')
            for i in range(5):
                out.publish(full_frame(100.0 + 0.1 * i))
            await until(lambda: out.health.is_up, lambda: out.health.detail)
            assert out.health.lost.total() == 0
        rows = await asked("SELECT heave_m, roll_deg, quality, vessel FROM heaved_motion")
        assert rows == [
            {"time": 1_700_000_100_000_000_000 + i * 100_000_000, "heave_m": 1.25, "roll_deg": 5.729578,
             "quality": "valid", "vessel": "Ann, of = X"}
            for i in range(5)
        ]  # fmt: skip
        (device,) = await asked("SELECT device, up, polls_crc FROM heaved_device")
        assert (device["device"], device["up"], device["polls_crc"]) == ("imu", True, 2)
        assert {row["horizon_s"] for row in await asked("SELECT roll_deg, horizon_s FROM heaved_rock")} == {
            "0.05", "0.1", "0.15", "0.5", "1", "2", "5",
        }  # fmt: skip


# ---- UDP -------------------------------------------------------------------------------------------------------------


async def received(receiver: socket.socket, done: Callable[[list[bytes]], bool]) -> list[bytes]:
    async def all_of_it() -> list[bytes]:
        datagrams: list[bytes] = []
        while not done(datagrams):
            datagrams.append(await asyncio.get_running_loop().sock_recv(receiver, 65536))
        return datagrams

    return await asyncio.wait_for(all_of_it(), TIMEOUT_S)


async def test_datagrams_hold_whole_lines_and_fit_a_frame() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.setblocking(False)
        async with output(f"udp://127.0.0.1:{receiver.getsockname()[1]}", rate_hz=10.0) as out:
            for i in range(5):
                out.publish(full_frame(100.0 + 0.1 * i))
            datagrams = await received(receiver, lambda datagrams: b"".join(datagrams).count(b"heaved_motion") == 5)
            await until(lambda: out.health.is_up, lambda: out.health.detail)
        assert all(len(datagram) <= 1432 for datagram in datagrams)
        assert len(datagrams) > 1
        for line in b"".join(datagrams).splitlines(keepends=True):
            parsed(line)


async def test_that_nobody_listens_is_said_and_when_somebody_does_it_goes_on() -> None:
    port = free_port()
    async with output(f"udp://127.0.0.1:{port}", rate_hz=100.0) as out:
        await until_down(out, f"check that somebody listens on udp://127.0.0.1:{port}")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
            receiver.bind(("127.0.0.1", port))
            receiver.setblocking(False)
            out.publish(make_frame(100.0))
            await received(receiver, bool)
            await until(lambda: out.health.is_up, lambda: out.health.detail)
