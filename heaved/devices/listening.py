"""Devices that speak by themselves: a task for each, a result for every sentence, and one for every silence.

Their link is a serial port, a UDP port of ours, or the TCP port of a box that gives out what it hears on a serial line.
"""

from __future__ import annotations

import asyncio
import errno
import socket
import time
from math import inf, nan
from typing import TYPE_CHECKING, Any, Final

from heaved.devices.liveness import LivenessCheck
from heaved.devices.mounting import mounting_of
from heaved.devices.profile import Decoded, DeviceSpec, Quantity, role_quantities
from heaved.devices.sentences import SentenceReader, name_of
from heaved.devices.station import KINDS, PollResult
from heaved.host_name import HostName
from heaved.keep_alive import keep_alive
from heaved.links import AnyLink, SerialLink, TcpLink, UdpListenLink, explain_open_failure, parse_any_link
from heaved.networks import is_allowed, parse_networks
from heaved.samples import Fault
from heaved.serial_port import SerialPort

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

SCHEMES: Final = ("serial", "udp-listen", "tcp")
RETRY_S: Final = 0.25
"""Between attempts to open a line."""
CONNECT_TIMEOUT_S: Final = 0.5
LEAST_SILENCE_PERIODS: Final = 2.5
"""So many periods without a sentence are a silence; no shorter one is, whatever ``timeout_ms`` says."""
_READ_BYTES: Final = 4096
_DATAGRAMS: Final = 32
"""Read at a time; more have to wait for the loop to come round."""


class Listening:
    """One device that speaks by itself."""

    def __init__(
        self,
        devices: Sequence[DeviceSpec],
        on_result: Callable[[PollResult], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """``devices``: the one that has the line.

        Raises:
            ValueError: more than one device, a link that cannot be parsed, or a network that is none.
        """
        (device,) = devices
        self._device = device
        self._link = parse_any_link(device.link, SCHEMES)
        self._networks = parse_networks(device.allow)
        self._on_result = on_result
        self._clock = clock
        self._reader = SentenceReader(device.profile.sentences)
        self._liveness = LivenessCheck(device)
        self._mounting = mounting_of(device)
        self._wanted = frozenset(role_quantities(device.role))
        self._period_s = 1.0 / device.rate_hz
        self._silence_s = max(device.timeout_ms * 1e-3, LEAST_SILENCE_PERIODS * self._period_s)
        self._heard_s = clock()
        self._is_open = False
        self._opened = self._good_on = 0
        """Connections, and the one of the last good sentence."""
        self._lost = asyncio.Event()
        self._detail = "not connected yet"
        self._stranger = ""

    async def run(self) -> None:
        """Listens until cancelled; then the line is closed."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._keep_open(), name=f"listen {self._link}")
            tasks.create_task(self._keep_watch(), name=f"silence {self._link}")

    # ---- the line ----------------------------------------------------------------------------------------------------

    async def _keep_open(self) -> None:
        name = HostName(self._link.host if isinstance(self._link, TcpLink) else "")
        while True:
            self._lost.clear()
            try:
                close = await self._open(name)
            except OSError as error:
                self._is_open, self._detail = False, _explained(self._link, error)
            else:
                self._is_open, self._opened = True, self._opened + 1
                self._reader.reset()
                try:
                    await self._lost.wait()
                finally:
                    close()
                self._is_open = False
            await asyncio.sleep(RETRY_S)

    async def _open(self, name: HostName) -> Callable[[], None]:
        """Have what comes read; returns how the line is closed."""
        link = self._link
        if isinstance(link, SerialLink):
            port = SerialPort(link, self._heard, self._lose)
            port.open()
            return port.close
        if isinstance(link, TcpLink):
            return _read_by(await self._connected(name, link.port), self._on_readable)
        family = socket.AF_INET6 if ":" in link.host else socket.AF_INET
        listening = socket.socket(family, socket.SOCK_DGRAM)
        try:
            listening.setblocking(False)
            listening.bind((link.host, link.port))
        except OSError:
            listening.close()
            raise
        return _read_by(listening, self._take_datagrams)

    async def _connected(self, name: HostName, port: int) -> socket.socket:
        failure: OSError = TimeoutError()
        for address in await name.addresses(CONNECT_TIMEOUT_S):
            connection = socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET, socket.SOCK_STREAM)
            connection.setblocking(False)
            try:
                async with asyncio.timeout(CONNECT_TIMEOUT_S):
                    await asyncio.get_running_loop().sock_connect(connection, (address, port))
            except OSError as error:
                connection.close()
                failure = error
            except BaseException:
                connection.close()
                raise
            else:
                # A box that has lost its power is noticed although nothing is sent to it.
                keep_alive(connection, idle_s=2, probe_s=1)
                return connection
        raise failure

    def _on_readable(self, connection: socket.socket) -> None:
        try:
            data = connection.recv(_READ_BYTES)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._lose(error.strerror or str(error))
            return
        if data:
            self._heard(data)
        else:
            self._lose("closed by the other side")

    def _heard(self, data: bytes) -> None:
        heard_s = self._clock()
        for decoded in self._reader.feed(data):
            self._say(decoded, heard_s)

    def _take_datagrams(self, listening: socket.socket) -> None:
        for _ in range(_DATAGRAMS):
            try:
                data, address = listening.recvfrom(_READ_BYTES)
            except OSError:
                return
            if not is_allowed(address[0], self._networks):
                self._stranger = address[0]
                continue
            heard_s = self._clock()
            for decoded in self._reader.datagram(data):
                self._say(decoded, heard_s)

    def _lose(self, reason: str) -> None:
        self._is_open, self._detail = False, f"the connection was lost ({reason}): trying to open it again"
        self._lost.set()

    # ---- what comes of it --------------------------------------------------------------------------------------------

    async def _keep_watch(self) -> None:
        """A result for every silence, at the pace of the sentences that do not come."""
        said_s = -inf
        while True:
            now_s = self._clock()
            quiet_s = now_s - self._heard_s
            if quiet_s >= self._silence_s and now_s - said_s >= self._period_s:
                said_s = now_s
                fault = Fault.TIMEOUT if self._is_open else Fault.DISCONNECTED
                self._result(now_s, {}, fault, self._silence_in_words(quiet_s) if self._is_open else self._detail)
            await asyncio.sleep(max(min(self._silence_s - quiet_s, self._period_s), 1e-3))

    def _silence_in_words(self, quiet_s: float) -> str:
        wanted = " or ".join(map(name_of, self._device.profile.sentences))
        if self._stranger:
            return f"sentences from {self._stranger} are not taken: name its network in the device's allow"
        if heard := self._reader.heard():
            return f"no {wanted} for {quiet_s:.1f} s, but {heard}: correct the profile's header, or the line's speed"
        return f"no {wanted} for {quiet_s:.1f} s: check power, cable, and that the device sends"

    def _say(self, decoded: Decoded, heard_s: float) -> None:
        self._heard_s = heard_s
        fault, detail = decoded.fault, decoded.detail
        if fault is Fault.NONE:
            fault, detail = self._liveness.judge(decoded.values, heard_s)
        self._result(heard_s, decoded.values if fault is Fault.NONE else {}, fault, detail)

    def _result(self, heard_s: float, values: Mapping[Quantity, float], fault: Fault, detail: str) -> None:
        t_s = heard_s + self._device.latency_ms * 1e-3
        reconnected = False
        if fault is Fault.NONE:
            reconnected = 0 < self._good_on < self._opened
            self._good_on = self._opened
        turned = values if self._mounting is None else self._mounting.turn(values)
        measured: dict[str, Any] = {name: value for name, value in turned.items() if name in self._wanted}
        self._on_result(
            PollResult(
                device=self._device.name,
                role=self._device.role,
                due_s=heard_s,
                sent_s=nan,
                duration_s=0.0,
                lateness_s=0.0,
                skipped=0,
                sample=KINDS[self._device.role](t_s=t_s, fault=fault, **measured),
                fault=fault,
                detail=f"{self._device.name} ({self._link}): {detail}" if detail else "",
                extra={name: value for name, value in values.items() if name not in self._wanted},
                reconnected=reconnected,
            )
        )


def _read_by(line: socket.socket, readable: Callable[[socket.socket], None]) -> Callable[[], None]:
    """Call ``readable`` with the socket whenever there is something to read; returns how that ends and it is closed."""
    loop = asyncio.get_running_loop()
    loop.add_reader(line, readable, line)

    def close() -> None:
        loop.remove_reader(line)
        line.close()

    return close


def _explained(link: AnyLink, error: OSError) -> str:
    """Why the line could not be opened, and what to do."""
    if isinstance(link, UdpListenLink):
        number = error.errno
        if number == errno.EADDRINUSE:
            return f"port {link.port} is in use: stop the other program that listens there, or choose another port"
        if number == errno.EADDRNOTAVAIL:
            return f"{link.host} is no address of this machine: write one of its own, or 0.0.0.0 for all of them"
        return f"cannot listen ({error}): check the address and the port"
    if isinstance(link, TcpLink) and isinstance(error, ConnectionRefusedError):
        return f"connection refused: check that the box serves its serial line on port {link.port}"
    assert isinstance(link, SerialLink | TcpLink)
    return explain_open_failure(link, error)
