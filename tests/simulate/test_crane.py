"""The simulated crane: smooth, within its limits, the same again, and read as real encoders are."""

from __future__ import annotations

import math

import numpy as np
import pytest

from heaved.config.read import data_directory, load
from heaved.devices.profile import encode
from heaved.samples import CraneSample
from heaved.simulate.crane import (
    CraneAtWork,
    CraneBuild,
    CraneModel,
    CraneSensors,
    Encoders,
    height_m,
    tip_in_ship_axes,
)
from heaved.simulate.instruments import Instruments
from heaved.simulate.seaway import seaway

TIMES = np.arange(0.0, 900.0, 0.05)


@pytest.mark.parametrize("seed", range(4))
def test_it_moves_smoothly_within_its_limits_and_comes_back(seed: int) -> None:
    crane, model = CraneAtWork(seed=seed), CraneModel()
    made = [crane.at(t) for t in TIMES.tolist()]
    at, rate, acceleration = (np.array([getattr(one, name) for one in made]) for name in ("at", "rate", "acceleration"))
    units = np.array([math.pi / 180.0] * 3 + [1.0])
    assert np.all(at >= units * model.low - 1e-9)
    assert np.all(at <= units * model.high + 1e-9)
    assert np.all(np.abs(rate) <= units * model.fastest * (1.0 + 1e-9))
    np.testing.assert_allclose(np.gradient(at, TIMES, axis=0)[1:-1], rate[1:-1], atol=2e-3)
    np.testing.assert_allclose(np.gradient(rate, TIMES, axis=0)[1:-1], acceleration[1:-1], atol=2e-2)
    assert np.all(np.ptp(at, axis=0) > 0.3 * units * np.subtract(model.high, model.low)), "every joint has been at work"
    resting = np.mean(np.all(rate == 0.0, axis=1))
    assert 0.1 < resting < 0.7
    np.testing.assert_allclose(crane.at(1234.5).at, CraneAtWork(seed=seed).at(1234.5).at)


def test_a_parked_one_stands() -> None:
    crane = CraneAtWork(CraneModel(is_parked=True), seed=1)
    assert all(np.array_equal(crane.at(t).at, crane.at(0.0).at) for t in (1.0, 100.0, 1e4))


def test_its_encoders_read_in_steps_and_count_the_slew_from_zero_to_a_turn() -> None:
    crane = CraneAtWork(seed=1)
    sensors = CraneSensors(crane, Encoders(step_deg=0.5, step_m=0.1), seed=1)
    for t in np.arange(0.0, 300.0, 1.0).tolist():
        sample, truth = sensors.read(t), crane.at(t).at
        assert 0.0 <= sample.slew_rad < 2.0 * math.pi
        assert math.remainder(math.degrees(sample.slew_rad), 0.5) == pytest.approx(0.0, abs=1e-9)
        assert abs(math.remainder(sample.slew_rad - truth[0], 2.0 * math.pi)) <= math.radians(0.25) + 1e-9
        assert abs(sample.line_out_m - truth[3]) <= 0.05 + 1e-9


def test_the_chain_of_matrices_ends_where_plain_geometry_does() -> None:
    """An upright boom over a level jib, slewed to starboard; the ship rolled by 90 degrees, port side up."""
    build = CraneBuild(
        pedestal_m=(10.0, 0.0, 5.0), heel_outward_m=1.0, heel_up_m=2.0, boom_length_m=20.0, jib_length_m=4.0,
        sheave_outward_m=0.5, sheave_up_m=0.25, falls=2, hook_below_m=1.0,
    )  # fmt: skip
    joints = np.array([math.pi / 2, math.pi / 2, 0.0, 8.0])
    assert tip_in_ship_axes(build, joints) == pytest.approx([10.0, -5.5, 27.25])
    assert height_m(build, joints, 0.0, 0.0, hook=True) == pytest.approx(27.25 - 5.0)
    assert height_m(build, joints, math.pi / 2, 0.0) == pytest.approx(-5.5)
    assert height_m(build, joints, 0.0, math.pi / 2) == pytest.approx(10.0)


def test_the_packaged_crane_is_served_by_its_profile() -> None:
    device = next(one for one in load(data_directory() / "demo.toml").device if one.role == "crane")
    instruments = Instruments(seaway("S5", 1), seed=1)
    sample = instruments.read(device, 12.3)
    assert isinstance(sample, CraneSample)
    assert sample == Instruments(seaway("S5", 1), seed=1).read(device, 12.3)
    block = device.profile.blocks[0]
    registers = encode(
        block,
        {
            "slew_rad": sample.slew_rad,
            "boom_rad": sample.boom_rad,
            "jib_rad": sample.jib_rad,
            "line_out_m": sample.line_out_m,
        },
    )
    assert registers[0] == round(100.0 * math.degrees(sample.slew_rad))
    assert registers[4] == round(1000.0 * sample.line_out_m)
