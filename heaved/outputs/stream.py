"""The TCP stream: every frame to every client, without ever waiting for one.

A client that keeps up has its line written in the very call of :meth:`Publisher.publish`. One that does not has a
bounded queue, in which the oldest lines give way to the newest; one that takes nothing for ``stuck_s`` is
disconnected. What is said on the connection is in :mod:`heaved.outputs.wire`.
"""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Final, Protocol, TypeVar

import structlog

from heaved.networks import checked_networks, is_allowed
from heaved.outputs import wire
from heaved.outputs.listen import Listener, alike
from heaved.outputs.records import ErrorRecord, StatusRecord, VersionRecord
from heaved.outputs.shares import TOO_MANY, Shares
from heaved.outputs.subscriber import Subscriber
from heaved.samples import CraftMotion, DelayedHeave, HullAngles, MotionFrame, MruComparison, SeaState

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import msgspec

    from heaved.outputs.tls import Certificates

Slow = TypeVar("Slow", DelayedHeave, HullAngles, CraftMotion, MruComparison, SeaState)

_OUTSIDER: Final = "is not in a network of [stream] allow"

_log = structlog.get_logger(__name__)


class StreamMetrics(Protocol):
    """What the publisher counts for monitoring."""

    def set_clients(self, clients: int) -> None:
        """Connections served now."""

    def count_sent(self, frames: int) -> None:
        """So many frames were handed to a client's connection."""

    def count_dropped(self, reason: str) -> None:
        """A line was dropped."""

    def count_client_error(self, reason: str) -> None:
        """A client was turned away or misunderstood."""


class Publisher:
    """Serves the stream; everything runs on the event loop.

    Attributes:
        dropped: lines dropped for slow clients since the start, all clients together.
        together: frames that are handed over at once; more than one costs less and makes them older.
    """

    def __init__(
        self,
        *,
        host: str,
        port: int,
        max_clients: int,
        queue_frames: int,
        allow: tuple[str, ...],
        version: str,
        status: Callable[[], StatusRecord],
        metrics: StreamMetrics,
        utc_s: Callable[[float], float],
        stuck_s: float = 10.0,
        clock: Callable[[], float] = time.monotonic,
        certificates: Certificates | None = None,
    ) -> None:
        """``clock``: the monotonic clock that ``MotionFrame.t_s`` is read from; ``utc_s``: UTC, seconds since 1970, of
        a time on it. With ``certificates`` TLS is spoken.

        Raises:
            ValueError: ``host`` reaches beyond this machine, ``allow`` names no network and there are no
                ``certificates``, or an entry is none.
        """
        self.dropped = 0
        self.together = 1
        self.queue_frames = queue_frames
        self.stuck_s = stuck_s
        self.clock = clock
        self._metrics = metrics
        self._utc_s = utc_s
        self._networks = checked_networks("stream", host, allow, wants_certificates=certificates is not None)
        self._listener = Listener(
            "stream", host, port, lambda address: Subscriber(self, address), self.refusal,
            certificates=certificates, networks=self._networks, outsider=_OUTSIDER,
        )  # fmt: skip
        self._max_clients = max_clients
        self._shares = Shares(max_clients)
        self._version = version
        self._status = status
        self._sequence = 0
        self._gathered: list[tuple[bytes, float, list[Subscriber]]] = []
        """Heads of frames that wait for others, when they are valid, and for whom they are."""
        self._served: dict[Subscriber, None] = {}  # A set that keeps the order of arrival.
        self._newest: dict[str, object] = {}
        """Of each slower class, what was published last."""
        self._lingering: dict[Subscriber, None] = {}

    @property
    def clients(self) -> int:
        """Connections served now."""
        return len(self._served)

    async def start(self) -> tuple[str, int]:
        """Listen; returns the address that was bound (port 0 lets the system choose one).

        Raises:
            ListenError: the address cannot be bound; says what to do.
        """
        return await self._listener.start()

    def publish(self, frame: MotionFrame) -> None:
        """Hand a frame to every subscriber of MOTION, and its delayed heave, if it is new, to those of DELAYED."""
        self._publish_motion(frame)
        self._publish_new("DELAYED", frame.delayed, wire.delayed_record)

    def publish_stages(
        self, hull: HullAngles | None, attitude: CraftMotion | None, reference: MruComparison | None = None
    ) -> None:
        """HULL, ATTITUDE and REFERENCE, if they are new."""
        self._publish_new("HULL", hull, wire.hull_record)
        self._publish_new("ATTITUDE", attitude, wire.attitude_record)
        self._publish_new("REFERENCE", reference, wire.reference_record)

    def publish_slow(self, frame: MotionFrame) -> None:
        """SEA, if it has been fitted again, and QUIET; to be called once a second."""
        self._publish_new("SEA", frame.sea, wire.sea_record)
        if frame.quiet is not None:
            self.publish_record(wire.quiet_record(frame.quiet, self._utc_s(frame.quiet.t_s)))

    def publish_record(self, record: msgspec.Struct) -> None:
        """Hand a record of another class (STATUS, ...; the class is its tag) to its subscribers."""
        now_s, name = self.clock(), str(record.__struct_config__.tag)
        self._send([client for client in self._served if client.wants(name, now_s)], record)

    def _send(self, subscribers: Sequence[Subscriber], record: msgspec.Struct) -> None:
        line = wire.encode_record(record) if subscribers else b""
        for client in subscribers:
            client.send(line)

    def _publish_motion(self, frame: MotionFrame) -> None:
        self._sequence += 1
        subscribers = [client for client in self._served if client.wants("MOTION", frame.t_s)]
        if self.together > 1 or self._gathered:
            self._gather(frame, subscribers)
            return
        if not subscribers:
            return
        head = wire.motion_head(frame, seq=self._sequence, utc_s=self._utc_s(frame.t_s))
        line = head + wire.motion_tail(self.clock() - frame.t_s, 0)
        self._metrics.count_sent(sum([client.send_motion(line, head, frame.t_s) for client in subscribers]))

    def _gather(self, frame: MotionFrame, subscribers: list[Subscriber]) -> None:
        head = wire.motion_head(frame, seq=self._sequence, utc_s=self._utc_s(frame.t_s)) if subscribers else b""
        self._gathered.append((head, frame.t_s, subscribers))
        if len(self._gathered) >= self.together:
            self._send_gathered()

    def _send_gathered(self) -> None:
        gathered, self._gathered = self._gathered, []
        now_s = self.clock()
        of_each: dict[Subscriber, list[tuple[bytes, bytes, float]]] = {}
        for head, t_s, subscribers in gathered:
            line = head + wire.motion_tail(now_s - t_s, 0)
            for client in subscribers:
                of_each.setdefault(client, []).append((line, head, t_s))
        sent = sum([client.send_motions(lines) for client, lines in of_each.items() if client in self._served])
        self._metrics.count_sent(sent)

    def _publish_new(self, name: str, found: Slow | None, made: Callable[[Slow, float], msgspec.Struct]) -> None:
        """What is slower than the frames and comes with many of them: once, if anybody subscribes to class ``name``."""
        if found is None or found is self._newest.get(name):
            return
        self._newest[name] = found
        if subscribers := [client for client in self._served if client.wants(name, found.t_s)]:
            self._send(subscribers, made(found, self._utc_s(found.t_s)))

    async def close(self, drain_s: float = 0.5) -> None:
        """Stop listening, give the clients ``drain_s`` to take what is queued for them, close every connection."""
        self._listener.close()
        self._send_gathered()
        connected = [*self._served, *self._lingering]
        for client in connected:
            client.finish()
        if connected:
            await asyncio.wait([client.closed for client in connected], timeout=drain_s)
        for client in connected:
            client.abort()
            await client.closed

    # What follows is for the subscribers: see :class:`heaved.outputs.subscriber.Server`.

    def admit(self, client: Subscriber) -> ErrorRecord | None:
        """Serve ``client``, or say why not."""
        address = client.address
        if not is_allowed(address, self._networks):
            return self.refusal("not_allowed", address, f"{address} {_OUTSIDER}")
        if self.clients >= self._max_clients:
            message = f"{self._max_clients} clients are connected and no more are served ([stream] max_clients)"
            return self.refusal("too_many_clients", address, message)
        if not self._shares.take(address):
            message = f"{self._shares.refusal(address)} (a quarter of [stream] max_clients)"
            return self.refusal(TOO_MANY, address, message)
        self._served[client] = None
        self._metrics.set_clients(self.clients)
        _log.debug("stream client connected", peer=address, clients=self.clients)
        return None

    def refusal(self, reason: str, address: str, message: str) -> ErrorRecord:
        """Count and log what a client did wrong, and make the record that tells it."""
        self._metrics.count_client_error(reason)
        _log.warning("stream client error", reason=reason, peer=address, error=message, alike=alike(reason, message))
        return ErrorRecord(message=message)

    def linger(self, client: Subscriber) -> bool:
        """Stop serving ``client`` but keep the connection for a moment; False when too many linger already."""
        self.forget(client)
        if len(self._lingering) >= self._max_clients:
            return False
        self._lingering[client] = None
        return True

    def forget(self, client: Subscriber) -> None:
        """``client`` is served no more."""
        self._lingering.pop(client, None)
        if client in self._served:
            del self._served[client]
            self._shares.give_back(client.address)
            self._metrics.set_clients(self.clients)
            _log.debug("stream client gone", peer=client.address, clients=self.clients)

    def count_drop(self) -> None:
        """A line was dropped for a slow client."""
        self.dropped += 1
        self._metrics.count_dropped("slow_client")

    def count_sent(self, frames: int) -> None:
        """So many frames were handed to a client's connection."""
        self._metrics.count_sent(frames)

    def greeting(self) -> bytes:
        """The VERSION line."""
        return wire.encode_record(VersionRecord(release=self._version))

    def status_line(self) -> bytes:
        """The STATUS line of now."""
        return wire.encode_record(self._status())
