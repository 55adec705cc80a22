"""A burst of polls of one sensor, and what it shows of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from math import isnan, nan
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np

from heaved.devices.link import request_time_s
from heaved.devices.probe import ReopenedLine
from heaved.devices.profile import Block, Field, Profile, Quantity, block_registers, decode, si_step
from heaved.devices.timer import DeadlineTimer, Pace
from heaved.samples import Fault
from heaved.setup import sensor_record
from heaved.setup.sensor_record import Line, Noise, RoundTrips

if TYPE_CHECKING:
    from heaved.links import Link

ACCELERATIONS: Final[tuple[Quantity, ...]] = ("ax_mps2", "ay_mps2", "az_mps2")
RATES: Final[tuple[Quantity, ...]] = ("gx_radps", "gy_radps", "gz_radps")
MOVING_MPS2: Final = 0.02
MOVING_RADPS: Final = 1e-3
"""Wandering by more than that in seconds is motion and no bias: those of cheap sensors wander by a tenth of it."""
MOST_LOST: Final = 25
"""Answers in a row that may be missing, after which it is not asked on."""

Progress = Callable[[float], None]
"""Told how many seconds have been polled."""


class Polls(msgspec.Struct):
    """Answers, each with the moment of its request."""

    sent_s: list[float] = []
    round_trips_s: list[float] = []
    registers: list[tuple[int, ...]] = []
    """Of all blocks, one after the other."""
    values: list[dict[Quantity, float]] = []
    lost: dict[str, int] = {}
    """Answers that were none, by the reason."""


async def poll(
    polls: Polls,
    link: Link,
    device_id: int,
    blocks: Sequence[Block],
    *,
    seconds: float,
    timeout_s: float,
    rate_hz: float | None = None,
    progress: Progress | None = None,
    each: Callable[[Polls], None] | None = None,
    most_lost: float = MOST_LOST,
) -> None:
    """Ask for all ``blocks``, again and again: ``rate_hz`` times a second, None: as fast as it goes. ``polls`` is
    filled with what comes, and holds it whatever ends the asking.

    ``each``: told after every request, with all answers there are. ``most_lost``: in a row, then nobody is there.

    Raises:
        ConnectionError: the line cannot be opened, was lost, or nobody answers any more; says why and what to do.
    """
    with DeadlineTimer() as timer:
        line = ReopenedLine(link, timer)
        try:
            await line.open()
            begun_s = time.monotonic()
            pace = None if rate_hz is None else Pace(1.0 / rate_hz, begun_s)
            in_a_row = 0
            while (now_s := time.monotonic()) < begun_s + seconds:
                if progress is not None:
                    progress(now_s - begun_s)
                if pace is not None:
                    pace.advance(now_s)
                    await timer.wait_until(pace.due_s)
                fault = await _once(line, device_id, blocks, timeout_s, polls)
                in_a_row = in_a_row + 1 if fault else 0
                if in_a_row >= most_lost:
                    raise ConnectionError(f"id {device_id} has stopped answering: {fault}")
                if each is not None:
                    each(polls)
        finally:
            line.close()


async def _once(line: ReopenedLine, device_id: int, blocks: Sequence[Block], timeout_s: float, polls: Polls) -> str:
    """One poll. Returns why there is none; empty: there is."""
    registers: list[int] = []
    values: dict[Quantity, float] = {}
    sent_s = nan
    for block in blocks:
        answer = await line.read(device_id, block, block_registers(block), timeout_s)
        fault, detail = answer.fault, answer.detail
        if fault is Fault.NONE:
            decoded = decode(block, answer.registers)
            fault, detail = decoded.fault, decoded.detail
            values |= decoded.values
        if fault is not Fault.NONE:
            polls.lost[detail] = polls.lost.get(detail, 0) + 1
            return detail
        registers += answer.registers
        sent_s = answer.sent_s if isnan(sent_s) else sent_s
    polls.sent_s.append(sent_s)
    polls.round_trips_s.append(time.monotonic() - sent_s)
    polls.registers.append(tuple(registers))
    polls.values.append(values)
    return ""


# ---- what it shows ---------------------------------------------------------------------------------------------------


class Channel(msgspec.Struct, frozen=True, kw_only=True):
    """What was seen of one quantity."""

    quantity: Quantity
    noise: Noise
    lines: list[Line]


class Measured(msgspec.Struct, frozen=True, kw_only=True):
    """What a burst of polls shows of a sensor."""

    seconds: float
    pace: sensor_record.Pace
    round_trips: RoundTrips
    wire_s: float
    """Of a poll, the time that the line takes for itself."""
    age_spread_s: float
    """By how much the age of an answer varies, by the device's own clock; nan: it tells no time."""
    channels: list[Channel]


def measured(polls: Polls, profile: Profile, link: Link, bandwidth_hz: float) -> Measured:
    """What the polls of a device with such a profile show. ``bandwidth_hz``: of its low-pass, 0: not known."""
    t_s = np.array(polls.sent_s)
    device_s = np.array([values.get("device_time_s", nan) for values in polls.values])
    tells_time = len(device_s) > 0 and not np.isnan(device_s).any()
    if tells_time:
        is_new = np.concatenate(([True], np.diff(device_s) != 0.0))
    else:
        is_new = np.array([i == 0 or polls.registers[i] != polls.registers[i - 1] for i in range(len(t_s))], dtype=bool)
    pace = sensor_record.pace(t_s, is_new)
    fields = {field.quantity: field for block in profile.blocks for field in block.fields}
    channels = []
    for quantity in (*ACCELERATIONS, *RATES):
        if quantity in fields and len(t_s):
            x = np.array([values[quantity] for values in polls.values])
            channels.append(_channel(fields[quantity], *sensor_record.measured(t_s, x, is_new, pace), bandwidth_hz))
    return Measured(
        seconds=float(t_s[-1] - t_s[0]) if len(t_s) else 0.0,
        pace=pace,
        round_trips=sensor_record.round_trips(polls.round_trips_s, sum(polls.lost.values())),
        wire_s=request_time_s(link, profile),
        age_spread_s=sensor_record.age_spread_s(t_s, device_s) if tells_time else nan,
        channels=channels,
    )


def _channel(field: Field, t_s: sensor_record.Array, x: sensor_record.Array, bandwidth_hz: float) -> Channel:
    found = sensor_record.lines(t_s, x)
    moving = MOVING_MPS2 if field.quantity in ACCELERATIONS else MOVING_RADPS
    return Channel(
        quantity=field.quantity,
        noise=sensor_record.noise(
            t_s, x, bandwidth_hz=bandwidth_hz, step=si_step(field), moving=moving, shaken_by=found
        ),
        lines=found,
    )
