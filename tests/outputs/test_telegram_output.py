"""An output from the frame to the far end: what is due, for which moment, with which signs; what cannot be said."""

from __future__ import annotations

import asyncio
import socket
from contextlib import suppress
from math import isfinite, nan, radians
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from output_peers import free_port, heard, kept, refuse_to_read, until
from stream_peers import Clock, make_frame

from heaved.outputs.motion import Lead, Motion
from heaved.outputs.telegram_output import TelegramOutput
from heaved.outputs.telegrams.spec import (
    Format,
    HeavePositive,
    OutputSpec,
    PitchPositive,
    RollPositive,
    Signs,
    Telegram,
)
from heaved.samples import HeaveState, MotionFrame, PointMotion

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

FRAME = msgspec.structs.replace(
    make_frame(100.0), heave_acceleration_mps2=0.0, points=(PointMotion(name="tip", heave_m=3.0, heave_std_m=0.1),)
)


class Recorder:
    """A format that keeps what it is asked to encode."""

    def __init__(self, **changes: Any) -> None:
        self.told: list[Motion] = []
        plain = Format(title="TEST", encode=self.encode, longest_bytes=40, lead=Lead.TRANSMISSION)
        self.format = msgspec.structs.replace(plain, **changes)

    def encode(self, motion: Motion, spec: OutputSpec) -> bytes:
        self.told.append(motion)
        return b"%+08.3f\r\n" % motion.heave_m if isfinite(motion.heave_m) else b""


class Far:
    """A place that datagrams are sent to."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.link = f"udp://127.0.0.1:{self.socket.getsockname()[1]}"

        self.heard: list[bytes] = []

    def hear(self) -> int:
        """How many there are by now."""
        with suppress(BlockingIOError):
            while True:
                self.heard.append(self.socket.recv(2048))
        return len(self.heard)


@pytest.fixture
async def far() -> AsyncIterator[Far]:
    found = Far()
    yield found
    found.socket.close()


def make_output(link: str, form: Format, clock: Clock, **changes: Any) -> TelegramOutput:
    spec = OutputSpec(name="plc", telegram=Telegram.TSS1, link=link, rate_hz=100.0)
    return TelegramOutput(msgspec.structs.replace(spec, **changes), form, lambda t_s: 1.7e9 + t_s, clock)


def at(t_s: float, **changes: Any) -> MotionFrame:
    return msgspec.structs.replace(FRAME, t_s=t_s, **changes)


@pytest.mark.parametrize(
    ("frames_hz", "rate_hz", "count"), [(100, 25, 250), (100, 30, 300), (20, 20, 200), (20, 3, 30)]
)
async def test_the_rate_is_the_wanted_one(far: Far, frames_hz: int, rate_hz: float, count: int) -> None:
    clock, recorder = Clock(), Recorder()
    output = make_output(far.link, recorder.format, clock, rate_hz=rate_hz)
    async with kept(output):
        await until(lambda: output._sender.has_reader)
        for i in range(10 * frames_hz):
            clock.now_s = i / frames_hz + 0.002
            output.publish(at(i / frames_hz))
            far.hear()
        await until(lambda: far.hear() >= output.health.sent)
    assert output.health.sent == len(far.heard) == len(recorder.told) == pytest.approx(count, abs=1)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        # The frame is 20 ms old; its velocity is -0.5 m/s.
        ({}, {"heave_m": 1.25 - 0.02 * 0.5, "utc_s": 1.7e9 + 100.02, "age_s": 0.02}),
        ({"lead": Lead.NONE}, {"heave_m": 1.25, "utc_s": 1.7e9 + 100.0, "pitch_rad": -0.05}),
        ({"lead": Lead.NONE, "point": "tip"}, {"heave_m": 3.0, "heave_std_m": 0.1}),
        ({"lead": Lead.NONE, "heave_positive": HeavePositive.DOWN}, {"heave_m": -1.25, "heave_velocity_mps": 0.5}),
        ({"lead": Lead.NONE, "roll_positive": RollPositive.STARBOARD_UP}, {"roll_rad": -0.1, "pitch_rad": -0.05}),
        ({"lead": Lead.NONE, "pitch_positive": PitchPositive.BOW_DOWN}, {"roll_rad": 0.1, "pitch_rad": 0.05}),
    ],
)
async def test_place_moment_and_signs(far: Far, changes: dict[str, Any], expected: dict[str, float]) -> None:
    clock, recorder = Clock(), Recorder()
    output = make_output(far.link, recorder.format, clock, **changes)
    async with kept(output):
        await until(lambda: output._sender.has_reader)
        clock.now_s = 100.02
        output.publish(FRAME)
    (motion,) = recorder.told
    assert {name: getattr(motion, name) for name in expected} == pytest.approx(expected)


async def test_signs_are_those_of_the_format_unless_they_are_said(far: Far) -> None:
    recorder = Recorder(signs=Signs(heave=HeavePositive.DOWN, pitch=PitchPositive.BOW_DOWN), lead=Lead.NONE)
    output = make_output(far.link, recorder.format, Clock(), pitch_positive=PitchPositive.BOW_UP)
    async with kept(output):
        await until(lambda: output._sender.has_reader)
        output.publish(FRAME)
    assert (recorder.told[0].heave_m, recorder.told[0].pitch_rad) == (-1.25, -0.05)


async def test_what_the_format_cannot_say_is_not_said(far: Far) -> None:
    clock, recorder = Clock(), Recorder()
    output = make_output(far.link, recorder.format, clock)
    async with kept(output):
        await until(lambda: output._sender.has_reader)
        for i in range(5):
            clock.now_s = 0.1 * i
            output.publish(at(0.1 * i, heave_m=nan if i % 2 else radians(30.0)))
    assert (output.health.sent, dict(output.health.lost)) == (3, {"not known": 2})
    assert [motion.state for motion in recorder.told][1] is HeaveState.INVALID


async def test_nothing_is_encoded_for_nobody() -> None:
    recorder = Recorder()
    alone = make_output(f"tcp-listen://127.0.0.1:{free_port()}", recorder.format, Clock())
    broken = make_output(f"tcp://127.0.0.1:{free_port()}", recorder.format, Clock())
    async with kept(alone), kept(broken):
        await until(lambda: alone.health.is_up and "nobody reads" in broken.health.detail)
        for i in range(10):
            alone.publish(at(0.1 * i))
            broken.publish(at(0.1 * i))
    assert not recorder.told
    assert dict(alone.health.lost) == {}  # Nobody misses anything.
    assert dict(broken.health.lost) == {"down": 10}


async def test_one_that_is_stuck_costs_the_other_nothing(far: Far) -> None:
    clock = Clock()
    with socket.socket() as listening:
        refuse_to_read(listening)
        listening.bind(("127.0.0.1", 0))
        listening.listen()
        listening.setblocking(False)
        stuck = make_output(f"tcp://127.0.0.1:{listening.getsockname()[1]}", Recorder().format, clock)
        well = make_output(far.link, Recorder().format, clock)
        async with kept(stuck), kept(well):
            await until(lambda: stuck._sender.has_reader and well._sender.has_reader)
            count = 0
            while not stuck.health.lost["slow"]:
                clock.now_s = 0.01 * count
                for output in (stuck, well):
                    output.publish(at(0.01 * count))
                count += 1
                await asyncio.sleep(0)
                far.hear()
            await until(lambda: far.hear() == count)
            connection, _ = listening.accept()
            with connection:
                connection.setblocking(False)
                assert (await heard(connection, 10)).endswith(b"\r\n")
    assert (well.health.sent, dict(well.health.lost)) == (count, {})
