"""Passwords and certificates, which stand in files of their own: read anew for each connection, so that one that is
renewed counts without a restart.
"""

from __future__ import annotations

import ssl
from pathlib import Path
from typing import TYPE_CHECKING, Final

from heaved.links import explain_no_connection

if TYPE_CHECKING:
    from heaved.links import ServiceLink

MOST_BYTES: Final = 65536
"""More is no password."""
READ_BY_OTHERS: Final = 0o044
"""Bits of a file's mode."""


def read_secret(file: str) -> str:
    """The password or token in a file, without the end of its line.

    Raises:
        ValueError: there is none; says why and what to do.
    """
    try:
        with Path(file).open("rb") as opened:
            text = opened.read(MOST_BYTES + 1).decode()
    except OSError as error:
        raise ValueError(f"{file} cannot be read ({error.strerror or error}): {_ACCESS}") from error
    except UnicodeDecodeError:
        raise ValueError(f"{file} is not text: it must hold the secret and nothing else") from None
    secret = text.rstrip("\r\n")
    if not secret or len(text) > MOST_BYTES or "\n" in secret or "\0" in secret:
        raise ValueError(f"{file} must hold one line, the secret and nothing else")
    return secret


def tls_context(ca_file: str, certificate_file: str = "", key_file: str = "") -> ssl.SSLContext:
    """Settings of a connection whose far end must show a certificate for its host's name, signed by one of ``ca_file``
    (empty: those that the system trusts). ``certificate_file`` and ``key_file``: what we show of ourselves.

    Raises:
        ValueError: a file cannot be used; says why and what to do.
    """
    for file in (ca_file, certificate_file, key_file):
        if file:
            _must_be_readable(file)
    try:
        context = ssl.create_default_context(cafile=ca_file or None)
    except (ssl.SSLError, OSError) as error:
        raise ValueError(f"{ca_file or 'the trusted certificates'} cannot be used ({_said(error)}): {_PEM}") from error
    if certificate_file:
        _show(context, certificate_file, key_file)
    return context


def server_context(certificate_file: str, key_file: str, client_ca_file: str) -> ssl.SSLContext:
    """Settings of connections that are made to us, by who must show a certificate signed by one of ``client_ca_file``;
    ``certificate_file`` and ``key_file``: what we show of ourselves.

    Raises:
        ValueError: a file cannot be used; says why and what to do.
    """
    for file in (certificate_file, key_file, client_ca_file):
        _must_be_readable(file)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.verify_mode = ssl.CERT_REQUIRED
    # A session that is taken up again would not show its certificate again, which may have ended meanwhile.
    context.options |= ssl.OP_NO_TICKET | ssl.OP_NO_RENEGOTIATION
    context.num_tickets = 0
    try:
        context.load_verify_locations(client_ca_file)
    except (ssl.SSLError, OSError) as error:
        raise ValueError(f"{client_ca_file} cannot be used ({_said(error)}): {_PEM}") from error
    if not context.get_ca_certs():
        raise ValueError(f"{client_ca_file} has no authority's certificate: it must hold that of who signs for clients")
    _show(context, certificate_file, key_file)
    return context


def _show(context: ssl.SSLContext, certificate_file: str, key_file: str) -> None:
    try:
        # Without a password of ours, OpenSSL would ask for one at the terminal.
        context.load_cert_chain(certificate_file, key_file or None, password=lambda: "")
    except (ssl.SSLError, OSError) as error:
        both = f"{certificate_file} and {key_file or 'the key in it'}"
        raise ValueError(
            f"{both} cannot be used ({_said(error)}): they must be a certificate and its own key, as PEM text, the "
            "key without a password"
        ) from error


def explain_tls(link: ServiceLink, error: BaseException, served: str) -> str:
    """As :func:`heaved.links.explain_no_connection`, where there may be TLS."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return (
            f"the certificate of {link.host} is not accepted ({error.verify_message}): set ca_file to that of the "
            "authority that signed it, and link to a name that it is for"
        )
    is_handshake = "handshake" in str(error)
    if isinstance(error, ssl.SSLError) or is_handshake or isinstance(error, ConnectionResetError):
        plain = link.scheme.removesuffix("s")
        reason = "it does not answer" if is_handshake and isinstance(error, TimeoutError) else str(error)
        return (
            f"no TLS with {link.host} ({reason}): check that port {link.port} is one with TLS ({plain}:// is without), "
            "and whether it wants a certificate of ours (certificate_file)"
        )
    return explain_no_connection(link.host, error, served)


def _must_be_readable(file: str) -> None:
    try:
        with Path(file).open("rb"):
            pass
    except OSError as error:
        raise ValueError(f"{file} cannot be read ({error.strerror or error}): {_ACCESS}") from error


def _said(error: OSError) -> str:
    if isinstance(error, ssl.SSLError):
        return (error.reason or "it cannot be decoded").lower().replace("_", " ")
    return error.strerror or str(error)


_ACCESS: Final = "check the path, and that the daemon's user may read it"
_PEM: Final = "it must hold certificates, as PEM text"
