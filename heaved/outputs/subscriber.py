"""One subscriber of the stream: what it wants, what waits for it, what it does wrong."""

from __future__ import annotations

import asyncio
import socket
from collections import deque
from math import inf
from typing import TYPE_CHECKING, Final, Protocol, cast

from heaved.keep_alive import keep_alive
from heaved.outputs import wire
from heaved.outputs.due_times import DueTimes
from heaved.outputs.records import ErrorRecord
from heaved.outputs.requests import (
    ACCEPTED,
    MAX_REQUEST_BYTES,
    BadRequest,
    LineSplitter,
    Request,
    StatusQuery,
    Subscription,
    VersionQuery,
    parse_request,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

_MAX_ERRORS: Final = 5
_MAX_REQUESTS_PER_S: Final = 20
"""More is an error: to answer a flood of ``?STATUS`` would delay the other clients."""
_SEND_BUFFER_BYTES: Final = 32 * 1024
"""Small, so that a client which does not read shows within seconds. Linux doubles it."""
_LINGER_S: Final = 1.0
"""How long a client that is turned away may take to read why, before the connection is reset."""
_LINGER_BYTES: Final = 4 << 20
"""How much it may go on sending meanwhile; it is thrown away."""
_SILENT_S: Final = 3.0
"""A client that has closed its side is served on as long as something goes out to it this often: that it has gone
altogether shows on sending alone."""


class Server(Protocol):
    """What a subscriber needs of who serves it.

    Attributes:
        queue_frames: most lines that wait for it.
        stuck_s: how long it may take nothing, with a full queue.
        clock: the monotonic clock of the frames.
    """

    queue_frames: int
    stuck_s: float
    clock: Callable[[], float]

    def admit(self, client: Subscriber) -> ErrorRecord | None:
        """Serve ``client``, or say why not."""

    def linger(self, client: Subscriber) -> bool:
        """Stop serving ``client`` but keep the connection for a moment; False when too many linger already."""

    def forget(self, client: Subscriber) -> None:
        """``client`` is served no more."""

    def refusal(self, reason: str, address: str, message: str) -> ErrorRecord:
        """Count and log what a client did wrong; what it is told."""

    def count_drop(self) -> None:
        """A line was dropped for a slow client."""

    def count_sent(self, frames: int) -> None:
        """So many frames were handed to a client's connection."""

    def greeting(self) -> bytes:
        """The VERSION line."""

    def status_line(self) -> bytes:
        """The STATUS line of now."""


class Subscriber(asyncio.Protocol):
    """A client that is connected. Made by the event loop, served by the publisher.

    The transport's own buffer is limited to nothing: it asks for a pause as soon as the kernel has not taken a whole
    line. So while not paused the queue is empty, and a line can go straight to the socket.
    """

    def __init__(self, server: Server, address: str) -> None:
        """``address``: of the peer."""
        loop = asyncio.get_running_loop()
        self.address = address
        self.classes: frozenset[str] = frozenset()
        self.closed: asyncio.Future[None] = loop.create_future()
        self._server = server
        self._transport: asyncio.Transport
        self._silence_timer: asyncio.TimerHandle | None = None
        self._is_silent = False  # Nothing was sent since the timer was started.
        self._linger_timer: asyncio.TimerHandle | None = None
        self._discarded_bytes = 0
        self._lines = LineSplitter()
        self._errors = 0
        self._requests = 0
        self._requests_since_s = -inf
        self._watch(Subscription())
        self._queue: deque[tuple[bytes, float | None]] = deque()  # (head of a MOTION, its t_s) or (whole line, None)
        self._paused = False
        self._full_since_s = inf
        self._dropped = 0  # MOTION frames since the last one that was sent.
        self._is_finishing = False

    # --- the connection's life ---

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Greet the client, or turn it away."""
        self._transport = cast("asyncio.Transport", transport)
        _set_options(transport.get_extra_info("socket"))
        self._transport.set_write_buffer_limits(high=0)
        refusal = self._server.admit(self)
        if refusal is not None:
            self._turn_away(refusal)
            return
        self._transport.write(self._server.greeting())

    def connection_lost(self, _error: Exception | None) -> None:
        """It is gone."""
        for timer in (self._linger_timer, self._silence_timer):
            if timer is not None:
                timer.cancel()
        self._server.forget(self)
        self.closed.set_result(None)

    def eof_received(self) -> bool:
        """Keep serving a client that has said all it has to say (``echo ?STATUS | nc``).

        One that has closed the connection looks the same, until something is sent to it. So it must not be silent.
        """
        if self._linger_timer is not None:
            return False
        self._listen_for_silence()
        return True

    def _listen_for_silence(self) -> None:
        self._is_silent = True
        wait_s = max(_SILENT_S, 2.0 * self._period_s)
        self._silence_timer = asyncio.get_running_loop().call_later(wait_s, self._judge_silence)

    def _judge_silence(self) -> None:
        self._silence_timer = None
        if self._linger_timer is not None or self._is_finishing:
            return
        if not self._is_silent or self._paused:  # Whether one that takes nothing is stuck is judged elsewhere.
            self._listen_for_silence()
            return
        subscribed = ", ".join(sorted(self.classes)) or "no class"
        message = f"closed: you have closed your side, and there is nothing to send of what you watch ({subscribed})"
        self._turn_away(ErrorRecord(message=message))

    def finish(self) -> None:
        """Close as soon as the queue is empty."""
        self._is_finishing = True
        if not self._queue:
            self._transport.close()

    def abort(self) -> None:
        """Close at once."""
        self._server.forget(self)
        self._transport.abort()

    def _turn_away(self, refusal: ErrorRecord) -> None:
        """Say why, then close. Closing at once would reset the connection of a client that is still sending, and it
        would never read the reason.
        """
        if not self._server.linger(self):
            self.abort()
            return
        self._queue.clear()
        self._linger_timer = asyncio.get_running_loop().call_later(_LINGER_S, self._transport.abort)
        self._transport.write(wire.encode_record(refusal))
        try:
            self._transport.write_eof()
        except OSError:  # It has gone again, before it was looked at.
            self.abort()

    # --- to the client ---

    def wants(self, name: str, t_s: float) -> bool:
        """Whether it watches class ``name`` and a line of this time is due; to be asked once for each."""
        if name not in self.classes:
            return False
        due = self._due.get(name)
        return due is None or due.is_due(t_s)

    def send_motion(self, line: bytes, head: bytes, t_s: float) -> bool:
        """Whether ``line`` was written now, instead of ``head`` queued."""
        if self._paused:
            self._enqueue(head, t_s)
            return False
        self._is_silent = False
        self._transport.write(self._with_tail(head, t_s) if self._dropped else line)
        return True

    def send_motions(self, lines: Sequence[tuple[bytes, bytes, float]]) -> int:
        """The same of several at once; how many were written now."""
        if self._paused or self._dropped:
            return sum([self.send_motion(*one) for one in lines])
        self._is_silent = False
        self._transport.write(b"".join([line for line, _, _ in lines]))
        return len(lines)

    def send(self, line: bytes) -> None:
        """Write a line, or queue it."""
        if self._paused:
            self._enqueue(line, None)
        else:
            self._is_silent = False
            self._transport.write(line)

    def pause_writing(self) -> None:
        """The client does not keep up."""
        self._paused = True

    def resume_writing(self) -> None:
        """It does again: write what is queued."""
        self._paused = self._is_silent = False
        self._full_since_s = inf
        sent = 0
        while self._queue and not self._paused:
            line, t_s = self._queue.popleft()
            if t_s is not None:
                line = self._with_tail(line, t_s)
                sent += 1
            self._transport.write(line)
        self._server.count_sent(sent)
        if self._is_finishing and not self._queue:
            self._transport.close()

    def _with_tail(self, head: bytes, t_s: float) -> bytes:
        dropped, self._dropped = self._dropped, 0
        return head + wire.motion_tail(self._server.clock() - t_s, dropped)

    def _enqueue(self, line: bytes, t_s: float | None) -> None:
        self._queue.append((line, t_s))
        if len(self._queue) <= self._server.queue_frames:
            return
        _, dropped_t_s = self._queue.popleft()
        self._dropped += dropped_t_s is not None
        self._server.count_drop()
        now_s = self._server.clock()
        self._full_since_s = min(self._full_since_s, now_s)
        if now_s - self._full_since_s > self._server.stuck_s:
            message = f"nothing taken for {self._server.stuck_s:g} s with a full queue: disconnected"
            self._server.refusal("stuck", self.address, message)
            self.abort()

    # --- from the client ---

    def data_received(self, data: bytes) -> None:
        """Obey what the client says."""
        if self._linger_timer is not None:
            self._discarded_bytes += len(data)
            if self._discarded_bytes > _LINGER_BYTES:
                self._transport.abort()
            return
        for line in self._lines.feed(data):
            self._obey(self._read(line))
            if self._linger_timer is not None:
                return
        if self._lines.overflow:
            message = f"a line longer than {MAX_REQUEST_BYTES} bytes: closed; {ACCEPTED}"
            self._turn_away(self._server.refusal("line_too_long", self.address, message))

    def _read(self, line: bytes) -> Request:
        now_s = self._server.clock()
        if now_s - self._requests_since_s >= 1.0:
            self._requests_since_s, self._requests = now_s, 0
        self._requests += 1
        if self._requests > _MAX_REQUESTS_PER_S:
            return BadRequest(f"more than {_MAX_REQUESTS_PER_S} requests in a second: send fewer")
        return parse_request(line)

    def _obey(self, request: Request) -> None:
        if isinstance(request, Subscription):
            self._watch(request)
        elif isinstance(request, StatusQuery):
            self.send(self._server.status_line())
        elif isinstance(request, VersionQuery):
            self.send(self._server.greeting())
        else:
            self._complain(request.message)

    def _watch(self, wanted: Subscription) -> None:
        self.classes = frozenset(wanted.classes)
        self._period_s = 0.0 if wanted.rate_hz is None else 1.0 / wanted.rate_hz
        self._due = {} if wanted.rate_hz is None else {name: DueTimes(wanted.rate_hz) for name in self.classes}
        """Of classes of which not all is wanted."""

    def _complain(self, message: str) -> None:
        self._errors += 1
        if self._errors < _MAX_ERRORS:
            self.send(wire.encode_record(self._server.refusal("bad_request", self.address, message)))
        else:
            message = f"{message} (error {self._errors}: closed)"
            self._turn_away(self._server.refusal("bad_request", self.address, message))


def _set_options(connection: socket.socket) -> None:
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
    # A client whose machine lost power is noticed within a minute, even when nothing is sent to it.
    keep_alive(connection, idle_s=30, probe_s=10)
