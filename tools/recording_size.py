"""What a recording costs: megabytes a day, group by group, and microseconds of the daemon's loop.

    python tools/recording_size.py [--minutes 60] [--sea S5] [--imu witmotion-wt901c485] [--record]

An IMU at 100 Hz with gyros and attitude, a laser at 20 Hz, in a simulated sea; the pipeline with all its forecasts and
predictions runs as in the daemon, its fits where they are due. What is written is what the recorder writes: an hour as
a stream of Arrow, and the Parquet that becomes of it.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter, defaultdict
from math import isfinite, nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import pyarrow.parquet as pq
from evidence import results
from evidence.results import Report

from heaved.config.read import data_directory, load, packaged_profiles
from heaved.daemon.daemon import make_pipeline
from heaved.daemon.recorded import FramePacker, PollPacker, layout_of
from heaved.devices.profile import decode, encode
from heaved.devices.station import KINDS, PollResult
from heaved.estimation.heave.sea.refit import look
from heaved.recorder import messages
from heaved.recorder.calls import pack_fit
from heaved.recorder.files import to_parquet
from heaved.recorder.layout import CALLS, Call, Header, Settings
from heaved.recorder.messages import Kind, Splitter, packed
from heaved.recorder.serve import Recorder
from heaved.simulate.instruments import Instruments
from heaved.simulate.seaway import seaway

if TYPE_CHECKING:
    from collections.abc import Mapping

    from heaved.config import Config
    from heaved.devices.profile import DeviceSpec
    from heaved.samples import Sample

BEGAN_S = 100_000.0
"""Monotonic time of a machine that has been up for a day."""
JITTER_S = 30e-6
"""Of the moment at which a poll is sent; a busy machine."""
LASER_EVERY = 5
SECONDS_A_DAY = 86400.0


def sample_of(device: DeviceSpec, instruments: Instruments, t_s: float) -> Sample:
    """What a poll gives: through the registers of the device and back."""
    measured = instruments.read(device, t_s - BEGAN_S)
    block = device.profile.blocks[0]
    names = [field.quantity for field in block.fields if isfinite(getattr(measured, field.quantity, nan))]
    values: dict[Any, float] = dict(
        decode(block, encode(block, {name: getattr(measured, name) for name in names})).values
    )
    kind: Any = KINDS[device.role]
    sample: Sample = kind(t_s=t_s, **{name: values[name] for name in values if name in kind.__struct_fields__})
    return sample


def result_of(device: DeviceSpec, sample: Sample) -> PollResult:
    return PollResult(
        device=device.name, role=device.role, due_s=sample.t_s, sent_s=sample.t_s, duration_s=0.0, lateness_s=0.0,
        skipped=0, sample=sample, fault=sample.fault, detail="", extra={}, reconnected=False,
    )  # fmt: skip


def write(directory: Path, config: Config, minutes: float, sea: str) -> dict[str, float]:
    """Record so many minutes; seconds that packing took the loop, by kind, per message."""
    pipeline = make_pipeline(config)
    instruments = Instruments(seaway(sea, 1), seed=1)
    frames = FramePacker(config)
    layout = layout_of(config, frames)
    polls = [PollPacker(i, device) for i, device in enumerate(layout.devices)]
    recorder, splitter = Recorder(lambda _: None, lambda: None), Splitter()
    settings = Settings(directory=str(directory), max_bytes=10**15, max_age_s=1e12, batch_s=1.0)
    header = Header(
        vessel="simulated", run="run", release="0", began_utc_s=0.0, layout=layout,
        config=msgspec.Raw(msgspec.json.encode(config)), learned=msgspec.Raw(b"null"),
    )  # fmt: skip
    rng = np.random.default_rng(1)
    took_s, told, seq = defaultdict[str, float](float), Counter[str](), 0

    def tell(data: bytes, t_s: float) -> None:
        for kind, body in splitter.push(data):
            recorder.take(kind, body, t_s)
        recorder.look(t_s)

    tell(
        packed(Kind.SETTINGS, msgspec.json.encode(settings)) + packed(Kind.HEADER, msgspec.json.encode(header)), BEGAN_S
    )
    for k in range(round(6000.0 * minutes)):
        for i, device in enumerate(config.device):
            if i > 0 and k % LASER_EVERY:
                continue
            t_s = BEGAN_S + 0.01 * k + 1e-4 * i + JITTER_S * abs(rng.normal())
            result = result_of(device, sample_of(device, instruments, t_s))
            frame = pipeline.step(result.sample)
            begun_s = time.perf_counter()
            data = polls[i].pack(result, seq)
            took_s["sample"] += time.perf_counter() - begun_s
            told["sample"] += 1
            seq += 1
            if frame is not None:
                begun_s = time.perf_counter()
                data += frames.pack(frame)
                took_s["frame"] += time.perf_counter() - begun_s
                told["frame"] += 1
            tell(data, t_s)
        pipeline.training_due()
        if (past := pipeline.fit_due()) is not None:
            fit = look(past)
            pipeline.accept_fit(fit)
            body = messages.CALL.pack(seq, CALLS.index(Call.FIT), t_s) + pack_fit(fit)
            tell(packed(Kind.CALL, body), t_s)
            seq += 1
    recorder.close(t_s)
    return {kind: took_s[kind] / told[kind] for kind in told}


def group_of(table: str, name: str, roles: Mapping[str, str]) -> str:
    """What a column is part of, for people."""
    if table == "samples":
        device = name.partition(".")[0]
        return (
            f"samples: {roles[device]}" if "." in name else "samples: models" if name == "record" else "samples: calls"
        )
    for key, group in (("forecast_", "forecasts"), ("delayed_", "delayed heave"), ("sea", "sea")):
        if name.startswith(key):
            return f"frames: {group}"
    axis, _, rest = name.partition("_")
    if axis in ("roll", "pitch", "yaw") and rest[:1].isdigit():
        kind = "intervals" if "interval" in rest else "deviations" if "std" in rest else "angles"
        return f"frames: predicted {kind}"
    return "frames: the motion itself"


def sizes(directory: Path, roles: Mapping[str, str], per_day: float) -> list[str]:
    """Rows of the table: what the streams are while they last, and the Parquet that becomes of them, by group."""
    groups: Counter[str] = Counter()
    rows = []
    for stream in sorted(directory.glob("*.arrows")):
        size, begun_s = stream.stat().st_size, time.perf_counter()
        to_parquet(stream)
        took_s = time.perf_counter() - begun_s
        table = stream.name.split(".")[1]
        rows.append(f"| {table}, the stream while it lasts (Parquet in {took_s:.1f} s) | {1e-6 * size * per_day:.0f} |")
        with pq.ParquetFile(stream.with_suffix(".parquet")) as file:
            for number in range(file.metadata.num_row_groups):
                group = file.metadata.row_group(number)
                for i in range(group.num_columns):
                    column = group.column(i)
                    groups[group_of(table, column.path_in_schema, roles)] += column.total_compressed_size
    rows += [f"| {name} | {1e-6 * size * per_day:.1f} |" for name, size in groups.most_common()]
    whole = sum(path.stat().st_size for path in directory.glob("*.parquet"))
    return [*rows, f"| **all, as Parquet** | **{1e-6 * whole * per_day:.0f}** |"]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--sea", default="S5")
    parser.add_argument("--imu", default="witmotion-wt901c485", help="profile of the IMU")
    parser.add_argument("--record", action="store_true", help="put it into tools/RESULTS.md")
    given = parser.parse_args()
    made_with, begun_s = results.provenance(), time.monotonic()
    config = load(data_directory() / "demo.toml")
    profile = next(one for one in packaged_profiles() if one.name == given.imu)
    imu = msgspec.structs.replace(config.device[0], profile=profile)
    laser = next(device for device in config.device if device.role == "laser")
    config = msgspec.structs.replace(config, device=(imu, laser), point=(), crane=type(config.crane)())
    with tempfile.TemporaryDirectory() as name:
        took_s = write(Path(name), config, given.minutes, given.sea)
        roles = {device.name: device.role for device in config.device}
        rows = sizes(Path(name), roles, SECONDS_A_DAY / (60.0 * given.minutes))
    costs = f"The loop packs a frame in {1e6 * took_s['frame']:.1f} µs, a sample in {1e6 * took_s['sample']:.1f} µs."
    report = Report("\n".join(["| what | MB a day |", "|---|---|", *rows, "", costs]), (1,))
    print(report.text)
    if given.record:
        results.record(__file__, sys.argv[1:], report, made_with, time.monotonic() - begun_s)
    return 0


if __name__ == "__main__":
    sys.exit(main())
