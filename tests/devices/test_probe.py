"""Probing: the profile that fits is found, through a shifted address, the other function and another byte order."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path

import msgspec
import pytest

from heaved.config.read import packaged_profiles
from heaved.devices.line import parse_link
from heaved.devices.probe import parse_ids, plausibility, probe
from heaved.devices.profile import DeviceSpec, Profile, Quantity
from heaved.samples import ImuSample, LaserSample, Sample
from heaved.simulate.plant import SimulatedPlant

PROFILES = {profile.name: profile for profile in packaged_profiles()}
IMU, LASER = PROFILES["heaved-sim-imu"], PROFILES["heaved-sim-laser"]


class AtAnchor:
    """A ship that lies still, a little heeled."""

    def read(self, device: DeviceSpec, t_s: float) -> Sample:
        if device.role == "laser":
            return LaserSample(t_s=t_s, laser_m=11.5)
        heel = math.radians(3.0)
        return ImuSample(
            t_s=t_s, ax_mps2=0.01, ay_mps2=9.81 * math.sin(heel), az_mps2=9.81 * math.cos(heel), roll_rad=heel,
            pitch_rad=0.02, yaw_rad=1.0, gx_radps=0.001, gy_radps=-0.002, gz_radps=0.003,
        )  # fmt: skip


def changed(profile: Profile, change: Callable[[dict], object]) -> Profile:  # type: ignore[type-arg]
    """A device whose registers differ from the profile: ``change`` edits each block."""
    tree = msgspec.to_builtins(profile)
    for block in tree["blocks"]:
        change(block)
    return msgspec.convert(tree, Profile)


def reorder(block: dict) -> None:  # type: ignore[type-arg]
    for field in block["fields"]:
        field["byte_order"] = "CDAB"


@asynccontextmanager
async def served(profile: Profile, role: str, device_id: int) -> AsyncIterator[str]:
    device = msgspec.convert(
        {"name": "it", "role": role, "link": "tcp://127.0.0.1:1", "device_id": device_id, "rate_hz": 10.0,
         "profile": msgspec.to_builtins(profile)},
        DeviceSpec,
    )  # fmt: skip
    plant = SimulatedPlant([device], AtAnchor(), any_port=True)
    await plant.start()
    try:
        yield plant.devices[0].link
    finally:
        await plant.stop()


async def report(line: AbstractAsyncContextManager[str], profiles: tuple[Profile, ...], ids: str = "1-8") -> list[str]:
    async with line as link:
        return await probe(parse_link(link), parse_ids(ids), profiles, 0.5, lambda device_id: None)


async def test_an_imu_is_found_among_all_packaged_profiles() -> None:
    lines = await report(served(IMU, "imu", 7), packaged_profiles())
    assert lines[:2] == ["id 7: fits", "  100%  heaved-sim-imu"]
    assert "az_mps2 9.797" in lines[2]
    assert lines[3].split()[0] == "registers"
    assert len(lines[3].split()) == 1 + 18


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda block: block.update(start=1), "heaved-sim-imu with addresses +1"),
        (lambda block: block.update(function="input"), "heaved-sim-imu with the other function (input/holding)"),
        (reorder, "heaved-sim-imu with byte order CDAB"),
        (
            lambda block: (block.update(start=1), reorder(block)),
            "heaved-sim-imu with addresses +1, byte order CDAB",
        ),
    ],
    ids=["address", "function", "byte order", "both"],
)
async def test_the_usual_mistakes_are_recognised(change: Callable[[dict], object], expected: str) -> None:  # type: ignore[type-arg]
    lines = await report(served(changed(IMU, change), "imu", 1), (IMU, LASER), "1")
    assert lines[1] == f"  100%  {expected}"


async def test_a_device_that_nobody_knows_is_named_all_the_same() -> None:
    lines = await report(served(changed(LASER, lambda block: block.update(start=900)), "laser", 3), (IMU, LASER))
    assert lines == ["id 3: answers, but no known profile fits"]


async def test_a_line_that_cannot_be_opened(tmp_path: Path) -> None:
    with pytest.raises(ConnectionError, match="is not there: plug the adapter in"):
        await probe(parse_link(f"rtu://{tmp_path}/none"), (1,), (IMU,), 0.05, lambda device_id: None)


REGISTERS = [1, 2, 3]
MARKS: dict[str, tuple[dict[Quantity, float], list[int], float]] = {
    "gravity on any axis": ({"ax_mps2": -9.8, "ay_mps2": 0.1, "az_mps2": 0.1}, REGISTERS, 1.0),
    "no gravity": ({"ax_mps2": 0.1, "ay_mps2": 0.1, "az_mps2": 0.1}, REGISTERS, 0.0),
    "a distance": ({"laser_m": 12.0}, REGISTERS, 1.0),
    "no distance": ({"laser_m": 1e-38}, REGISTERS, 0.0),
    "capsized": ({"ax_mps2": 0.0, "ay_mps2": 0.0, "az_mps2": 9.8, "roll_rad": 3.0, "pitch_rad": 0.0}, REGISTERS, 5 / 6),
    "empty memory": ({"laser_m": 12.0}, [0, 0, 0], 0.0),
    "nothing to judge": ({"signal": 5.0}, REGISTERS, 0.0),
}


@pytest.mark.parametrize("name", MARKS)
def test_plausibility(name: str) -> None:
    values, registers, expected = MARKS[name]
    assert plausibility(values, registers) == pytest.approx(expected)


def test_ids() -> None:
    assert parse_ids("80, 1-3,2") == (80, 1, 2, 3)
    for text in ("", "0", "248", "3-1", "x", "1-", "-5", "1--2"):
        with pytest.raises(ValueError, match="ids "):
            parse_ids(text)
