"""What is told to the recorder comes back: samples to the last bit, frames to half of what a count is worth."""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING, Any, get_args

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded_hours import OFFSET_S, Scribe, frame_at, result_of, write_recording

from heaved.config.read import data_directory, load, packaged_profiles
from heaved.daemon.recorded import FramePacker, PollPacker, device_of
from heaved.devices.profile import BlockCodec, DeviceSpec, Role, block_registers, role_quantities
from heaved.devices.station import KINDS
from heaved.recorder.layout import FRAMES, SAMPLES, Column, Header, Layout
from heaved.recorder.messages import HEAD, Kind, MessageError, Splitter, packed
from heaved.recorder.read import frame_values, open_recorded, rows_of
from heaved.recorder.tables import SampleRows, restored, samples_of, stored
from heaved.samples import Fault, ImuSample

if TYPE_CHECKING:
    from pathlib import Path

ANY = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True)


def bits(value: float) -> bytes:
    """Of a double; all nan are alike."""
    return b"nan" if math.isnan(value) else struct.pack("<d", value)


def header_of(devices: tuple[DeviceSpec, ...]) -> Header:
    layout = Layout(devices=tuple(map(device_of, devices)), numbers=(), texts=(), lasting=())
    raw = msgspec.Raw(b"null")
    return Header(vessel="", run="", release="", began_utc_s=0.0, layout=layout, config=raw, learned=raw)


DEVICES = tuple(
    DeviceSpec(name=f"device{i}", role=role, link="tcp://127.0.0.1:1", profile=profile, rate_hz=1.0)
    for i, profile in enumerate(packaged_profiles())
    for role in get_args(Role)
    if profile.blocks and set(role_quantities(role)) & {f.quantity for block in profile.blocks for f in block.fields}
)


@given(st.data())
def test_whatever_the_registers_say_comes_back_to_the_last_bit(data: st.DataObject) -> None:
    """Of every device that we know, whatever stands in its registers."""
    spec = data.draw(st.sampled_from(DEVICES))
    said: dict[Any, float] = {}
    for block in spec.profile.blocks:
        words = data.draw(st.lists(st.integers(0, 65535), min_size=(n := block_registers(block)), max_size=n))
        said |= BlockCodec(block).decode(words).values
    kind: Any = KINDS[spec.role]
    t_s = data.draw(st.floats(min_value=-1e9, max_value=1e9))
    sample = kind(t_s=t_s, **{name: said[name] for name in said if name in kind.__struct_fields__})
    check(spec, [sample], beside_allowed=False)


@given(st.lists(st.builds(
    ImuSample, t_s=st.floats(allow_nan=False, allow_infinity=False),
    ax_mps2=ANY, az_mps2=ANY, roll_rad=ANY, gz_radps=ANY,
    fault=st.sampled_from(Fault),
), min_size=1, max_size=5))  # fmt: skip
def test_what_no_register_can_say_comes_back_as_well(samples: list[ImuSample]) -> None:
    check(load(data_directory() / "demo.toml").device[0], samples, beside_allowed=True)


def check(spec: DeviceSpec, samples: list[Any], *, beside_allowed: bool) -> None:
    header = header_of((spec,))
    rows = SampleRows(header)
    packer = PollPacker(0, header.layout.devices[0])
    for seq, sample in enumerate(samples):
        for _, body in Splitter().push(packer.pack(result_of(spec, sample), seq)):
            rows.push_sample(body, OFFSET_S)
    batch = rows.batch()
    columns = header.layout.devices[0].columns
    for column, values in zip(columns, samples_of(columns, spec.name, batch), strict=True):
        expected = [bits(getattr(sample, column.name, math.nan)) for sample in samples]
        assert [bits(value) for value in values.tolist()] == expected, column.name
        if not beside_allowed:
            assert batch.column(f"{spec.name}.{column.name}.exact").null_count == len(samples)
    times = batch.column("t_s").to_numpy(zero_copy_only=False).view(np.float64)
    assert [bits(t) for t in times.tolist()] == [bits(sample.t_s) for sample in samples]
    faults = [None if sample.fault is Fault.NONE else sample.fault.value for sample in samples]
    assert batch.column("fault").to_pylist() == faults


@given(st.lists(ANY, min_size=1, max_size=9), st.sampled_from([1e-4, 1e-3, 1e-2]))
def test_a_rounded_number_is_off_by_half_a_count_or_not_known(values: list[float], scale: float) -> None:
    column = Column(name="heave_m", scale=scale)
    numbers, is_there = stored(column, np.array(values))
    for value, number, there in zip(values, restored(column, numbers).tolist(), is_there.tolist(), strict=True):
        if there:
            assert abs(number - value) <= 0.5000001 * scale + 1e-12 * abs(value)
        else:
            assert not abs(value) < 2.0**31 * scale * (1.0 - 1e-9)


def test_frames_come_back_in_their_order_and_units(tmp_path: Path) -> None:
    scribe = Scribe(tmp_path)
    write_recording(tmp_path / "out", scribe, 3)
    hour = open_recorded(tmp_path / "out", FRAMES).hours[0]
    assert hour.rows == len(scribe.frames) == 300
    names = ("t_us", "heave_m", "roll_deg", "yaw_deg", "forecast_1s_m", "roll_0.1s_deg", "roll_1s_deg", "delayed_m")
    found: dict[str, list[float]] = {name: [] for name in names}
    quality: list[Any] = []
    for batch in hour.batches():
        for name, values in frame_values(hour, names, batch).items():
            found[name] += values.tolist()
        quality += list(zip(*(batch.column(name).to_pylist() for name in ("quality", "reasons")), strict=True))
    frames = scribe.frames
    assert found["t_us"] == pytest.approx([frame.t_s for frame in frames], abs=0.6e-6)
    assert found["heave_m"] == pytest.approx([frame.heave_m for frame in frames], abs=0.51e-4)
    assert found["roll_deg"] == pytest.approx([math.degrees(frame.roll_rad) for frame in frames], abs=0.51e-3)
    assert found["forecast_1s_m"] == pytest.approx([frame.forecast[4].heave_m for frame in frames], abs=0.51e-2)
    # Horizons other than the configured ones are not guessed at.
    assert all(map(math.isnan, found["yaw_deg"] + found["roll_0.1s_deg"] + found["roll_1s_deg"]))
    assert all(map(math.isfinite, found["delayed_m"]))
    assert set(quality) == {("valid", "one; two")}


def test_samples_come_back_as_they_were_with_nothing_missing(tmp_path: Path) -> None:
    scribe = Scribe(tmp_path)
    write_recording(tmp_path / "out", scribe, 2)
    rows = [row for hour in open_recorded(tmp_path / "out", SAMPLES).hours for row in rows_of(hour)]
    assert [row.seq for row in rows] == list(range(240))
    encoded = [msgspec.msgpack.encode(row.sample) for row in rows]
    assert encoded == [msgspec.msgpack.encode(sample) for sample in scribe.samples]


def test_a_frame_that_is_told_again_tells_its_sea_once(tmp_path: Path) -> None:
    scribe = Scribe(tmp_path)
    packer = FramePacker(scribe.config)
    frame = frame_at(1.0, 0)
    first, second = packer.pack(frame), packer.pack(frame)
    texts = [kind for kind, _ in Splitter().push(first)].count(Kind.TEXT)
    assert texts == 4  # Quality, laser, correction, reasons.
    kinds = [kind for kind, _ in Splitter().push(second)]
    assert kinds == [Kind.FRAME]
    packer.begin()
    assert [kind for kind, _ in Splitter().push(packer.pack(frame))].count(Kind.TEXT) == 4


@given(st.lists(st.tuples(st.sampled_from(Kind), st.binary(max_size=40)), max_size=8), st.integers(1, 7))
def test_messages_come_whole_however_they_are_cut(told: list[tuple[Kind, bytes]], step: int) -> None:
    data = b"".join(packed(kind, body) for kind, body in told)
    splitter = Splitter()
    found = [one for i in range(0, len(data), step) for one in splitter.push(data[i : i + step])]
    assert found == told


@pytest.mark.parametrize(
    "data", [HEAD.pack(4, 99) + b"abcd", HEAD.pack(1 << 30, 3), b"GET / HTTP/1.1\r\nHost: heaved\r\n\r\n"]
)
def test_bytes_of_somebody_else_are_no_messages(data: bytes) -> None:
    with pytest.raises(MessageError, match="not from this daemon"):
        list(Splitter().push(data))
