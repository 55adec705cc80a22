"""Certificates as the manual has them made, and some that nobody should take."""

from __future__ import annotations

import re
import ssl
import subprocess
from typing import TYPE_CHECKING, Final

from far_ends import OPENSSL

from heaved.manual.topics import topics
from heaved.outputs.tls import TlsParams

if TYPE_CHECKING:
    from pathlib import Path

_BLOCK: Final = re.compile(r"^```console\n(\$ openssl .*?)^```$", re.MULTILINE | re.DOTALL)


def make_keys(directory: Path) -> None:
    """``ca``, ``server`` and ``display`` by the commands of the manual; signed by ``ca`` for the display's request also
    ``old``, which has ended, and ``young``, a server's that has ended; ``foreign``, of an authority of its own.
    """
    (block,) = _BLOCK.findall(topics()["security"].source)
    for command in block.splitlines():
        _run(directory, command.removeprefix("$ "))
    signed = "-copy_extensions copyall -CA ca.pem -CAkey ca.key -CAcreateserial"
    for name, request in (("old", "display"), ("ended", "server")):
        _run(directory, f"openssl x509 -req -in {request}.csr {signed} -days -1 -out {name}.pem")
    key = "-newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes"
    _run(directory, f'openssl req -x509 {key} -days 2 -subj "/CN=x" -keyout foreign.key -out foreign.pem')
    for file in directory.glob("*.key"):
        file.chmod(0o600)


def _run(directory: Path, command: str) -> None:
    assert OPENSSL is not None
    subprocess.run(["bash", "-c", command], cwd=directory, check=True, capture_output=True, timeout=60)


def params(keys: Path, certificate: str = "server", key: str = "server", client_ca: str = "ca") -> TlsParams:
    """``[tls]`` with those files."""
    return TlsParams(
        certificate_file=str(keys / f"{certificate}.pem"),
        key_file=str(keys / f"{key}.key"),
        client_ca_file=str(keys / f"{client_ca}.pem"),
    )


def client_context(keys: Path, certificate: str = "display", key: str = "") -> ssl.SSLContext:
    """Of a client that shows that certificate; empty: none."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.load_verify_locations(keys / "ca.pem")
    if certificate:
        context.load_cert_chain(keys / f"{certificate}.pem", keys / f"{key or certificate}.key")
    return context
