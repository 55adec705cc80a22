"""Reading devices for a while without the daemon: each over the very bus, or line, that the daemon has."""

from __future__ import annotations

import asyncio
import socket
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.devices.bus import Bus, PollResult
from heaved.devices.link import buses
from heaved.devices.listening import Listening
from heaved.samples import Fault, ImuSample, Sample
from heaved.setup.calibrate_record import Record, record_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from heaved.config import Config
    from heaved.devices.profile import DeviceSpec

SILENT_S: Final = 5.0
"""So long without a reading of the IMU, and it is lost."""
LEAST_GOOD: Final = 0.5
"""Share of its polls that must be answered."""
LOOK_S: Final = 0.1
_MOST_SAMPLES: Final = 2_000_000
"""Half an hour at 1000 a second."""


class DeviceError(Exception):
    """A device that cannot be read; the message says which, why and what to do."""


def own_axes(device: DeviceSpec) -> DeviceSpec:
    """The device with its readings as they are: nothing turned, nothing taken off."""
    return msgspec.structs.replace(device, rotation_deg=(0.0, 0.0, 0.0), bias_mps2=(0.0, 0.0, 0.0))


def busy(config: Config) -> str:
    """Why the devices are not ours: the daemon of the configuration runs; empty: it does not."""
    host, port = config.stream.host, config.stream.port
    with suppress(OSError), socket.create_connection((host, port), timeout=1.0) as connection:
        connection.settimeout(1.0)
        heard = connection.recv(256)
        if heard.startswith(b'{"class":"VERSION"'):
            return (
                f"the daemon is running (it serves {host}:{port}) and has the devices: stop it first, as with "
                "systemctl stop heaved, and start it again afterwards"
            )
    return ""


def read_devices(
    devices: Sequence[DeviceSpec], seconds: float, progress: Callable[[float], None] = lambda _done_s: None
) -> Record:
    """What the devices say for so long, IMUs in their own axes; ``progress`` is told of the time that has passed.

    Raises:
        DeviceError: the IMU does not answer, or not often enough.
    """
    return asyncio.run(read_for(devices, seconds, progress))


async def read_for(devices: Sequence[DeviceSpec], seconds: float, progress: Callable[[float], None]) -> Record:
    """The same within a loop that runs."""
    devices = [own_axes(device) for device in devices]
    samples: list[Sample] = []
    said: dict[str, str] = {}
    polls = good = 0
    heard_s = time.monotonic()

    def note(result: PollResult) -> None:
        nonlocal polls, good, heard_s
        is_imu = isinstance(result.sample, ImuSample)
        polls += is_imu
        if result.fault is not Fault.NONE:
            said[result.device] = result.detail
        elif len(samples) < _MOST_SAMPLES:
            samples.append(result.sample)
            if is_imu:
                good += 1
                heard_s = time.monotonic()

    runs = [Bus(members, note).run() for members in buses([one for one in devices if one.is_asked]).values()]
    runs += [Listening([one], note).run() for one in devices if not one.is_asked]
    tasks = [asyncio.create_task(run) for run in runs]
    imu = next((device.name for device in devices if device.role == "imu"), "")
    try:
        started_s = 0.0
        while True:
            await asyncio.sleep(LOOK_S)
            if (ended := next((task for task in tasks if task.done()), None)) is not None:
                ended.result()
            now_s = time.monotonic()
            if now_s - heard_s > SILENT_S:
                raise DeviceError(f"no reading for {SILENT_S:.0f} s: {said.get(imu, f'{imu} says nothing')}")
            if good:
                started_s = started_s or now_s
                progress(min(now_s - started_s, seconds))
                if now_s - started_s >= seconds:
                    break
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    if good < LEAST_GOOD * polls:
        raise DeviceError(f"only {good} of {polls} polls were answered: {said.get(imu, '')}")
    return record_of(samples)
