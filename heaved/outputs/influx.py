"""``[influx]``: what the daemon says as points of a time series database, in InfluxDB's line protocol.

Over HTTP (InfluxDB 1, 2 and 3, VictoriaMetrics, Telegraf), or over UDP (InfluxDB 1, Telegraf's socket listener), where
nobody says whether it was taken. Lines are sent in batches; while the database is away they are kept, as many as the
configuration allows, then the oldest are dropped and counted: memory is worth more than a plot without a gap.
"""

from __future__ import annotations

import asyncio
import socket
from base64 import b64encode
from collections import deque
from contextlib import suppress
from importlib import import_module
from itertools import islice
from math import inf
from typing import TYPE_CHECKING, Annotated, Final

import msgspec

from heaved.host_name import HostName
from heaved.links import explain_no_connection, parse_service_link
from heaved.outputs.credentials import explain_tls, read_secret, tls_context
from heaved.outputs.line_protocol import Lines
from heaved.outputs.output import OutputHealth, Told
from heaved.outputs.slower import Slower

if TYPE_CHECKING:
    import ssl

    import aiohttp

    from heaved.samples import MotionFrame

PORTS: Final = {"http": 8086, "https": 8086, "udp": 8089}

_ANSWER_S: Final = 10.0
_LOOK_UP_S: Final = 5.0
_GOODBYE_S: Final = 0.25
"""What may be spent on what is left when it is stopped."""
_LONGEST_PAUSE_S: Final = 30.0
_STATUS_PERIOD_S: Final = 10.0
_MOST_LINES: Final = 500
"""Of one request. InfluxDB advises 5000, but writing so much at once would hold the loop up for milliseconds."""
_DATAGRAM_BYTES: Final = 1432
"""Fits an Ethernet frame, IPv6 and a tunnel's header included: a larger one is lost with any of its fragments."""
_MESSAGE_BYTES: Final = 500
"""Of a server's answer that is said."""
_KEPT: Final = (401, 403, 404, 408, 429)
"""Refusals that are cured at the far end or in a file (a token, a database, a limit): the lines wait for that."""

Name = Annotated[str, msgspec.Meta(pattern=r"^[^\x00-\x1f\x7f\\]{0,128}\Z")]


class InfluxParams(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[influx]``: points of a time series database."""

    enabled: bool = False
    link: str = "http://127.0.0.1:8086"
    """``http://host:8086``, ``https://host:8086`` or ``udp://host:8089``."""
    database: Name = "heaved"
    """Of InfluxDB 1."""
    org: Name = ""
    bucket: Name = ""
    """Of InfluxDB 2; with it the database does not count."""
    token_file: str = ""
    username: str = ""
    """Of InfluxDB 1, with a password."""
    password_file: str = ""
    ca_file: str = ""
    """Empty: what the system trusts."""
    measurement: Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_.-]{1,64}\Z")] = "heaved"
    """What the names of all measurements begin with."""
    tags: dict[Name, Name] = {}
    """Put to every line, beside ``host``."""
    rate_hz: Annotated[float, msgspec.Meta(gt=0, le=100)] = 1.0
    batch_s: Annotated[float, msgspec.Meta(ge=0.1, le=60)] = 1.0
    most_lines: Annotated[int, msgspec.Meta(ge=100, le=1_000_000)] = 50_000
    """Kept while the database is away."""


class Refused(Exception):  # It is an answer, not an error of ours.  # noqa: N818
    """The database did not take the lines, and said why."""

    def __init__(self, status: int, detail: str) -> None:
        super().__init__(detail)
        self.status = status

    @property
    def is_lasting(self) -> bool:
        """Whether it never will: something is wrong with the lines themselves."""
        return 400 <= self.status < 500 and self.status not in _KEPT


class InfluxOutput:
    """Lines that wait, and the way to the database.

    Attributes:
        health: how it fares; it counts lines. Lost by reason: ``full``, as many as are kept waited already;
            ``refused``, the database said what is wrong with them.
    """

    def __init__(self, params: InfluxParams, told: Told) -> None:
        """
        Raises:
            ValueError: the link cannot be understood.
        """
        self._params = params
        self._link = parse_service_link(params.link, PORTS)
        self._status, self._utc_s, self._clock = told.status, told.utc_s, told.clock
        self._slower = Slower(params.rate_hz)
        self._lines = Lines(params.measurement, {"host": socket.gethostname(), **params.tags})
        self._waiting: deque[bytes] = deque()
        self._host = HostName(self._link.host)
        self._status_s = -inf
        self._refused_with = 0
        self.health = OutputHealth("influx", "InfluxDB lines", str(self._link))

    def publish(self, frame: MotionFrame) -> None:
        """Take a frame; its lines wait for the next batch."""
        if not self._slower.wants(frame):
            return
        self._put(self._lines.motion(frame, self._utc_s(frame.t_s)))
        for name, found in self._slower.news(frame):
            self._put(self._lines.slow[name](found, self._utc_s(found.t_s)))

    async def run(self) -> None:
        """Send what waits, batch by batch, for ever; when cancelled, send what is left if that is soon done."""
        await (self._run_udp() if self._link.scheme == "udp" else self._run_http())

    def _put(self, lines: list[bytes]) -> None:
        self._waiting += lines
        while len(self._waiting) > self._params.most_lines:
            self._waiting.popleft()
            self.health.lost["full"] += 1

    def _put_status(self) -> None:
        """That of now, if it is time."""
        now_s = self._clock()
        if now_s >= self._status_s:
            self._status_s = now_s + _STATUS_PERIOD_S
            self._put(self._lines.status(self._status(), self._utc_s(now_s)))

    # ---- HTTP --------------------------------------------------------------------------------------------------------

    async def _run_http(self) -> None:
        pause_s = self._params.batch_s
        while True:
            await asyncio.sleep(pause_s)
            pause_s = min(2.0 * pause_s, max(_LONGEST_PAUSE_S, self._params.batch_s))
            try:
                await asyncio.to_thread(import_module, "aiohttp")  # It takes 90 ms.
                context, headers = await asyncio.to_thread(self._read_files)
            except ValueError as error:
                self.health.down(str(error))
                continue
            detail, has_worked = await self._session(context, headers)
            self.health.down(detail)
            if has_worked:
                pause_s = self._params.batch_s

    def _read_files(self) -> tuple[ssl.SSLContext | None, dict[str, str]]:
        """Raises ValueError: a file cannot be used."""
        params = self._params
        headers = {"Content-Type": "text/plain; charset=utf-8"}
        if params.token_file:
            headers["Authorization"] = f"Token {read_secret(params.token_file)}"
        elif params.username:
            secret = read_secret(params.password_file) if params.password_file else ""
            headers["Authorization"] = f"Basic {b64encode(f'{params.username}:{secret}'.encode()).decode()}"
        return tls_context(params.ca_file) if self._link.scheme == "https" else None, headers

    async def _session(self, context: ssl.SSLContext | None, headers: dict[str, str]) -> tuple[str, bool]:
        """Send batches until one fails; returns why, and whether any was taken."""
        import aiohttp

        has_worked = False
        connector = aiohttp.TCPConnector(limit=1, ssl=context if context is not None else True)
        timeout = aiohttp.ClientTimeout(total=_ANSWER_S, sock_connect=0.5 * _ANSWER_S)
        async with aiohttp.ClientSession(connector=connector, timeout=timeout, headers=headers) as session:
            while True:
                try:
                    await self._send_waiting(session)
                except Refused as refusal:
                    is_told = refusal.status == self._refused_with and not self.health.is_up
                    self._refused_with = refusal.status
                    # Its words may hold the very line that it does not like, and would be new each time.
                    return self.health.detail if is_told else str(refusal), has_worked
                except (aiohttp.ClientError, OSError) as error:
                    return self._explain(error), has_worked
                has_worked = True
                try:
                    await asyncio.sleep(self._params.batch_s)
                except asyncio.CancelledError:
                    await self._send_rest(session)
                    raise

    async def _send_waiting(self, session: aiohttp.ClientSession) -> None:
        """All that waits. What is under way stays first in the queue until it has been taken.

        Raises:
            Refused: the database does not take it.
            aiohttp.ClientError, OSError: it cannot be reached.
        """
        self._put_status()
        while self._waiting:
            count = min(len(self._waiting), _MOST_LINES)
            body = b"".join(islice(self._waiting, count))
            lost = self.health.lost["full"]
            try:
                await self._post_again(session, body)
            except Refused as refusal:
                if refusal.is_lasting:
                    self._done(count, lost)
                    self.health.lost["refused"] += count
                raise
            self._done(count, lost)
            self.health.sent += count
            self.health.up()

    async def _post_again(self, session: aiohttp.ClientSession, body: bytes) -> None:
        import aiohttp

        try:
            await self._post(session, body)
        except (aiohttp.ServerDisconnectedError, ConnectionResetError):
            # It had closed the connection of the last batch just then. A point that comes twice is one.
            await self._post(session, body)

    def _done(self, count: int, lost: int) -> None:
        """Forget the batch, but for those of it that have been dropped meanwhile, when ``lost`` had been."""
        for _ in range(count - (self.health.lost["full"] - lost)):
            self._waiting.popleft()

    async def _post(self, session: aiohttp.ClientSession, body: bytes) -> None:
        params = self._params
        path, query = "/write", {"db": params.database, "precision": "ns"}
        if params.bucket:
            path, query = "/api/v2/write", {"bucket": params.bucket, "org": params.org, "precision": "ns"}
        host = f"[{self._link.host}]" if ":" in self._link.host else self._link.host
        url = f"{self._link.scheme}://{host}:{self._link.port}{path}"
        async with session.post(url, params=query, data=body, allow_redirects=False) as answer:
            if 200 <= answer.status < 300:
                return
            said = _message(await answer.content.read(_MESSAGE_BYTES))
            words = f"the database refuses with {answer.status} {answer.reason}: {said or 'without a word'}"
            raise Refused(answer.status, f"{words}; {self._advice(answer.status)}")

    def _advice(self, status: int) -> str:
        is_v2 = bool(self._params.bucket)
        if status in (401, 403):
            return "check token_file" if self._params.token_file or is_v2 else "check username and password_file"
        if status == 404:
            return "check bucket and org" if is_v2 else "check database, and create it if it is not there"
        if status >= 500:
            return "see its log; the lines wait"
        return "is the link that of an InfluxDB?" if status < 400 else "see its log"

    async def _send_rest(self, session: aiohttp.ClientSession) -> None:
        import aiohttp

        with suppress(aiohttp.ClientError, OSError, Refused):
            async with asyncio.timeout(_GOODBYE_S):
                await self._send_waiting(session)

    def _explain(self, error: Exception) -> str:
        if type(error) is TimeoutError:  # Of the whole: that of connecting has a class of its own.
            return f"the database does not answer within {_ANSWER_S:g} s: is port {self._link.port} one of HTTP?"
        cause: BaseException = error
        for inner in (getattr(error, "certificate_error", None), getattr(error, "os_error", None)):
            cause = inner or cause
        served = f"a database listens on port {self._link.port}"
        return explain_tls(self._link, cause, served)

    # ---- UDP ---------------------------------------------------------------------------------------------------------

    async def _run_udp(self) -> None:
        pause_s = self._params.batch_s
        while True:
            try:
                addresses = await self._host.addresses(_LOOK_UP_S)
                await self._send_datagrams(addresses[0])
            except OSError as error:
                self.health.down(explain_no_connection(self._link.host, error, f"somebody listens on {self._link}"))
            await asyncio.sleep(pause_s)
            pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)

    async def _send_datagrams(self, address: str) -> None:
        """Until that fails, which raises OSError. That nobody listens comes back from the far end, if at all, after the
        datagram that it is about.
        """
        family = socket.AF_INET6 if ":" in address else socket.AF_INET
        with socket.socket(family, socket.SOCK_DGRAM) as connection:
            connection.setblocking(False)
            connection.connect((address, self._link.port))
            while True:
                self._put_status()
                is_taken = bool(self._waiting) and self._send_all(connection)
                try:
                    await asyncio.sleep(self._params.batch_s)
                except asyncio.CancelledError:
                    with suppress(OSError):
                        self._send_all(connection)
                    raise
                error = connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
                if error:
                    raise OSError(error, "the datagrams are not taken")
                if is_taken:
                    self.health.up()

    def _send_all(self, connection: socket.socket) -> bool:
        while self._waiting:
            count, size = 0, 0
            for line in self._waiting:
                if count and size + len(line) > _DATAGRAM_BYTES:
                    break
                count, size = count + 1, size + len(line)
            datagram = b"".join([self._waiting.popleft() for _ in range(count)])
            try:
                connection.send(datagram)
            except BlockingIOError:
                self.health.lost["full"] += count
                return False
            except OSError:
                self.health.lost["refused"] += count
                raise
            self.health.sent += count
        return True


def _message(body: bytes) -> str:
    """What a server says is wrong, in one line: InfluxDB wraps it in JSON."""
    try:
        answer = msgspec.json.decode(body, type=dict[str, object])
    except (msgspec.MsgspecError, UnicodeDecodeError):
        text = body.decode(errors="replace")
    else:
        text = str(answer.get("error") or answer.get("message") or answer)
    return " ".join(text.split())
