"""TLS of our own servers: who is let in, what becomes of the others, and that all else is as it is without."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import ssl
import subprocess
from collections import Counter
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import aiohttp
import pytest
from far_ends import OPENSSL, needs_openssl
from stream_peers import Peer
from structlog.testing import capture_logs
from tls_keys import client_context, make_keys, params

from heaved.networks import EVERYWHERE, checked_networks
from heaved.outputs import listen, shares, tls_connection
from heaved.outputs.http import HttpServer, Verdict
from heaved.outputs.tls import Certificates, Span

if TYPE_CHECKING:
    from pathlib import Path

    from stream_peers import Serve, Served

pytestmark = needs_openssl


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("keys")
    make_keys(directory)
    return directory


async def met(served: Served, context: ssl.SSLContext) -> Peer:
    return Peer(
        *await asyncio.open_connection(
            served.host, served.port, ssl=context, server_hostname="localhost", limit=1 << 22
        )
    )


def refused_in_thread(served: Served, context: ssl.SSLContext) -> None:
    """Connect and be refused. In a thread of its own, as another process has it: OpenSSL has one list of errors for
    each, and asyncio leaves in it what it meets as it closes.
    """
    with (
        socket.create_connection((served.host, served.port), timeout=20.0) as plain,
        suppress(ssl.SSLError, ConnectionError),
        context.wrap_socket(plain, server_hostname="localhost") as connection,
    ):
        assert connection.recv(1) == b"", "the stream is served"  # With TLS 1.3 it shows at the first reading.


async def refused(served: Served, context: ssl.SSLContext) -> None:
    await asyncio.to_thread(refused_in_thread, served, context)


async def until(condition: Any) -> None:
    async with asyncio.timeout(20.0):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.005)


# ---- the stream ------------------------------------------------------------------------------------------------------


async def test_the_stream_is_what_it_is_without(serve: Serve, keys: Path) -> None:
    served = await serve(certificates=Certificates(params(keys)))
    peer = await met(served, client_context(keys))
    assert (await peer.record())["class"] == "VERSION"
    served.publish(3)
    assert [record["seq"] for record in await peer.records(3)] == [1, 2, 3]
    await peer.ask("?STATUS", "?nonsense")
    assert [record["class"] for record in await peer.records(2)] == ["STATUS", "ERROR"]
    assert served.publisher.clients == 1
    await peer.close()
    while served.publisher.clients:  # That it has gone shows on sending.
        served.publish()
        await asyncio.sleep(0)
    assert served.counts.errors == {"bad_request": 1}


async def test_who_is_turned_away_reads_why(serve: Serve, keys: Path) -> None:
    served = await serve(certificates=Certificates(params(keys)), max_clients=1)
    peer = await met(served, client_context(keys))
    await peer.ask(*["?nonsense"] * 5)
    told = await peer.rest()
    assert [record["class"] for record in told] == ["VERSION"] + ["ERROR"] * 5
    assert "(error 5: closed)" in told[-1]["message"]


async def test_what_is_said_in_pieces_and_after_the_end(serve: Serve, keys: Path) -> None:
    """A client may end its side with its last word, and is answered: ``echo ?STATUS | openssl s_client -ign_eof``."""
    served = await serve(certificates=Certificates(params(keys)))
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    tls = client_context(keys).wrap_bio(incoming, outgoing, server_hostname="localhost")
    reader, writer = await asyncio.open_connection(served.host, served.port)

    async def spoken(act: Any) -> Any:
        while True:
            try:
                return act()
            except ssl.SSLWantReadError:
                for byte in outgoing.read():  # As small as a network can make them.
                    writer.write(bytes([byte]))
                    await writer.drain()
                incoming.write(await reader.read(65536))

    await spoken(tls.do_handshake)
    tls.write(b"?STATUS\n")
    with suppress(ssl.SSLWantReadError):
        tls.unwrap()
    writer.write(outgoing.read())
    heard = b""
    while heard.count(b"\n") < 2:
        heard += await spoken(lambda: tls.read(65536))
    assert [json.loads(line)["class"] for line in heard.splitlines()] == ["VERSION", "STATUS"]
    writer.close()


async def test_a_client_that_takes_nothing_loses_the_oldest_and_then_its_connection(serve: Serve, keys: Path) -> None:
    served = await serve(certificates=Certificates(params(keys)), queue_frames=16, stuck_s=5.0)
    reading, stuck = await met(served, client_context(keys)), await met(served, client_context(keys))
    stuck.writer.transport.pause_reading()  # type: ignore[attr-defined]
    await reading.record()
    await until(lambda: served.publisher.clients == 2)
    for seq in range(1, 100_000):
        served.publish()
        assert (await reading.record())["seq"] == seq
        if served.publisher.clients == 1:
            break
    assert served.counts.errors == {"stuck": 1}
    assert served.counts.dropped["slow_client"] > 100
    for peer in (reading, stuck):
        await peer.close()


# ---- who is not let in -----------------------------------------------------------------------------------------------


CLIENTS = {
    "none": (("", ""), "it shows no certificate"),
    "ended": (("old", "display"), "certificate has expired"),
    "of another authority": (("foreign", ""), "self-signed certificate"),
    "of a server": (("server", ""), "purpose"),
}


@pytest.mark.parametrize("name", CLIENTS)
async def test_a_certificate_that_is_not_taken(serve: Serve, keys: Path, name: str) -> None:
    (certificate, key), words = CLIENTS[name]
    served = await serve(certificates=Certificates(params(keys)))
    with capture_logs() as logs:
        for _ in range(3):
            await refused(served, client_context(keys, certificate, key))
    await until(lambda: served.counts.errors["tls"] == 3)
    assert served.publisher.clients == 0
    # One line and a count for each address and fault.
    assert {(line["event"], line["peer"], line["reason"]) for line in logs} == {
        ("stream client error", "127.0.0.1", "tls")
    }
    assert len({line["alike"] for line in logs}) == 1
    assert all(words in line["error"] for line in logs), logs


async def said_by(served: Served, said: bytes, *, is_ended: bool = False) -> None:
    reader, writer = await asyncio.open_connection(served.host, served.port)
    writer.write(said)
    if is_ended:
        writer.write_eof()
    with suppress(ConnectionError):
        while heard := await reader.read(65536):
            assert not heard.startswith(b"{"), "the stream is spoken without TLS"
    writer.close()


NO_TLS = {
    "HTTP": (b"GET /metrics HTTP/1.1\r\n\r\n", "it speaks HTTP without TLS"),
    "the stream": (b"?STATUS\n?STATUS\n?STATUS\n", "without TLS"),
    "zeros": (bytes(100_000), ""),
    "the head of a record without end": (b"\x16\x03\x01\xff\xff" + b"\x01" * 70_000, ""),
    "a hello of the year 1999": (bytes.fromhex("802e0103000015000000100100800300800700c006004002008004008000"), ""),
    "a hello of TLS 1.1": (
        bytes.fromhex("160302002f0100002b0302") + bytes(32) + bytes.fromhex("000004c013c0140100"), "older than 1.2"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", NO_TLS)
async def test_what_is_no_tls_is_one_line_and_no_traceback(
    serve: Serve, keys: Path, name: str, caplog: pytest.LogCaptureFixture
) -> None:
    said, words = NO_TLS[name]
    served = await serve(certificates=Certificates(params(keys)))
    with capture_logs() as logs:
        await said_by(served, said, is_ended=True)
        await until(lambda: served.counts.errors["tls"] == 1)
    (line,) = logs
    assert words in line["error"]
    assert "127.0.0.1" in line["error"]
    assert line["error"].isprintable()
    assert caplog.records == []


async def test_one_that_says_nothing_is_not_waited_for(
    serve: Serve, keys: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tls_connection, "HANDSHAKE_S", 0.05)
    served = await serve(certificates=Certificates(params(keys)))
    with capture_logs() as logs:
        await said_by(served, b"")
        await said_by(served, b"\x16\x03\x01")  # Nor one that does not go on.
        await until(lambda: served.counts.errors["tls"] == 2)
    assert all("it has not agreed on TLS" in line["error"] for line in logs)
    assert served.publisher._listener._under_way == 0


async def test_those_who_say_nothing_shut_nobody_out(serve: Serve, keys: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One address has a part of the places for a handshake, all have no more than there are, and get them back."""
    monkeypatch.setattr(shares, "neighbourhood", lambda address: address)
    monkeypatch.setattr(listen, "MOST_HANDSHAKES", 6)
    served = await serve(certificates=Certificates(params(keys)))
    listener = served.publisher._listener
    sources = [("127.0.0.2", 0)] * 5 + [("127.0.0.3", 0)] * 3
    silent = [socket.create_connection((served.host, served.port), source_address=source) for source in sources]
    await until(lambda: served.counts.errors == {"too_many_of_one_address": 1, "too_many_clients": 1})
    assert (listener._under_way, len(listener._shaking)) == (6, 6)
    for one in silent:
        one.close()
    await until(lambda: served.counts.errors["tls"] == 6)
    peer = await met(served, client_context(keys))
    assert (await peer.record())["class"] == "VERSION"
    assert (listener._under_way, len(listener._shaking)) == (0, 0)
    await peer.close()


async def test_with_networks_others_do_not_get_as_far_as_a_handshake(
    serve: Serve, keys: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listen, "is_allowed", lambda _address, _networks: False)
    served = await serve(certificates=Certificates(params(keys)), allow=("10.0.0.0/8",))
    await refused(served, client_context(keys))
    assert served.counts.errors == {"not_allowed": 1}


async def test_who_is_in_the_middle_of_it_when_the_daemon_ends(serve: Serve, keys: Path) -> None:
    served = await serve(certificates=Certificates(params(keys)))
    reader, writer = await asyncio.open_connection(served.host, served.port)
    await until(lambda: served.publisher._listener._shaking)
    await served.publisher.close(0.0)
    with suppress(ConnectionError):
        assert await reader.read() == b""
    writer.close()
    await until(lambda: not served.publisher._listener._shaking)


async def test_what_is_changed_on_its_way_ends_the_connection(serve: Serve, keys: Path) -> None:
    served = await serve(certificates=Certificates(params(keys)))
    peer = await met(served, client_context(keys))
    await peer.record()
    os.write(peer.writer.get_extra_info("socket").fileno(), b"\x17\x03\x03\x00\x20" + bytes(32))
    with suppress(ConnectionError, ssl.SSLError):
        assert await peer.reader.read() == b""
    await until(lambda: served.publisher.clients == 0)
    await peer.close()


async def test_an_alert_that_comes_as_one_is_turned_away_costs_another_nothing(serve: Serve, keys: Path) -> None:
    """OpenSSL has one list of errors for all connections of a thread."""
    served = await serve(certificates=Certificates(params(keys)))
    other = await met(served, client_context(keys))
    await other.record()
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    tls = client_context(keys).wrap_bio(incoming, outgoing, server_hostname="localhost")
    reader, writer = await asyncio.open_connection(served.host, served.port)
    for _ in range(2):
        with suppress(ssl.SSLWantReadError):
            tls.do_handshake()
        writer.write(outgoing.read())
        incoming.write(await reader.read(65536))
    for _ in range(5):
        tls.write(b"?nonsense\n")
    incoming.read()
    incoming.write(b"\x17\x03\x03\x00\x20" + bytes(32))
    with pytest.raises(ssl.SSLError, match="MAC"):
        tls.read(1)
    assert outgoing.pending > 5 * 10
    writer.write(outgoing.read())
    await until(lambda: served.counts.errors["bad_request"] == 5)
    for _ in range(3):
        await other.ask("?VERSION")
        assert (await other.record())["class"] == "VERSION"
    writer.close()
    await other.close()


def test_no_network_need_be_named_where_certificates_are_wanted() -> None:
    assert checked_networks("stream", "0.0.0.0", (), wants_certificates=True) == EVERYWHERE
    assert len(checked_networks("stream", "0.0.0.0", ("10.0.0.0/8",), wants_certificates=True)) == 1


# ---- HTTP ------------------------------------------------------------------------------------------------------------


async def test_metrics_over_https(keys: Path) -> None:
    errors: Counter[str] = Counter()
    server = HttpServer(
        host="127.0.0.1", port=0, allow=(), metrics=lambda: b"heaved_clients 3.0\n" * 20_000, alive=Verdict,
        ready=Verdict, count_client_error=lambda reason: errors.update([reason]),
        certificates=Certificates(params(keys)),
    )  # fmt: skip
    host, port = await server.start()
    url = f"https://localhost:{port}/metrics"
    connector = aiohttp.TCPConnector(ssl=client_context(keys), family=socket.AF_INET)
    async with aiohttp.ClientSession(connector=connector) as session:
        for _ in range(2):
            async with session.get(url) as response:
                assert await response.read() == b"heaved_clients 3.0\n" * 20_000
        async with session.post(url, data=b"x" * 1000) as response:
            assert response.status == 405
    async with aiohttp.ClientSession() as session:
        with pytest.raises(aiohttp.ClientError):
            await session.get(f"http://{host}:{port}/metrics")
    await until(lambda: errors["tls"])
    await server.close()
    assert set(errors) == {"tls"}


# ---- the files -------------------------------------------------------------------------------------------------------


FILES = {
    "no such file": (("nothing", "server", "ca"), "nothing.pem cannot be read"),
    "the key of another": (("server", "display", "ca"), "they must be a certificate and its own key"),
    "a key in place of an authority": (("server", "server", "../key"), "it must hold certificates, as PEM text"),
    "no authority": (("server", "server", "display"), "has no authority's certificate"),
}


@pytest.mark.parametrize("name", FILES)
def test_files_that_cannot_be_used(keys: Path, name: str) -> None:
    names, words = FILES[name]
    (keys.parent / "key.pem").write_bytes((keys / "server.key").read_bytes())
    with pytest.raises(ValueError, match=words):
        Certificates(params(keys, *names))


async def test_what_is_renewed_counts_for_those_who_come(serve: Serve, keys: Path) -> None:
    certificates = Certificates(params(keys))
    served = await serve(certificates=certificates)
    before = await met(served, client_context(keys))
    assert (await before.record())["class"] == "VERSION"
    with pytest.raises(ValueError, match="cannot be used"):
        certificates.renew(params(keys, key="display"))
    other = await met(served, client_context(keys))
    certificates.renew(params(keys, client_ca="foreign"))
    await refused(served, client_context(keys))
    assert (await other.record())["class"] == "VERSION"
    served.publish()
    assert (await before.record())["class"] == "MOTION"
    for peer in (before, other):
        await peer.close()


def test_dates_are_those_that_openssl_reads(keys: Path) -> None:
    certificates = Certificates(params(keys))
    assert OPENSSL is not None
    for span, name in zip(certificates.spans, ("server", "ca"), strict=True):
        said = subprocess.run(
            [OPENSSL, "x509", "-in", str(keys / f"{name}.pem"), "-noout", "-dates"],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        dates = dict(line.split("=") for line in said.stdout.splitlines())
        assert span.begins_s == ssl.cert_time_to_seconds(dates["notBefore"])
        assert span.ends_s == ssl.cert_time_to_seconds(dates["notAfter"])


def test_one_that_has_ended_is_said_and_starts(keys: Path) -> None:
    certificates = Certificates(params(keys, certificate="ended"))
    (caution,) = certificates.cautions(certificates.spans[0].begins_s + 60.0)
    assert caution.startswith("tls.certificate_file: the certificate has ended on ")


@pytest.mark.parametrize(
    ("days", "words"),
    [(-1.0, "set the clock"), (1.0, ""), (69.0, ""), (70.5, "in 30 days"), (99.6, "in 0 days"), (100.0, "has ended")],
)
def test_what_is_said_of_a_certificate(keys: Path, days: float, words: str) -> None:
    certificates = Certificates(params(keys))
    certificates.spans = (Span("certificate_file", 1e9, 1e9 + 100 * 86400.0),)
    found = certificates.cautions(1e9 + days * 86400.0)
    assert len(found) == bool(words)
    assert all(words in one for one in found)


def test_a_key_that_others_may_read(keys: Path, tmp_path: Path) -> None:
    open_key = tmp_path / "open.key"
    open_key.write_bytes((keys / "server.key").read_bytes())
    open_key.chmod(0o644)
    certificates = Certificates(params(keys, key=str(tmp_path / "open")))
    assert certificates.cautions(certificates.spans[0].begins_s) == [
        f"tls.key_file: others than its owner may read {open_key}: chmod 600 it"
    ]


async def test_what_needs_care_is_logged(keys: Path) -> None:
    certificates = Certificates(params(keys, certificate="ended"))
    with capture_logs() as logs:
        warning = asyncio.create_task(certificates.keep_warning())
        await asyncio.sleep(0)
        warning.cancel()
    assert [(line["event"], line["log_level"]) for line in logs] == [("tls certificates need care", "warning")]
