"""The clients of a daemon that speaks TLS: the same as without, and every way in which the two do not agree is said."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import pytest
from far_ends import needs_openssl
from stream_peers import make_frame, make_status
from tls_keys import make_keys, params

from heaved.cli import main
from heaved.client.stream_client import Trouble, UnreachableError, fetch_status, wait_until_ready
from heaved.outputs.credentials import tls_context
from heaved.outputs.tls import Certificates

if TYPE_CHECKING:
    import ssl
    from collections.abc import Callable
    from pathlib import Path

    from stream_peers import Serve

pytestmark = needs_openssl


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("keys")
    make_keys(directory)
    return directory


def shown(keys: Path, ca: str = "ca", certificate: str = "display", key: str = "") -> ssl.SSLContext:
    names = (f"{ca}.pem", certificate and f"{certificate}.pem", certificate and f"{key or certificate}.key")
    return tls_context(*(str(keys / name) if name else "" for name in names))


async def test_status_and_wait(serve: Serve, keys: Path) -> None:
    served = await serve(certificates=Certificates(params(keys)))
    tls = shown(keys)

    async def while_frames_flow(ask: Callable[[], Any]) -> Any:
        asking = asyncio.create_task(asyncio.to_thread(ask))
        while not asking.done():
            served.publisher.publish(make_frame(served.clock.now_s))
            await asyncio.sleep(0.01)
        return await asking

    for host in ("localhost", "127.0.0.1"):
        snapshot = await while_frames_flow(lambda: fetch_status(host, served.port, 20.0, tls))  # noqa: B023
        assert snapshot.status == make_status()
    assert await while_frames_flow(lambda: wait_until_ready("127.0.0.1", served.port, 20.0, tls))


TROUBLES = {
    "no certificate": ({"certificate": ""}, Trouble.TLS, "it does not accept our certificate (tlsv13 alert"),
    "an old one": ({"certificate": "old", "key": "display"}, Trouble.TLS, "certificate expired): give one"),
    "of another authority": ({"certificate": "foreign"}, Trouble.TLS, "unknown ca): give one"),
    "another daemon": ({"ca": "foreign"}, Trouble.TLS, "its certificate is not accepted (self-signed certificate in"),
    "none at all": (None, Trouble.SILENT, "or it speaks TLS (--tls-ca)"),
}


@pytest.mark.parametrize("name", TROUBLES)
async def test_what_is_not_agreed_on_is_said(serve: Serve, keys: Path, name: str) -> None:
    changes, trouble, words = TROUBLES[name]
    served = await serve(certificates=Certificates(params(keys)))
    tls = shown(keys, **changes) if changes is not None else None
    with pytest.raises(UnreachableError) as caught:
        await asyncio.to_thread(fetch_status, "localhost", served.port, 1.0 if tls else 0.3, tls)
    assert (caught.value.trouble, words in str(caught.value)) == (trouble, True), str(caught.value)


async def test_a_name_that_the_certificate_is_not_for(serve: Serve, keys: Path) -> None:
    served = await serve(host="0.0.0.0", certificates=Certificates(params(keys)))
    with pytest.raises(UnreachableError, match="connect to a name or an address that it is for"):
        await asyncio.to_thread(fetch_status, "127.0.0.2", served.port, 1.0, shown(keys))


async def test_a_daemon_that_speaks_none(serve: Serve, keys: Path) -> None:
    served = await serve()
    with pytest.raises(UnreachableError, match="it does not speak TLS: leave out --tls-ca"):
        await asyncio.to_thread(fetch_status, "localhost", served.port, 1.0, shown(keys))


async def test_the_command_line(
    serve: Serve, keys: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    served = await serve(certificates=Certificates(params(keys)))
    asked = ["status", "--json", "--port", str(served.port)]
    files = [f"--tls-ca={keys}/ca.pem", f"--tls-cert={keys}/display.pem", f"--tls-key={keys}/display.key"]
    assert await asyncio.to_thread(main, [*asked, *files]) == 0
    assert '"reachable": true' in capfd.readouterr().out
    for name, file in (("CA", "ca.pem"), ("CERT", "display.pem"), ("KEY", "display.key")):
        monkeypatch.setenv(f"HEAVED_TLS_{name}", str(keys / file))
    assert await asyncio.to_thread(main, asked) == 0
    monkeypatch.setenv("HEAVED_TLS_KEY", str(keys / "server.key"))
    capfd.readouterr()
    assert await asyncio.to_thread(main, asked) == 1
    assert "they must be a certificate and its own key" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["status", "--tls-cert", "/c"], "--tls-cert, --tls-key: TLS is spoken with --tls-ca"),
        (["wait", "--tls-ca", "/c", "--tls-key", "/k"], "--tls-key: is the key of a certificate: give --tls-cert"),
        (["status", "--tls-ca", "/nowhere"], "/nowhere cannot be read"),
        (["page", "--cert", "/c"], "--cert, --key, --client-ca: https takes all three"),
    ],
)
def test_options_that_do_not_go_together(words: list[str], said: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 1
    assert said in capfd.readouterr().err
