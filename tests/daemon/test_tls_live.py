"""A daemon that speaks TLS: stream and metrics alike, and certificates that are renewed while it runs."""

from __future__ import annotations

import asyncio
import ssl
from typing import TYPE_CHECKING

import msgspec
import pytest
from far_ends import needs_openssl
from running import demo_config, metric, running
from structlog.testing import capture_logs
from tls_keys import client_context, make_keys, params

from heaved.config import HttpParams, StreamParams
from heaved.daemon.daemon import Daemon
from heaved.outputs.listen import ListenError

if TYPE_CHECKING:
    from pathlib import Path

    from heaved.config import Config

pytestmark = needs_openssl


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    directory = tmp_path / "keys"
    directory.mkdir()
    make_keys(directory)
    return directory


def secured(tmp_path: Path, keys: Path) -> Config:
    return demo_config(
        tmp_path, device=(), tls=params(keys), stream=StreamParams(port=0, tls=True), http=HttpParams(port=0, tls=True)
    )


def written(path: Path, keys: Path) -> Path:
    files = params(keys)
    path.write_text(
        "[stream]\nport = 0\ntls = true\n[http]\nport = 0\ntls = true\n[tls]\n"
        + "".join(f'{key} = "{value}"\n' for key, value in msgspec.structs.asdict(files).items())
        + f'[correction]\nenabled = false\n[state]\ndirectory = "{path.parent / "state"}"\n'
    )
    return path


async def shown(daemon: Daemon, keys: Path) -> bytes:
    """The certificate that the daemon shows."""
    context = client_context(keys)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE  # It may have ended.
    _, writer = await asyncio.open_connection(*daemon.addresses["stream"], ssl=context, server_hostname="localhost")
    found: ssl.SSLObject = writer.get_extra_info("ssl_object")
    certificate = found.getpeercert(binary_form=True)
    writer.transport.abort()
    assert certificate is not None
    return certificate


async def answer(daemon: Daemon, keys: Path, path: str) -> bytes:
    context = client_context(keys)
    reader, writer = await asyncio.open_connection(*daemon.addresses["http"], ssl=context, server_hostname="localhost")
    writer.write(f"GET {path} HTTP/1.1\r\nHost: test\r\nConnection: close\r\n\r\n".encode())
    async with asyncio.timeout(20.0):
        found = await reader.read()
    writer.transport.abort()
    return found


def der(keys: Path, name: str) -> bytes:
    return ssl.PEM_cert_to_DER_cert((keys / f"{name}.pem").read_text())


async def test_a_renewed_certificate_counts_after_a_reload(tmp_path: Path, keys: Path) -> None:
    path = written(tmp_path / "heaved.toml", keys)
    async with running(secured(tmp_path, keys), path) as daemon:
        assert await shown(daemon, keys) == der(keys, "server")
        assert b"HTTP/1.1 200 OK" in await answer(daemon, keys, "/metrics")
        first_s = metric(daemon, 'heaved_certificate_end_timestamp_seconds{file="certificate_file"}')
        renewed = (keys / "ended.pem").read_text()
        (keys / "server.pem").write_text(renewed)
        with capture_logs() as logs:
            await daemon.reload()
        assert any("the certificate has ended on" in str(line.get("detail")) for line in logs), logs
        assert metric(daemon, 'heaved_certificate_end_timestamp_seconds{file="certificate_file"}') < first_s
        (keys / "server.pem").write_text((keys / "display.pem").read_text())
        with capture_logs() as logs:
            await daemon.reload()
        assert [line["event"] for line in logs] == ["new configuration refused, the old one stays"]
        assert "a certificate and its own key" in logs[0]["fault"]


async def test_files_that_are_changed_between_two_looks(tmp_path: Path, keys: Path) -> None:
    async with running(secured(tmp_path, keys)) as daemon:
        assert daemon._certificates is not None
        with capture_logs() as logs:
            await daemon._renew_certificates(daemon._certificates, params(keys, key="display"))
        assert [line["event"] for line in logs] == ["new certificates refused, the old ones stay"]
        assert await shown(daemon, keys) == der(keys, "server")


async def test_one_that_has_ended_keeps_nothing_from_starting(tmp_path: Path, keys: Path) -> None:
    config = msgspec.structs.replace(secured(tmp_path, keys), tls=params(keys, certificate="ended"))
    with capture_logs() as logs:
        async with running(config) as daemon:
            assert await shown(daemon, keys) == der(keys, "ended")
    assert sum("the certificate has ended on" in str(line.get("detail")) for line in logs) == 1


async def test_files_that_cannot_be_used_are_said_at_the_start(tmp_path: Path, keys: Path) -> None:
    config = msgspec.structs.replace(secured(tmp_path, keys), tls=params(keys, key="display"))
    with pytest.raises(ListenError, match=r"^\[tls\] .*a certificate and its own key"):
        Daemon(config)


async def test_without_tls_nothing_is_said_of_certificates(tmp_path: Path) -> None:
    async with running(demo_config(tmp_path, device=())) as daemon:
        assert b"heaved_certificate_end_timestamp_seconds{" not in daemon.metrics.render()
