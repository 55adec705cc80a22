"""Recordings as a daemon makes them, without one: polls and frames packed, written by the process's own code."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import msgspec
from running import demo_config

from heaved.daemon.recorded import FramePacker, PollPacker, layout_of
from heaved.devices.profile import decode, encode
from heaved.devices.station import KINDS, PollResult
from heaved.recorder import messages
from heaved.recorder.layout import Header, Report, Settings
from heaved.recorder.messages import Kind, Splitter, packed
from heaved.recorder.serve import Recorder
from heaved.samples import (
    CorrectionState,
    DelayedHeave,
    HeaveForecast,
    HeaveState,
    LaserState,
    MotionFrame,
    Quality,
    RockPrediction,
    Sample,
)

if TYPE_CHECKING:
    from pathlib import Path

    from heaved.config import Config
    from heaved.devices.profile import DeviceSpec

BEGAN_S = 5000.0
"""Monotonic."""
OFFSET_S = 1.8e9 - BEGAN_S
"""UTC minus that."""
QUALITY = Quality(
    heave=HeaveState.VALID, laser=LaserState.VALID, correction=CorrectionState.OFF, reasons=("one", "two")
)


class Scribe:
    """Makes the messages of a daemon: an IMU at 100 Hz, every fifth time a laser, a frame for each IMU sample.

    Attributes:
        frames: that were told.
        samples: likewise.
    """

    def __init__(self, directory: Path, *, vessel: str = "Test", run: str = "run", **changes: Any) -> None:
        self.config: Config = demo_config(directory, **changes)
        self._packer = FramePacker(self.config)
        self.layout = layout_of(self.config, self._packer)
        self._polls = [PollPacker(i, device) for i, device in enumerate(self.layout.devices)]
        self._vessel, self._run = vessel, run
        self.frames: list[MotionFrame] = []
        self.samples: list[Sample] = []

    def settings(self, directory: Path, **changes: Any) -> bytes:
        usual: dict[str, Any] = {"directory": str(directory), "max_bytes": 10**12, "max_age_s": 1e12}
        return packed(Kind.SETTINGS, msgspec.json.encode(Settings(**(usual | changes))))

    def header(self, began_utc_s: float = OFFSET_S + BEGAN_S) -> bytes:
        self._packer.begin()
        header = Header(
            vessel=self._vessel,
            run=self._run,
            release="0",
            began_utc_s=began_utc_s,
            layout=self.layout,
            config=msgspec.Raw(msgspec.json.encode(self.config)),
            learned=msgspec.Raw(b"null"),
        )
        return packed(Kind.HEADER, msgspec.json.encode(header))

    def offset(self, offset_s: float = OFFSET_S) -> bytes:
        return packed(Kind.OFFSET, messages.OFFSET.pack(offset_s))

    def instant(self, k: int) -> bytes:
        """What is told of the ``k``-th hundredth of a second."""
        t_s = BEGAN_S + 0.01 * k + 1e-5 * math.sin(k)
        told = b""
        for i, device in enumerate(self.config.device):
            if i == 0 or k % 5 == 0:
                told += self._poll(i, device, t_s + 1e-4 * i, k)
        frame = frame_at(t_s, k)
        self.frames.append(frame)
        return told + self._packer.pack(frame)

    def instants(self, first: int, last: int) -> bytes:
        return b"".join(self.instant(k) for k in range(first, last))

    def _poll(self, number: int, device: DeviceSpec, t_s: float, k: int) -> bytes:
        block = device.profile.blocks[0]
        wanted = {field.quantity: 0.3 * math.sin(0.01 * k + j) for j, field in enumerate(block.fields)}
        kind: Any = KINDS[device.role]
        found = decode(block, encode(block, wanted)).values
        sample = kind(t_s=t_s, **{name: found[name] for name in found if name in kind.__struct_fields__})
        self.samples.append(sample)
        return self._polls[number].pack(result_of(device, sample), len(self.samples) - 1)


def result_of(device: DeviceSpec, sample: Sample) -> PollResult:
    return PollResult(
        device=device.name, role=device.role, due_s=sample.t_s, sent_s=sample.t_s, duration_s=0.0, lateness_s=0.0,
        skipped=0, sample=sample, fault=sample.fault, detail="", extra={}, reconnected=False,
    )  # fmt: skip


def frame_at(t_s: float, k: int) -> MotionFrame:
    wave = math.sin(0.01 * k)
    return MotionFrame(
        t_s=t_s,
        quality=QUALITY,
        heave_m=wave,
        heave_std_m=0.02,
        heave_velocity_mps=0.01 * math.cos(0.01 * k),
        observer_m=wave,
        roll_rad=0.1 * wave,
        pitch_rad=-0.05 * wave,
        forecast=tuple(
            HeaveForecast(horizon_s=h, heave_m=wave + h, std_m=0.1 * h) for h in (0.05, 0.1, 0.15, 0.5, 1.0, 2.0, 5.0)
        ),
        rock=tuple(RockPrediction(horizon_s=h, roll_rad=0.1 * wave * h, roll_std_rad=0.01) for h in (0.05, 0.1, 0.15)),
        delayed=DelayedHeave(t_s=t_s - 60.0, heave_m=math.sin(0.01 * k - 60.0), std_m=0.01),
    )


class Desk:
    """The recorder's own code, in this process, with a clock that the test moves."""

    def __init__(self, directory: Path, scribe: Scribe, **settings: Any) -> None:
        self.reports: list[Report] = []
        self.recorder = Recorder(self.reports.append, lambda: None)
        self._splitter = Splitter()
        self.now_s = 0.0
        self.told(scribe.settings(directory, **settings))

    def told(self, data: bytes, elapsed_s: float = 0.0) -> None:
        self.now_s += elapsed_s
        for kind, body in self._splitter.push(data):
            self.recorder.take(kind, body, self.now_s)
        self.recorder.look(self.now_s)


def write_recording(directory: Path, scribe: Scribe, seconds: int, *, first_s: int = 0) -> None:
    """So many seconds of it, in batches of one, as streams of Arrow."""
    directory.mkdir(exist_ok=True)
    desk = Desk(directory, scribe)
    desk.told(scribe.header(OFFSET_S + BEGAN_S + first_s) + scribe.offset())
    for second in range(first_s, first_s + seconds):
        desk.told(scribe.instants(100 * second, 100 * second + 100))
        desk.recorder.write(desk.now_s)
    desk.recorder.close(desk.now_s)
