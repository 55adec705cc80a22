"""A simulated device that speaks by itself: its telegrams on a pseudo-terminal, a TCP port, or to a UDP port.

Telegrams are those that heaved itself writes (:mod:`heaved.outputs.telegrams`), of the format that the device's profile
reads.
"""

from __future__ import annotations

import asyncio
import os
import pty
import socket
import time
import tty
from contextlib import suppress
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.devices.listening import SCHEMES
from heaved.links import SerialLink, TcpLink, UdpListenLink, parse_any_link
from heaved.outputs.motion import Motion
from heaved.outputs.telegrams.formats import FORMATS
from heaved.outputs.telegrams.spec import OutputSpec, Telegram, as_read
from heaved.samples import HeaveState, MruSample

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.devices.profile import DeviceSpec
    from heaved.simulate.slave import Source

_TELEGRAMS: Final = {
    ":": Telegram.TSS1,
    "$PASHR": Telegram.PASHR,
    "$PSXN,23": Telegram.PSXN,
    "$PRDID": Telegram.PRDID,
    "$PNORSUB2": Telegram.PNORSUB2,
}
"""By the header that a profile reads."""
_MOST_BYTES: Final = 1 << 16
"""That wait for a listener; one who takes nothing any more is hung up on."""
_LATEST_S: Final = 0.5
"""After a machine that has slept it goes on from now."""


class Speaker:
    """One device.

    Attributes:
        device: with the link at which it is reached, once it is open.
    """

    def __init__(self, device: DeviceSpec, source: Source, time_s: Callable[[], float], *, any_port: bool) -> None:
        """``time_s``: of the simulation. ``any_port``: a TCP port of the system's choosing.

        Raises:
            ValueError: nothing of the kind is simulated, or its link cannot be parsed.
        """
        if device.role != "reference_mru":
            raise ValueError(f"{device.name} speaks by itself: of those only a reference_mru is simulated")
        headers = [sentence.header for sentence in device.profile.sentences]
        told = next((_TELEGRAMS[header] for header in headers if header in _TELEGRAMS), None)
        if told is None:
            raise ValueError(
                f"{device.name}: no telegram that is simulated begins with {' or '.join(headers)}; "
                f"there are {', '.join(_TELEGRAMS)}"
            )
        self.device = device
        self._link = parse_any_link(device.link, SCHEMES)
        self._source, self._time_s, self._any_port = source, time_s, any_port
        self._format = FORMATS[told]
        self._spec = OutputSpec(name=device.name, telegram=told, link="")
        self._say: Callable[[bytes], None] = lambda _data: None
        self._close: Callable[[], None] = lambda: None
        self._listeners: set[asyncio.StreamWriter] = set()
        self._server: asyncio.Server | None = None
        self._task: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Begin to speak.

        Raises:
            OSError: a port or path cannot be had.
        """
        link = self._link
        if isinstance(link, SerialLink):
            self._open_line(Path(link.path))
        elif isinstance(link, TcpLink):
            port = 0 if self._any_port else link.port
            self._server = await asyncio.start_server(self._listens, link.host, port)
            host, port = self._server.sockets[0].getsockname()[:2]
            self.device = msgspec.structs.replace(self.device, link=str(TcpLink(host, port)))
            self._say = self._to_all
        else:
            assert isinstance(link, UdpListenLink)
            line = socket.socket(socket.AF_INET6 if ":" in link.host else socket.AF_INET, socket.SOCK_DGRAM)
            line.setblocking(False)
            # Nobody may listen there yet, or any more.
            here = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(link.host, link.host)  # noqa: S104  # Compared, not bound.
            self._say = lambda data: _unless_in_vain(lambda: line.sendto(data, (here, link.port)))
            self._close = line.close
        self._task = asyncio.create_task(self._speak(), name=f"simulated {self.device.name}")

    async def close(self) -> None:
        """Fall silent, and give the line back."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait([self._task])
            self._task = None
        for writer in self._listeners:
            writer.transport.abort()
        self._listeners.clear()
        if self._server is not None:
            self._server.close()
            self._server = None
        self._close()
        self._close = lambda: None

    def _open_line(self, path: Path) -> None:
        """A pseudo-terminal, reached through a symbolic link at the path."""
        if path.exists() and not path.is_symlink():
            raise FileExistsError(
                f"{path} exists and is not a symbolic link: a simulated line would replace it; give another path"
            )
        line, device = pty.openpty()
        tty.setraw(device)
        os.set_blocking(line, False)
        path.unlink(missing_ok=True)
        name = os.ttyname(device)
        path.symlink_to(name)

        def close() -> None:
            os.close(line)
            os.close(device)  # Our hold on it keeps the line up while nobody has opened it.
            if path.is_symlink() and str(path.readlink()) == name:
                path.unlink()

        self._say, self._close = (lambda data: _unless_in_vain(lambda: os.write(line, data))), close

    async def _listens(self, _reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._listeners.add(writer)

    def _to_all(self, data: bytes) -> None:
        for writer in [*self._listeners]:
            if writer.is_closing() or writer.transport.get_write_buffer_size() > _MOST_BYTES:
                self._listeners.discard(writer)
                writer.transport.abort()
            else:
                writer.write(data)

    async def _speak(self) -> None:
        period_s = 1.0 / self.device.rate_hz
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            self._say(self.telegram(self._time_s()))
            due_s += period_s
            if loop.time() - due_s > _LATEST_S:
                due_s = loop.time()
            await asyncio.sleep(max(due_s - loop.time(), 0.0))

    def telegram(self, t_s: float) -> bytes:
        """What it says at ``t_s`` of the simulation."""
        sample = self._source.read(self.device, t_s)
        assert isinstance(sample, MruSample)
        told = Motion(
            utc_s=time.time(),
            age_s=0.0,
            state=HeaveState.INVALID if isnan(sample.heave_m) else HeaveState.VALID,
            heave_m=sample.heave_m,
            heave_velocity_mps=sample.heave_velocity_mps,
            heave_acceleration_mps2=0.0,
            surge_acceleration_mps2=0.0,
            sway_acceleration_mps2=0.0,
            roll_rad=sample.roll_rad,
            pitch_rad=sample.pitch_rad,
            yaw_rad=sample.yaw_rad,
        )
        return self._format.encode(as_read(told, self._spec, self._format.signs), self._spec)


def _unless_in_vain(send: Callable[[], object]) -> None:
    """A line does not wait for who reads it: what nobody takes is lost."""
    with suppress(OSError):
        send()
