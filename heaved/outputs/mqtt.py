"""``[mqtt]``: the records of the stream as messages to a broker.

Under the topic ``heaved``, unless another is configured:

* ``heaved/motion``, ``/sea``, ``/delayed``, ``/hull``, ``/attitude``, ``/reference_mru``, ``/quiet``: MOTION and so on,
  as the stream has them (REFERENCE is the sixth), the first at a rate of its own and with it what is new of the others.
* ``heaved/status``: STATUS, retained.
* ``heaved/availability``: ``online`` or ``offline``, retained; the broker itself says ``offline`` when we are lost.

While the broker is away nothing is kept but the newest status: a queue of old motion would be of use to nobody. Looking
its name up, connecting and the TLS handshake are done in threads; what is sent is written without waiting.
"""

from __future__ import annotations

import asyncio
import logging
import socket
from collections import deque
from contextlib import suppress
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, NoReturn

import msgspec

from heaved.host_name import HostName
from heaved.links import explain_no_connection, parse_service_link
from heaved.outputs import wire
from heaved.outputs.credentials import explain_tls, read_secret, tls_context
from heaved.outputs.output import OutputHealth, Told
from heaved.outputs.slower import SLOW, Slower

if TYPE_CHECKING:
    import aiomqtt

    from heaved.samples import MotionFrame

PORTS: Final = {"mqtt": 1883, "mqtts": 8883}
MISSING: Final = "the library for MQTT is not installed: pip install 'heaved[mqtt]'"

_ANSWER_S: Final = 10.0
"""The broker may take so long to acknowledge."""
_LOOK_UP_S: Final = 5.0
_GOODBYE_S: Final = 0.25
"""What may be spent on saying ``offline``; if that fails, the broker says it when the connection ends."""
_FIRST_PAUSE_S: Final = 1.0
_LONGEST_PAUSE_S: Final = 30.0
_LONG_LIFE_S: Final = 60.0
"""After a connection that held so long the next attempt comes without delay."""
_MOST_WAITING: Final = 256
"""Messages that wait for a broker that is slow to take them; then the oldest are dropped."""

_SILENT: Final = logging.Logger("mqtt", logging.CRITICAL + 1)
"""For the library, which would say at each attempt what is said once here."""

Topic = Annotated[str, msgspec.Meta(pattern=r"^[^+#$/\x00-\x1f\x7f-\x9f][^+#\x00-\x1f\x7f-\x9f]{0,199}\Z")]


class MqttParams(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[mqtt]``: messages to a broker."""

    enabled: bool = False
    link: str = "mqtt://127.0.0.1:1883"
    """``mqtt://host:1883``, or ``mqtts://host:8883`` with TLS."""
    topic: Topic = "heaved"
    """What all topics begin with."""
    client_id: Annotated[str, msgspec.Meta(pattern=r"^[!-~]{0,128}\Z")] = ""
    """Empty: ``heaved-`` and the name of the machine."""
    protocol: Literal["3.1.1", "5"] = "3.1.1"
    rate_hz: Annotated[float, msgspec.Meta(gt=0, le=100)] = 1.0
    """Of MOTION."""
    status_period_s: Annotated[float, msgspec.Meta(ge=1, le=3600)] = 10.0
    qos: Annotated[int, msgspec.Meta(ge=0, le=2)] = 0
    """Of everything but status and availability, which are sent with 1 at least."""
    retain: bool = False
    """Whether the broker keeps the last MOTION and the like, too, for those who come later."""
    keepalive_s: Annotated[int, msgspec.Meta(ge=2, le=3600)] = 20
    username: str = ""
    password_file: str = ""
    ca_file: str = ""
    """Empty: what the system trusts."""
    certificate_file: str = ""
    key_file: str = ""

    @property
    def identity(self) -> str:
        """The client id in use: the same at every start, so that the broker knows who comes back."""
        return self.client_id or f"heaved-{socket.gethostname()}"


class _Message(msgspec.Struct, frozen=True, gc=False):
    """One that waits to be sent."""

    topic: str
    payload: bytes
    qos: int
    retain: bool
    t_s: float | None = None
    """Of MOTION, which lacks its tail: its time of validity."""


class MqttOutput:
    """The connection to the broker, and what waits for it.

    Attributes:
        health: how it fares. Lost by reason: ``away``, no broker; ``slow``, it did not keep up; ``connection``, it
            broke while a message was under way.
    """

    def __init__(self, params: MqttParams, told: Told) -> None:
        """
        Raises:
            ValueError: the link cannot be understood.
        """
        self._params = params
        self._link = parse_service_link(params.link, PORTS)
        self._status, self._utc_s, self._clock = told.status, told.utc_s, told.clock
        self._host = HostName(self._link.host)
        self._slower = Slower(params.rate_hz)
        self._sequence = self._dropped = 0
        self._waiting: deque[_Message] = deque()
        self._wake = asyncio.Event()
        self._is_connected = False
        self._leaving: set[asyncio.Task[Any]] = set()
        """Connections that nobody wants any more and that cannot be interrupted."""
        self.health = OutputHealth("mqtt", f"MQTT {params.protocol}", str(self._link))

    def publish(self, frame: MotionFrame) -> None:
        """Take a frame; while the broker is away it is lost, and counted where it would have been sent."""
        self._sequence += 1
        if not self._slower.wants(frame):
            return
        if not self._is_connected:
            self._lose("away", is_motion=True)
            return
        head = wire.motion_head(frame, seq=self._sequence, utc_s=self._utc_s(frame.t_s))
        self._put("motion", head, frame.t_s)
        for name, found in self._slower.news(frame):
            self._put(name, wire.encode_record(SLOW[name](found, self._utc_s(found.t_s)))[:-1])
        self._wake.set()

    async def run(self) -> None:
        """Stay connected, for ever; when cancelled, say ``offline`` and disconnect."""
        pause_s = _FIRST_PAUSE_S
        while True:
            started_s = self._clock()
            self.health.down(await self._session())
            if self._clock() - started_s > _LONG_LIFE_S:
                pause_s = _FIRST_PAUSE_S
            await asyncio.sleep(pause_s)
            pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)

    # ---- what waits --------------------------------------------------------------------------------------------------

    def _put(self, name: str, payload: bytes, t_s: float | None = None) -> None:
        if len(self._waiting) >= _MOST_WAITING:
            self._lose("slow", is_motion=self._waiting.popleft().t_s is not None)
        params = self._params
        self._waiting.append(_Message(f"{params.topic}/{name}", payload, params.qos, params.retain, t_s))

    def _lose(self, reason: str, *, is_motion: bool) -> None:
        self.health.lost[reason] += 1
        self._dropped += is_motion

    # ---- the connection ----------------------------------------------------------------------------------------------

    async def _session(self) -> str:
        """Connect and send until that ends; returns why it did, and what to do."""
        try:
            library = await asyncio.to_thread(import_module, "aiomqtt")
        except ImportError:
            return MISSING
        try:
            await self._host.addresses(_LOOK_UP_S)
            client = await self._made(library)
        except ValueError as error:
            return str(error)
        except OSError as error:
            return explain_no_connection(self._link.host, error, self._served)
        try:
            await self._connect(client)
        except library.MqttError as error:
            return self._why_not_connected(error)
        try:
            await self._serve(client)
        except library.MqttError as error:
            return self._why_disconnected(error)

    async def _made(self, library: Any) -> aiomqtt.Client:
        """A client that is not connected yet.

        Raises:
            ValueError: a file with a password or a certificate cannot be used.
        """
        params = self._params
        password = await asyncio.to_thread(read_secret, params.password_file) if params.password_file else None
        context = None
        if self._link.scheme == "mqtts":
            files = (params.ca_file, params.certificate_file, params.key_file)
            context = await asyncio.to_thread(tls_context, *files)
        client: aiomqtt.Client = library.Client(
            self._link.host,
            self._link.port,
            identifier=params.identity,
            protocol=library.ProtocolVersion.V5 if params.protocol == "5" else library.ProtocolVersion.V311,
            username=params.username or None,
            password=password,
            tls_context=context,
            will=library.Will(self._availability, b"offline", qos=1, retain=True),
            keepalive=params.keepalive_s,
            timeout=_ANSWER_S,
            logger=_SILENT,
        )
        return client

    async def _connect(self, client: aiomqtt.Client) -> None:
        """Raises MqttError when it comes to nothing."""
        connecting = asyncio.create_task(client.__aenter__(), name="connect mqtt")
        try:
            await asyncio.shield(connecting)
        except asyncio.CancelledError:
            # The thread that connects cannot be stopped: what it comes to is closed when it is there.
            self._leaving.add(connecting)
            connecting.add_done_callback(partial(self._left, client))
            raise
        except BaseException:
            _hang_up(client)
            raise
        finally:
            # The error knows this frame: without the task in it, what failed is freed, and its socket closed, at once.
            del connecting

    def _left(self, client: aiomqtt.Client, connecting: asyncio.Task[Any]) -> None:
        self._leaving.discard(connecting)
        if not connecting.cancelled():
            connecting.exception()
        _hang_up(client)

    async def _serve(self, client: aiomqtt.Client) -> NoReturn:
        """Send what there is until the connection ends, which raises MqttError."""
        gone = asyncio.create_task(_until_gone(client), name="mqtt connection")
        sending = asyncio.create_task(self._send(client), name="mqtt sending")
        try:
            await asyncio.wait((gone, sending), return_when=asyncio.FIRST_COMPLETED)
        except asyncio.CancelledError:
            sending.cancel()
            await self._say_goodbye(client)
            raise
        finally:
            self._is_connected = False
            sending.cancel()
            _hang_up(client)
            errors = await asyncio.gather(sending, gone, return_exceptions=True)
            while self._waiting:
                self._lose("connection", is_motion=self._waiting.popleft().t_s is not None)
        raise next(error for error in errors if not isinstance(error, asyncio.CancelledError | None))

    async def _send(self, client: aiomqtt.Client) -> None:
        await client.publish(self._availability, b"online", qos=1, retain=True)
        self._slower.tell_again()
        self._is_connected = True
        self.health.up()
        loop = asyncio.get_running_loop()
        status_s = loop.time()
        while True:
            if loop.time() >= status_s:
                status_s = loop.time() + self._params.status_period_s
                payload = wire.encode_record(self._status())[:-1]
                await client.publish(f"{self._params.topic}/status", payload, qos=max(self._params.qos, 1), retain=True)
                self.health.sent += 1
            elif self._waiting:
                await self._send_one(client, self._waiting.popleft())
            else:
                self._wake.clear()
                with suppress(TimeoutError):  # Not wait_for, which can swallow a cancellation (Python 3.11).
                    async with asyncio.timeout_at(status_s):
                        await self._wake.wait()

    async def _send_one(self, client: aiomqtt.Client, message: _Message) -> None:
        payload, dropped = message.payload, self._dropped
        if message.t_s is not None:
            payload += wire.motion_tail(self._clock() - message.t_s, dropped)[:-1]
        try:
            await client.publish(message.topic, payload, qos=message.qos, retain=message.retain)
        except BaseException:
            self._lose("connection", is_motion=message.t_s is not None)
            raise
        self.health.sent += 1
        if message.t_s is not None:
            self._dropped -= dropped

    async def _say_goodbye(self, client: aiomqtt.Client) -> None:
        # What else may go wrong here has been said, or is cured by the broker's own word when the connection ends.
        with suppress(Exception):
            async with asyncio.timeout(_GOODBYE_S):
                await client.publish(self._availability, b"offline", qos=1, retain=True)
                await client.__aexit__(None, None, None)

    @property
    def _availability(self) -> str:
        return f"{self._params.topic}/availability"

    # ---- in words ----------------------------------------------------------------------------------------------------

    @property
    def _served(self) -> str:
        return f"an MQTT broker listens on port {self._link.port}"

    def _why_not_connected(self, error: Exception) -> str:
        code, cause = _code(error), error.__context__
        if code is not None:
            return _refusal(code, str(error), self._params)
        if isinstance(cause, OSError) and str(cause) == str(error):  # Else it is what was waited for in vain.
            return explain_tls(self._link, cause, self._served)
        is_tls = self._link.scheme == "mqtts"
        wants = (
            "does it want a certificate of ours (certificate_file)?"
            if is_tls and not self._params.certificate_file
            else f"is port {self._link.port} one of MQTT{'' if is_tls else ', and without TLS (else mqtts://)'}?"
        )
        return f"the broker takes the connection and does not answer within {_ANSWER_S:g} s: {wants}"

    def _why_disconnected(self, error: Exception) -> str:
        cause = error.__cause__ or error
        code = _code(cause)
        if code is None:
            return f"the broker does not acknowledge what it is sent ({cause}): check broker and network"
        return (
            f"the broker ended the connection ({cause}): see its log; two clients of one id end each other's: ours is "
            f"{self._params.identity!r}, give each its own client_id"
        )


_REFUSALS: Final = {
    0x84: "the broker does not speak MQTT {params.protocol}: set protocol",
    0x85: "the broker does not accept the client id {params.identity!r}: set another client_id",
    0x88: "the broker is not available: see its log",
    0x89: "the broker is busy",
    0x8A: "the broker has banned us: see its log",
}
"""By the reason code of MQTT 5, section 3.2.2.2, to which those of 3.1.1 are translated."""


_WHO_ARE_YOU: Final = (0x86, 0x87)
"""Bad user name or password, and not authorised, between which brokers do not tell apart."""


def _refusal(code: int, said: str, params: MqttParams) -> str:
    if code in _WHO_ARE_YOU:
        if not params.username:
            return f"the broker lets nobody in without a name ({said}): set username and password_file"
        return f"the broker refuses {params.username!r} or its password ({said}): check username and password_file"
    known = _REFUSALS.get(code)
    return known.format(params=params) if known else f"the broker refuses the connection: {said}"


def _code(error: BaseException) -> int | None:
    """The reason code that the broker gave, or the library."""
    code = getattr(error, "rc", None)
    return getattr(code, "value", code)


async def _until_gone(client: aiomqtt.Client) -> None:
    """Raises MqttError when the connection has ended. We subscribe to nothing: what a broker sends is let go."""
    async for _ in client.messages:
        pass


def _hang_up(client: aiomqtt.Client) -> None:
    """End the connection, if there is one, whatever the far end does. aiomqtt itself leaves it open when there is no
    answer, and waits to be let go.
    """
    paho = client._client  # There is no other way to it.  # noqa: SLF001
    connection = paho.socket()
    if not isinstance(connection, socket.socket):
        return
    with suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)
    # What was received before comes first; then it finds the end, and cleans up. Whatever a broken broker has sent is
    # let go, and so is what the library makes of a wait for an answer that was cancelled.
    with suppress(Exception, asyncio.CancelledError):
        for _ in range(_MOST_WAITING):
            if paho.socket() is None:
                break
            paho.loop_read()
