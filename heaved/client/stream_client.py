"""The other end of the stream, for ``heaved status``, ``wait`` and ``watch``: plain sockets, or TLS where the daemon
speaks it, always with a deadline.
"""

from __future__ import annotations

import contextlib
import socket
import ssl
import time
from enum import Enum
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.outputs.records import PROTO_MAJOR, MotionRecord, StatusRecord, VersionRecord
from heaved.outputs.wire import decode
from heaved.samples import HeaveState
from heaved.text import printable_lines

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_MAX_LINE_BYTES: Final = 1 << 20
"""A STATUS line of many devices has some 10 kB; what sends more without a line end is no daemon of ours."""
_RETRY_S: Final = 0.25
SILENCE_S: Final = 3.0
"""A connection on which nothing comes for so long is given up and made anew: its other end may be gone."""


class Trouble(Enum):
    """Why there is no answer."""

    NO_ADDRESS = "no such host"
    REFUSED = "nobody listens"
    SILENT = "no answer"
    CLOSED = "connection closed"
    TURNED_AWAY = "turned away"
    NOT_HEAVED = "not a heaved daemon"
    TLS = "no agreement on TLS"


class UnreachableError(Exception):
    """The daemon cannot be reached, or what answers is not one. The message says where, what and what to do."""

    def __init__(self, trouble: Trouble, message: str) -> None:
        super().__init__(printable_lines(message))  # The other end may have a part in it.
        self.trouble = trouble


class Snapshot(msgspec.Struct, frozen=True, kw_only=True):
    """What the daemon said of itself."""

    version: VersionRecord
    status: StatusRecord
    motion: MotionRecord | None
    """The first frame that came; None: none came in time."""


class StreamConnection:
    """A connection to the stream. Use as a context manager."""

    def __init__(
        self,
        host: str,
        port: int,
        *,
        deadline_s: float,
        tls: ssl.SSLContext | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Connect and read the daemon's VERSION; ``tls``: None where the daemon speaks none.

        Raises:
            UnreachableError: not by ``deadline_s`` (on ``clock``), or the daemon speaks another protocol.
        """
        self._where = f"{host}:{port}"
        self._clock = clock
        self._tls = tls
        self._rest = b""
        self._lines: Iterator[bytes] = iter(())
        self._socket = self._connect(host, port, deadline_s)
        try:
            if tls is not None:
                self._socket = self._secure(tls, host, deadline_s)
            self.version = self._greeting(deadline_s)
        except BaseException:
            self._socket.close()
            raise

    def __enter__(self) -> StreamConnection:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def send(self, request: str) -> None:
        """Send one request line."""
        with contextlib.suppress(OSError):  # That the connection is gone shows on reading.
            self._socket.sendall(request.encode() + b"\n")

    def read(self, deadline_s: float) -> VersionRecord | MotionRecord | StatusRecord | None:
        """The next record of those classes (others are passed over); None when there is none by ``deadline_s``.

        Raises:
            UnreachableError: the connection is gone, the daemon turned us away, or what comes is not the stream.
        """
        while True:
            for line in self._lines:
                record = decode_record(line, self._where)
                if record is not None:
                    return record
            remaining_s = deadline_s - self._clock()
            if remaining_s <= 0.0:
                return None
            self._receive(remaining_s)

    def _receive(self, timeout_s: float) -> None:
        self._socket.settimeout(timeout_s)
        try:
            data = self._socket.recv(65536)
        except (TimeoutError, ssl.SSLWantReadError):
            return
        except ssl.SSLError as error:  # Of a handshake, too: whether our certificate is taken shows here.
            raise UnreachableError(Trouble.TLS, f"{self._where}: {explain_tls(error)}") from error
        except OSError as error:
            raise UnreachableError(
                Trouble.CLOSED, f"{self._where}: connection lost: {error.strerror or error}"
            ) from error
        if not data:
            raise UnreachableError(Trouble.CLOSED, f"{self._where}: the daemon closed the connection")
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > _MAX_LINE_BYTES:
            raise UnreachableError(Trouble.NOT_HEAVED, f"{self._where}: not a heaved daemon: a line without end")
        self._lines = iter(lines)

    def _greeting(self, deadline_s: float) -> VersionRecord:
        record = self.read(deadline_s)
        if record is None:
            advice = "it hangs, or something else listens there"
            if self._tls is None:
                advice = f"{advice}, or it speaks TLS (--tls-ca)"
            raise UnreachableError(Trouble.SILENT, f"{self._where}: connected, but nothing is said: {advice}")
        if not isinstance(record, VersionRecord):
            raise UnreachableError(Trouble.NOT_HEAVED, f"{self._where}: not a heaved daemon: no VERSION at first")
        if record.proto_major != PROTO_MAJOR:
            versions = f"protocol {record.proto_major} (release {record.release}), this program {PROTO_MAJOR}"
            raise UnreachableError(
                Trouble.NOT_HEAVED, f"{self._where}: the daemon speaks {versions}: update the older one"
            )
        return record

    def _connect(self, host: str, port: int, deadline_s: float) -> socket.socket:
        try:
            addresses = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        except (OSError, UnicodeError) as error:  # The latter for what no host can be called.
            message = f"{self._where}: no such host: {error}"
            raise UnreachableError(Trouble.NO_ADDRESS, message) from error
        failure: OSError = TimeoutError("timed out")
        for family, kind, protocol, _, address in addresses:
            connection = socket.socket(family, kind, protocol)
            connection.settimeout(max(0.001, deadline_s - self._clock()))
            try:
                connection.connect(address)
            except OSError as error:
                failure = error
                connection.close()
            else:
                return connection
        if isinstance(failure, TimeoutError):
            raise UnreachableError(Trouble.SILENT, f"{self._where}: no answer to the connection: is the host up?")
        message = f"{self._where}: {failure.strerror or failure}: is heaved running, and with this [stream] port?"
        raise UnreachableError(Trouble.REFUSED, message) from failure

    def _secure(self, tls: ssl.SSLContext, host: str, deadline_s: float) -> ssl.SSLSocket:
        self._socket.settimeout(max(0.001, deadline_s - self._clock()))
        try:
            return tls.wrap_socket(self._socket, server_hostname=host)
        except TimeoutError as error:
            raise UnreachableError(
                Trouble.SILENT, f"{self._where}: connected, but no TLS is spoken: it hangs, or is busy"
            ) from error
        except OSError as error:
            raise UnreachableError(Trouble.TLS, f"{self._where}: {explain_tls(error)}") from error


def explain_tls(error: OSError) -> str:
    """What came of TLS, for who looks after this end of it."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return (
            f"its certificate is not accepted ({error.verify_message}): give the authority that signed it (--tls-ca), "
            "and connect to a name or an address that it is for"
        )
    reason = (error.reason if isinstance(error, ssl.SSLError) else "") or ""
    if "ALERT" in reason and ("CERT" in reason or "_CA" in reason):
        said = reason.lower().replace("_", " ")
        return f"it does not accept our certificate ({said}): give one that its authority has signed (--tls-cert)"
    if reason in ("WRONG_VERSION_NUMBER", "PACKET_LENGTH_TOO_LONG"):
        return "it does not speak TLS: leave out --tls-ca"
    return f"no TLS: {reason.lower().replace('_', ' ') or error.strerror or error}"


def decode_record(line: bytes, where: str) -> VersionRecord | MotionRecord | StatusRecord | None:
    """One line as a record; None for a class that is not for us.

    Raises:
        UnreachableError: the line is not of the stream, or is an ERROR.
    """
    try:
        fields = decode(line)
        match fields["class"]:
            case "VERSION":
                return msgspec.convert(fields, VersionRecord)
            case "MOTION":
                return msgspec.convert(fields, MotionRecord)
            case "STATUS":
                return msgspec.convert(fields, StatusRecord)
            case "ERROR":
                raise UnreachableError(Trouble.TURNED_AWAY, f"{where}: the daemon says: {fields.get('message')}")
            case _:
                return None
    except (ValueError, msgspec.ValidationError) as error:
        raise UnreachableError(Trouble.NOT_HEAVED, f"{where}: not a heaved daemon: {error}") from error


def fetch_status(host: str, port: int, timeout_s: float = 0.5, tls: ssl.SSLContext | None = None) -> Snapshot:
    """Ask the daemon for its state, and wait for one frame as well; returns by ``timeout_s``, whatever happens.

    Raises:
        UnreachableError: no daemon, or no STATUS in time.
    """
    deadline_s = time.monotonic() + timeout_s
    status: StatusRecord | None = None
    motion: MotionRecord | None = None
    with StreamConnection(host, port, deadline_s=deadline_s, tls=tls) as connection:
        connection.send("?STATUS")
        while (status is None or motion is None) and (record := connection.read(deadline_s)) is not None:
            if isinstance(record, StatusRecord):
                status = record
            elif isinstance(record, MotionRecord):
                motion = record
        if status is None:
            raise UnreachableError(Trouble.SILENT, f"{host}:{port}: connected, but ?STATUS is not answered")
        return Snapshot(version=connection.version, status=status, motion=motion)


def is_ready(motion: MotionRecord, fresh_s: float = 1.0) -> bool:
    """Whether a compensator may start on this frame: its heave is an estimate to be used (valid, or degraded but with
    a standard deviation that says so; not settling, not invalid), and it is no older than ``fresh_s``.
    """
    usable = motion.quality.heave in (HeaveState.VALID, HeaveState.DEGRADED) and motion.heave_m is not None
    return usable and motion.age_s is not None and motion.age_s <= fresh_s


def wait_until_ready(host: str, port: int, timeout_s: float, tls: ssl.SSLContext | None = None) -> bool:
    """Wait for a frame that :func:`is_ready`; False when there is none by ``timeout_s``.

    The daemon may start, restart or be unreachable meanwhile: only time ends the wait.
    """
    deadline_s = time.monotonic() + timeout_s
    while time.monotonic() < deadline_s:
        try:
            with StreamConnection(host, port, deadline_s=_patience_s(deadline_s), tls=tls) as connection:
                while (record := connection.read(_patience_s(deadline_s))) is not None:
                    if isinstance(record, MotionRecord) and is_ready(record):
                        return True
        except UnreachableError:
            time.sleep(max(0.0, min(_RETRY_S, deadline_s - time.monotonic())))
    return False


def _patience_s(deadline_s: float) -> float:
    return min(deadline_s, time.monotonic() + SILENCE_S)
