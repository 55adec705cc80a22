"""The daemon's stream, followed through its restarts for as long as the page is served."""

from __future__ import annotations

import asyncio
import os
import ssl
import time
from math import inf
from typing import TYPE_CHECKING, Final, Protocol

import msgspec
import structlog

from heaved.client.stream_client import SILENCE_S, Trouble, UnreachableError, explain_tls
from heaved.host_name import HostName
from heaved.outputs import wire
from heaved.outputs.records import (
    PROTO_MAJOR,
    DelayedRecord,
    ErrorRecord,
    MotionRecord,
    QuietRecord,
    SeaRecord,
    StatusRecord,
    VersionRecord,
)
from heaved.text import printable

if TYPE_CHECKING:
    from collections.abc import Callable

RATE_HZ: Final = 20.0
"""MOTION lines a second that are asked for: a screen shows no more, and a wave of 2 s is still smooth."""
_WATCH: Final = b'?WATCH={"classes":["MOTION","SEA","DELAYED","QUIET","STATUS"],"rate_hz":%g}\n?STATUS\n' % RATE_HZ
_RETRY_S: Final = 0.5
_CONNECT_S: Final = 2.0
_MAX_LINE_BYTES: Final = 1 << 20
"""A STATUS line of many devices has some 10 kB."""
_CLOCK_WINDOW_S: Final = 30.0
"""For so long, at the least, the quickest line tells how the daemon's clock stands to ours. Two clocks of two machines
part by some 50 ppm, which is 1.5 ms meanwhile."""

Known = MotionRecord | SeaRecord | DelayedRecord | QuietRecord | StatusRecord
_RECORDS: Final[dict[str, type[msgspec.Struct]]] = {
    str(kind.__struct_config__.tag): kind
    for kind in (MotionRecord, SeaRecord, DelayedRecord, QuietRecord, StatusRecord, VersionRecord, ErrorRecord)
}

_log = structlog.get_logger(__name__)


class Link(msgspec.Struct, frozen=True, kw_only=True):
    """How the connection to the daemon fares."""

    stream: str
    """Where the daemon is looked for."""
    is_up: bool = False
    trouble: str = "connecting"
    """Why not, and what to do; empty when it is up."""
    release: str = ""
    """Of the daemon."""
    connections: int = 0
    """Times that it came up."""


class Audience(Protocol):
    """Who is told what the stream says."""

    def link(self, link: Link) -> None:
        """The connection has come up or is lost."""

    def hear(self, record: Known, line: bytes, at_s: float) -> None:
        """One record, and its line as it came, on one line whatever stands in it.

        ``at_s``: for MOTION and DELAYED their validity, for others when they were read; on our monotonic clock.
        """


class DaemonClock:
    """How the daemon's monotonic clock stands to ours, by the line that was least long on its way.

    What is later than that by our clock was held up, by the network or by ourselves: its age counts from when it was
    valid all the same. Pure: times are arguments.
    """

    def __init__(self) -> None:
        self._least_s = self._former_s = inf
        self._since_s = -inf

    def offset_s(self, motion: MotionRecord, read_s: float) -> float:
        """Ours minus the daemon's, as it is known with this line, read at ``read_s`` of ours."""
        if read_s - self._since_s > _CLOCK_WINDOW_S:
            self._former_s, self._least_s, self._since_s = self._least_s, inf, read_s
        self._least_s = min(self._least_s, read_s - (motion.age_s or 0.0) - motion.mono_s)
        return min(self._least_s, self._former_s)


class Follower:
    """Tells an audience what the stream says."""

    def __init__(
        self,
        host: str,
        port: int,
        audience: Audience,
        clock: Callable[[], float] = time.monotonic,
        tls: ssl.SSLContext | None = None,
    ) -> None:
        """``host`` and ``port``: of the daemon's stream; ``tls``: None where it speaks none."""
        self._where = f"{host}:{port}"
        self._tls, self._name = tls, host
        self._host, self._port = HostName(host), port
        self._audience = audience
        self._clock = clock
        self._link = Link(stream=self._where)

    async def run(self) -> None:
        """Follow it until cancelled."""
        self._audience.link(self._link)
        while True:
            try:
                await self._follow()
            except UnreachableError as error:
                self._lost(str(error))
            await asyncio.sleep(_RETRY_S)

    async def _follow(self) -> None:
        """One connection, until it is lost.

        Raises:
            UnreachableError: it is.
        """
        reader, writer = await self._connect()
        try:
            version = self._checked((await self._record(reader))[0])
            writer.write(_WATCH)
            self._came_up(version)
            await self._tell(reader)
        finally:
            writer.transport.abort()

    async def _connect(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        try:
            addresses = await self._host.addresses(_CONNECT_S)
        except (OSError, UnicodeError) as error:  # The latter for what no host can be called.
            raise UnreachableError(Trouble.NO_ADDRESS, f"{self._where}: no such host: {error}") from error
        failure: OSError = TimeoutError()
        for address in addresses:
            try:
                async with asyncio.timeout(_CONNECT_S):
                    return await asyncio.open_connection(
                        address, self._port, limit=_MAX_LINE_BYTES, ssl=self._tls,
                        server_hostname=self._name if self._tls is not None else None,
                    )  # fmt: skip
            except OSError as error:
                failure = error
        if isinstance(failure, ssl.SSLError):
            raise UnreachableError(Trouble.TLS, f"{self._where}: {explain_tls(failure)}") from failure
        if isinstance(failure, TimeoutError):
            raise UnreachableError(Trouble.SILENT, f"{self._where}: no answer to the connection: is the host up?")
        reason = os.strerror(failure.errno) if failure.errno else failure  # asyncio puts its own words into strerror.
        raise UnreachableError(
            Trouble.REFUSED, f"{self._where}: {reason}: is heaved running, and with this [stream] port?"
        ) from failure

    async def _tell(self, reader: asyncio.StreamReader) -> None:
        """Hand on what comes.

        Raises:
            UnreachableError: nothing more does.
        """
        clock, offset_s = DaemonClock(), None
        while True:
            record, line = await self._record(reader)
            now_s = self._clock()
            match record:
                case MotionRecord():
                    offset_s = clock.offset_s(record, now_s)
                    self._audience.hear(record, line, record.mono_s + offset_s)
                case DelayedRecord():
                    if offset_s is not None:  # Else there is no telling when it was.
                        self._audience.hear(record, line, record.mono_s + offset_s)
                case SeaRecord() | QuietRecord() | StatusRecord():
                    self._audience.hear(record, line, now_s)
                case ErrorRecord():
                    raise self._turned_away(record)

    async def _record(self, reader: asyncio.StreamReader) -> tuple[msgspec.Struct | None, bytes]:
        """The next record, None for a class that is not known, and its line.

        Raises:
            UnreachableError: there is none, or it is not of the stream.
        """
        try:
            async with asyncio.timeout(SILENCE_S):
                line = await reader.readline()
        except TimeoutError as error:
            message = f"{self._where}: nothing said for {SILENCE_S:g} s: the daemon hangs, or the network is gone"
            raise UnreachableError(Trouble.SILENT, message) from error
        except ValueError as error:
            raise UnreachableError(
                Trouble.NOT_HEAVED, f"{self._where}: not a heaved daemon: a line without end"
            ) from error
        except ssl.SSLError as error:
            raise UnreachableError(Trouble.TLS, f"{self._where}: {explain_tls(error)}") from error
        except OSError as error:
            message = f"{self._where}: connection lost: {error.strerror or error}"
            raise UnreachableError(Trouble.CLOSED, message) from error
        if not line.endswith(b"\n"):
            raise UnreachableError(Trouble.CLOSED, f"{self._where}: the daemon closed the connection")
        return self._decoded(line), line.strip().replace(b"\r", b" ")

    def _decoded(self, line: bytes) -> msgspec.Struct | None:
        try:
            fields = wire.decode(line)
            kind = _RECORDS.get(fields["class"])
            return None if kind is None else msgspec.convert(fields, kind)
        except (ValueError, msgspec.ValidationError) as error:
            raise UnreachableError(Trouble.NOT_HEAVED, f"{self._where}: not a heaved daemon: {error}") from error

    def _checked(self, record: msgspec.Struct | None) -> VersionRecord:
        """What a connection begins with.

        Raises:
            UnreachableError: it is not the VERSION of a daemon that we understand.
        """
        if isinstance(record, ErrorRecord):
            raise self._turned_away(record)
        if not isinstance(record, VersionRecord):
            raise UnreachableError(Trouble.NOT_HEAVED, f"{self._where}: not a heaved daemon: no VERSION at first")
        if record.proto_major != PROTO_MAJOR:
            spoken = f"protocol {record.proto_major} (release {record.release}), this program {PROTO_MAJOR}"
            message = f"{self._where}: the daemon speaks {spoken}: update the older one"
            raise UnreachableError(Trouble.NOT_HEAVED, message)
        return record

    def _turned_away(self, error: ErrorRecord) -> UnreachableError:
        return UnreachableError(Trouble.TURNED_AWAY, f"{self._where}: the daemon says: {error.message}")

    def _came_up(self, version: VersionRecord) -> None:
        self._link = Link(
            stream=self._where,
            is_up=True,
            trouble="",
            release=printable(version.release),
            connections=self._link.connections + 1,
        )
        _log.info("stream connected", stream=self._where, release=self._link.release)
        self._audience.link(self._link)

    def _lost(self, trouble: str) -> None:
        if self._link.is_up or trouble != self._link.trouble:
            _log.warning("stream not connected: trying again", stream=self._where, reason=trouble)
            self._link = msgspec.structs.replace(self._link, is_up=False, trouble=trouble)
            self._audience.link(self._link)
