"""A plant of simulated devices: every line of a configuration, served in this process, and those that speak."""

from __future__ import annotations

import asyncio
import time
from functools import partial
from math import inf
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from heaved.devices.link import bus_key
from heaved.links import Link, SerialLink, TcpLink, parse_link
from heaved.simulate.faults import FaultKind, PlannedFault
from heaved.simulate.slave import Answer, RtuLine, Slave, Source, TcpLine
from heaved.simulate.speaking import Speaker

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from heaved.devices.profile import DeviceSpec


class SimulatedPlant:
    """Simulated slaves for a list of devices, one line for each distinct link.

    Time runs from :meth:`start`: the source is read, and faults are scheduled, in seconds since then.
    """

    def __init__(
        self,
        devices: Sequence[DeviceSpec],
        source: Source,
        *,
        faults: Sequence[PlannedFault] = (),
        clock: Callable[[], float] = time.monotonic,
        any_port: bool = False,
        seed: int = 1,
    ) -> None:
        """With ``any_port`` TCP links keep their host and get a port of the system's choosing: see :attr:`devices`.

        Raises:
            ValueError: a link that cannot be parsed, two devices with one id on one link or with one name, one serial
                path with different settings, or a fault of a device that there is not.
        """
        self.devices = tuple(devices)
        """The devices, with the links at which they are really reached once the plant has started."""
        self._clock = clock
        self._any_port = any_port
        self._epoch_s = clock()
        self._faults: list[PlannedFault] = []
        self._changed = asyncio.Event()
        self._settled = asyncio.Event()
        self._supervisor: asyncio.Task[None] | None = None
        self._rng = np.random.default_rng([seed, 3])
        self._slaves: dict[str, dict[int, Slave]] = {}  # by bus, by device id
        self._lines: dict[str, TcpLine | RtuLine] = {}  # by bus
        self._bus_of: dict[str, str] = {}  # by name of the device
        self._speakers: dict[str, Speaker] = {}  # by name of the device; faults are for the others
        links: dict[str, Link] = {}
        for device in devices:
            if not device.is_asked:
                self._speakers[device.name] = Speaker(device, source, self.time_s, any_port=any_port)
                continue
            link = parse_link(device.link)
            bus = bus_key(link)
            if links.setdefault(bus, link) != link:
                raise ValueError(f"{device.name} wants {link}, but another device wants {links[bus]}: make them alike")
            self._add(device, bus, source)
            if bus not in self._lines:
                self._lines[bus] = self._line(bus, link)
        self.inject(*faults)

    def _add(self, device: DeviceSpec, bus: str, source: Source) -> None:
        slaves = self._slaves.setdefault(bus, {})
        if device.name in self._bus_of:
            raise ValueError(f"two devices are called {device.name!r}; give each its own name")
        if device.device_id in slaves:
            other = slaves[device.device_id].device.name
            raise ValueError(f"{device.name} and {other} have the same device_id {device.device_id} on {device.link}")
        self._bus_of[device.name] = bus
        slaves[device.device_id] = Slave(device, source)

    def _line(self, bus: str, link: Link) -> TcpLine | RtuLine:
        ask = partial(self._ask, bus)
        if isinstance(link, SerialLink):
            return RtuLine(link, ask, self._rng)
        return TcpLine(TcpLink(link.host, 0) if self._any_port else link, ask, self._rng)

    async def start(self) -> None:
        """Open every line and start the clock; none stays open if one fails.

        Raises:
            OSError: a port or path cannot be had.
        """
        try:
            for line in (*self._lines.values(), *self._speakers.values()):
                await line.open()
        except OSError:
            await self.stop()
            raise
        self.devices = tuple(self._as_reached(device) for device in self.devices)
        self._epoch_s = self._clock()
        self._supervisor = asyncio.create_task(self._supervise(), name="simulated plant")

    def _as_reached(self, device: DeviceSpec) -> DeviceSpec:
        if device.name in self._speakers:
            return self._speakers[device.name].device
        line = self._lines[self._bus_of[device.name]]
        if isinstance(line, TcpLine):
            return msgspec.structs.replace(device, link=str(TcpLink(line.host, line.port)))
        return device

    async def stop(self) -> None:
        """Close every line; the plant can be started again.

        Raises:
            OSError: a line that a fault had taken away could not be brought back meanwhile.
        """
        supervisor, self._supervisor = self._supervisor, None
        if supervisor is not None:
            supervisor.cancel()
            await asyncio.wait([supervisor])
        for line in (*self._lines.values(), *self._speakers.values()):
            await line.close()
        if supervisor is not None and not supervisor.cancelled() and (error := supervisor.exception()) is not None:
            raise error

    def time_s(self) -> float:
        """Seconds since the start: the time at which the source is read now."""
        return self._clock() - self._epoch_s

    def inject(self, *faults: PlannedFault) -> None:
        """Add faults to the plan, whose times count from the start of the plant.

        Raises:
            ValueError: a fault names a device that there is not; then none is added.
        """
        for fault in faults:
            if fault.device not in self._bus_of:
                known = ", ".join(sorted(self._bus_of))
                raise ValueError(f"fault {fault.kind.value}: there is no device {fault.device!r}; there are {known}")
        self._faults += faults
        self._replan()

    def clear(self) -> None:
        """Drop the whole plan: every device behaves from now on."""
        self._faults.clear()
        self._replan()

    def _replan(self) -> None:
        self._settled.clear()
        self._changed.set()

    async def settled(self) -> None:
        """Wait until the lines are as the plan of this moment wants them (all other faults act at once)."""
        await self._settled.wait()

    def _ask(self, bus: str, device_id: int, request: bytes, heard_s: float) -> Answer | None:
        slave = self._slaves[bus].get(device_id)
        if slave is None:
            return None
        # In this order: held up in between, a request would be older than one that came before it.
        t_s = heard_s - asyncio.get_running_loop().time() + self.time_s()
        faults = [fault for fault in self._faults if fault.device == slave.device.name and fault.active(t_s)]
        return slave.answer(request, t_s, faults)

    async def _supervise(self) -> None:
        """Take lines away and bring them back as the plan says."""
        while True:
            self._changed.clear()
            cuts = [fault for fault in self._faults if fault.kind is FaultKind.DISCONNECT]
            now = self.time_s()
            cut_off = {self._bus_of[fault.device] for fault in cuts if fault.active(now)}
            for bus, line in self._lines.items():
                wanted = bus not in cut_off
                if wanted and not line.is_open:
                    await line.open()
                elif not wanted and line.is_open:
                    await line.close()
            if not self._changed.is_set():
                self._settled.set()
            edges = [edge for fault in cuts for edge in (fault.start_s, fault.end_s) if edge > now]
            wait_s = min(edges, default=inf) - now
            try:
                async with asyncio.timeout(wait_s if wait_s < inf else None):
                    await self._changed.wait()
            except TimeoutError:
                continue
