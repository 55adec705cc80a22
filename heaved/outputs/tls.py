"""TLS for those who connect to us: what we show of ourselves and whose certificates we take, one set for all listeners,
read again when the daemon is told to; and when it ends.

A client must show a certificate that the client's authority has signed. What is wrong with one is found in the
handshake, before anything is said: see :mod:`heaved.outputs.tls_connection`.
"""

from __future__ import annotations

import asyncio
import re
import ssl
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec
import structlog

from heaved.outputs.credentials import READ_BY_OTHERS, server_context

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

SOON_DAYS: Final = 30
"""Whoever renews certificates is told so long before one ends, once a day."""
_DAY_S: Final = 86400.0
_PEM: Final = re.compile(r"-----BEGIN CERTIFICATE-----.*?-----END CERTIFICATE-----", re.DOTALL)
_VERSION: Final = 0xA0
_GENERALIZED_TIME: Final = 0x18
"""Tags of ASN.1 in a certificate (RFC 5280, section 4.1)."""
_VALIDITY: Final = 3
"""Its place after the version: behind number, algorithm and issuer."""

_log = structlog.get_logger(__name__)


class TlsParams(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[tls]``: the files for the tables with ``tls = true``; all three or none."""

    certificate_file: str = ""
    key_file: str = ""
    client_ca_file: str = ""


class Span(msgspec.Struct, frozen=True):
    """From when to when a certificate is good, UTC seconds since 1970."""

    key: str
    """That names its file."""
    begins_s: float
    ends_s: float


class Certificates:
    """What all listeners use, and replace together.

    Attributes:
        context: for connections that are made from now on.
        spans: of the certificates in the two files.
    """

    def __init__(self, params: TlsParams) -> None:
        """Read the files.

        Raises:
            ValueError: one cannot be used; says which, why and what to do.
        """
        self.renew(params)

    def renew(self, params: TlsParams) -> None:
        """Read the files again; with one that cannot be used, all stays as it was. Connections that there are go on.

        Raises:
            ValueError: as above.
        """
        context = server_context(params.certificate_file, params.key_file, params.client_ca_file)
        spans = tuple(
            Span(key, *_validity(pem))
            for key in ("certificate_file", "client_ca_file")
            for pem in _PEM.findall(Path(getattr(params, key)).read_text(encoding="utf-8", errors="replace"))
        )
        is_open = bool(Path(params.key_file).stat().st_mode & READ_BY_OTHERS)
        self.context, self.spans, self._key_file, self._is_open = context, spans, params.key_file, is_open

    def cautions(self, now_s: float) -> list[str]:
        """What works today and is to be looked after, beginning with the key; ``now_s``: UTC, seconds since 1970."""
        found = [caution for span in self.spans if (caution := _caution(span, now_s))]
        if self._is_open:
            found.append(f"tls.key_file: others than its owner may read {self._key_file}: chmod 600 it")
        return found

    def warn(self, now_s: float) -> None:
        """Log the cautions."""
        for caution in self.cautions(now_s):
            _log.warning("tls certificates need care", detail=caution)

    async def keep_warning(self, utc_s: Callable[[], float] = time.time) -> None:
        """Log them now, and once a day for ever."""
        while True:
            self.warn(utc_s())
            await asyncio.sleep(_DAY_S)


def _caution(span: Span, now_s: float) -> str:
    renew = "renew it, then: systemctl reload heaved"
    if now_s >= span.ends_s:
        return f"tls.{span.key}: the certificate has ended on {_day(span.ends_s)}, who needs it cannot connect: {renew}"
    if now_s < span.begins_s:
        begins, today = _day(span.begins_s), _day(now_s)
        return f"tls.{span.key}: the certificate begins on {begins}, and here it is {today}: set the clock, or renew it"
    days = (span.ends_s - now_s) / _DAY_S
    if days < SOON_DAYS:
        return f"tls.{span.key}: the certificate ends on {_day(span.ends_s)}, in {days:.0f} days: {renew}"
    return ""


def _day(utc_s: float) -> str:
    return datetime.fromtimestamp(utc_s, UTC).strftime("%Y-%m-%d")


# ---- what the ssl module does not tell of a certificate of our own ---------------------------------------------------


def _validity(pem: str) -> tuple[float, float]:
    """From when to when a certificate is good (RFC 5280, section 4.1.2.5), UTC seconds since 1970.

    Raises:
        ValueError: it is none.
    """
    try:
        (_, certificate), *_ = _elements(ssl.PEM_cert_to_DER_cert(pem))
        (_, signed), *_ = _elements(certificate)
        fields = [content for tag, content in _elements(signed) if tag != _VERSION]
        begins_s, ends_s = [_utc_s(tag, content) for tag, content in _elements(fields[_VALIDITY])]
    except (IndexError, ValueError, UnicodeDecodeError) as error:
        raise ValueError(f"a certificate without a validity: {error}") from error
    return begins_s, ends_s


def _elements(der: bytes) -> Iterator[tuple[int, bytes]]:
    """Tag and content of each element (X.690, section 8.1)."""
    at = 0
    while at < len(der):
        tag, length = der[at], der[at + 1]
        at += 2
        if length & 0x80:
            size = length & 0x7F
            length = int.from_bytes(der[at : at + size], "big")
            at += size
        yield tag, der[at : at + length]
        at += length


def _utc_s(tag: int, content: bytes) -> float:
    form = "%Y%m%d%H%M%SZ" if tag == _GENERALIZED_TIME else "%y%m%d%H%M%SZ"
    found = datetime.strptime(content.decode("ascii"), form).replace(tzinfo=UTC)
    if tag != _GENERALIZED_TIME and found.year >= 2050:  # "50" to "99" are of the last century.
        found = found.replace(year=found.year - 100)
    return found.timestamp()
