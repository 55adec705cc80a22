"""Simulated devices that speak by themselves, heard by the very code that listens to real ones."""

from __future__ import annotations

import asyncio
import socket
import tomllib
from pathlib import Path

import msgspec
import pytest
from modbus_slaves import Results

from heaved.devices.listening import Listening
from heaved.devices.profile import DeviceSpec, Profile
from heaved.samples import Fault, MruSample
from heaved.simulate.instruments import Instruments
from heaved.simulate.mru import MruModel
from heaved.simulate.plant import SimulatedPlant
from heaved.simulate.seaway import seaway

FOLDER = Path(__file__).parents[2] / "config" / "devices"


def mru(profile: str, link: str) -> DeviceSpec:
    read = msgspec.convert(tomllib.loads((FOLDER / f"{profile}.toml").read_text()), Profile)
    return DeviceSpec(name="mru", role="reference_mru", link=link, profile=read, rate_hz=50.0)


def instruments() -> Instruments:
    return Instruments(seaway("S5", 1), seed=1, mru=MruModel(delay_s=0.0, noise_m=0.0, noise_deg=0.0, highpass_s=0.0))


def udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.mark.parametrize("profile", ["tss1", "pashr", "psxn23", "pnorsub2"])
@pytest.mark.parametrize("scheme", ["serial", "tcp", "udp-listen"])
async def test_what_is_spoken_is_heard(profile: str, scheme: str, tmp_path: Path) -> None:
    link = {
        "serial": f"serial://{tmp_path}/mru?baudrate=115200",
        "tcp": "tcp://127.0.0.1:1",
        "udp-listen": f"udp-listen://127.0.0.1:{udp_port()}",
    }[scheme]
    plant = SimulatedPlant([mru(profile, link)], instruments(), any_port=True)
    await plant.start()
    try:
        results = Results()
        listening = asyncio.create_task(Listening(plant.devices, results).run())
        result = await results.until(lambda result: result.fault is Fault.NONE)
        heard_s = plant.time_s()
        listening.cancel()
        await asyncio.wait([listening])
    finally:
        await plant.stop()
    sample = result.sample
    assert isinstance(sample, MruSample)
    # Of some moment of the last quarter of a second: the sea moves by less than this in it.
    truth = seaway("S5", 1)
    moments = [truth.at(heard_s - 0.01 * k) for k in range(60)]
    for told, true in (("heave_m", "heave_m"), ("roll_rad", "roll_rad"), ("pitch_rad", "pitch_rad")):
        values = [getattr(moment, true) for moment in moments]
        assert min(values) - 0.011 <= getattr(sample, told) <= max(values) + 0.011


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"role": "crane"}, "only a reference_mru is simulated"),
        ({"profile": Profile(name="p", sentences=())}, "no telegram that is simulated begins with"),
    ],
)
def test_what_is_not_simulated_is_said(change: dict[str, object], words: str) -> None:
    device = mru("tss1", "udp-listen://127.0.0.1:5601")
    if "profile" in change:
        sentence = msgspec.structs.replace(device.profile.sentences[0], header="#")
        change = {"profile": Profile(name="p", sentences=(sentence,))}
    with pytest.raises(ValueError, match=words):
        SimulatedPlant([msgspec.structs.replace(device, **change)], instruments())


async def test_a_line_that_a_file_stands_in_the_way_of(tmp_path: Path) -> None:
    (tmp_path / "mru").write_text("mine")
    plant = SimulatedPlant([mru("tss1", f"serial://{tmp_path}/mru")], instruments())
    with pytest.raises(FileExistsError, match="is not a symbolic link"):
        await plant.start()
    assert (tmp_path / "mru").read_text() == "mine"
