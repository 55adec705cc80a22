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
"""So long without a first reading of the IMU, and there is none."""
LOST_S: Final = 60.0
"""In the middle of a record it may be away for so long, a plug is found again: the record has a hole then."""
AWAY_S: Final = 1.0
"""So long without a reading it is away, and the record waits for it."""
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
    devices: Sequence[DeviceSpec],
    seconds: float,
    progress: Callable[[float], None] = lambda _done_s: None,
    waiting: Callable[[str], None] = lambda _why: None,
) -> Record:
    """What the devices say for so long, IMUs in their own axes; ``progress`` is told of the time that has passed,
    ``waiting`` why it does not, once for each time.

    Raises:
        DeviceError: the IMU does not answer, or not often enough.
    """
    return asyncio.run(read_for(devices, seconds, progress, waiting))


async def read_for(
    devices: Sequence[DeviceSpec],
    seconds: float,
    progress: Callable[[float], None],
    waiting: Callable[[str], None] = lambda _why: None,
) -> Record:
    """The same within a loop that runs."""
    devices = [own_axes(device) for device in devices]
    samples: list[Sample] = []
    said: dict[str, str] = {}
    polls = good = missed = 0
    heard_s = time.monotonic()

    def note(result: PollResult) -> None:
        nonlocal polls, good, missed, heard_s
        is_imu = isinstance(result.sample, ImuSample)
        polls += is_imu
        if result.fault is not Fault.NONE:
            said[result.device] = result.detail
            missed += is_imu and result.fault is Fault.DISCONNECTED
        elif len(samples) < _MOST_SAMPLES:
            samples.append(result.sample)
            if is_imu:
                good += 1
                heard_s = time.monotonic()

    runs = [Bus(members, note).run() for members in buses([one for one in devices if one.is_asked]).values()]
    runs += [Listening([one], note).run() for one in devices if not one.is_asked]
    tasks = [asyncio.create_task(run) for run in runs]
    imu = next((device.name for device in devices if device.role == "imu"), "")
    done_s, is_away, looked_s = 0.0, False, heard_s
    try:
        while done_s < seconds:
            await asyncio.sleep(LOOK_S)
            if (ended := next((task for task in tasks if task.done()), None)) is not None:
                ended.result()
            now_s = time.monotonic()
            silent_s, passed_s, looked_s = now_s - heard_s, now_s - looked_s, now_s
            why = said.get(imu, f"{imu} says nothing")
            if silent_s > (LOST_S if good else SILENT_S):
                raise DeviceError(f"no reading for {silent_s:.0f} s: {why}")
            if good and silent_s > AWAY_S and not is_away:
                waiting(why)
            is_away = silent_s > AWAY_S
            if good and not is_away:
                done_s += passed_s
                progress(min(done_s, seconds))
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    if good < LEAST_GOOD * (polls - missed):
        raise DeviceError(f"only {good} of {polls - missed} polls were answered: {said.get(imu, '')}")
    return record_of(samples)
