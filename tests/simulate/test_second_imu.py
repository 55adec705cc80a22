"""The simulated IMU at the crane base: it reads what a hull that bends makes of the motion, some time ago."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from heaved.config.read import data_directory, load
from heaved.devices.profile import DeviceSpec
from heaved.samples import CraftSample
from heaved.simulate.flexure import ARCSEC_RAD
from heaved.simulate.hydrofoil import Voyage
from heaved.simulate.instruments import CraftSensors, Instruments
from heaved.simulate.seaway import seaway
from heaved.simulate.second_imu import Bend, CraneBase, SecondImu
from heaved.simulate.sensors import imu_model
from heaved.simulate.vessel import body_rates


def test_the_flexure_has_its_standard_deviation_and_frequency() -> None:
    base = CraneBase(flexure_std_arcsec=5.0, flexure_mu_radps=0.1, flexure_hz=0.16)
    bend = Bend(base, seed=1)
    t = np.arange(0.0, 3000.0, 0.25)
    theta, rate = np.array([bend.at(s) for s in t.tolist()]).swapaxes(0, 1)
    # Of a sum of harmonics the variance is that of its weights once their differences have turned around.
    assert np.std(theta, axis=0) / ARCSEC_RAD == pytest.approx([5.0] * 3, rel=0.15)
    # White noise through the oscillator: rms rate over rms angle is b, exactly (2 pi 0.16 and mu, 1.01 rad/s).
    assert np.std(rate, axis=0) / np.std(theta, axis=0) == pytest.approx([1.01] * 3, rel=0.1)
    step = 1e-4
    assert (bend.at(7.0 + step)[0] - bend.at(7.0 - step)[0]) / (2.0 * step) == pytest.approx(bend.at(7.0)[1], rel=1e-6)


def test_its_rates_are_those_of_the_turning_frame() -> None:
    """d/dt of the frame in space, by differences: local_from_level' local_from_level^T = -[omega x]."""
    sea = seaway("S5", 1)
    base = CraneBase(flexure_std_arcsec=500.0, late_s=0.25)
    imu = SecondImu(sea, imu_model("ideal"), base, rate_hz=50.0, seed=2)

    def local_from_level(t_s: float) -> np.ndarray:
        motion = sea.at(t_s - 0.25)
        # Active turns: yaw and pitch against the right hand.
        level_from_body = Rotation.from_euler("ZYX", [-motion.yaw_rad, -motion.pitch_rad, motion.roll_rad]).as_matrix()
        return imu.deformation(t_s) @ level_from_body.T

    step = 1e-4
    for t in (3.0, 11.5, 40.25):
        turned = (local_from_level(t + step) - local_from_level(t - step)) / (2.0 * step)
        W = -turned @ local_from_level(t).T
        sample = imu.read(t)
        assert [sample.gx_radps, sample.gy_radps, sample.gz_radps] == pytest.approx(
            [W[2, 1], W[0, 2], W[1, 0]], abs=2e-7
        )
        assert sample.t_s == t


def test_without_flexure_and_turned_by_nothing_it_is_the_first_one_late() -> None:
    sea = seaway("S4", 3)
    base = CraneBase(static_deg=(0.0, 0.0, 0.0), flexure_std_arcsec=0.0, late_s=0.004)
    sample = SecondImu(sea, imu_model("ideal"), base, rate_hz=50.0, seed=2).read(20.0)
    rates = body_rates(sea.at(19.996))
    assert [sample.gx_radps, sample.gy_radps, sample.gz_radps] == pytest.approx([rates.x, rates.y, rates.z], abs=1e-12)


def line(values: list[float]) -> np.ndarray:
    return np.array(values)


def test_the_sensors_of_a_craft_read_the_voyage_over_and_over() -> None:
    nothing = np.zeros(3)
    voyage = Voyage(
        t_s=line([0.0, 1.0, 2.0]), heave_m=line([0.0, 1.0, 0.0]), heave_velocity_mps=nothing,
        pitch_rad=line([0.0, 0.1, 0.2]), pitch_rate_radps=nothing, measured_heave_m=nothing,
        measured_pitch_rad=nothing, speed_mps=line([9.0, 9.0, 9.0]), flap_fore_rad=line([0.0, 0.2, 0.0]),
        flap_aft_rad=nothing, wave_heave_mps2=nothing, wave_pitch_radps2=nothing,
    )  # fmt: skip
    exact = CraftSensors(voyage, heave_noise_m=0.0, pitch_noise_rad=0.0, seed=1, name="craft")
    assert exact.read(0.5) == CraftSample(
        t_s=0.5, heave_m=0.5, pitch_rad=0.05, speed_mps=9.0, flap_fore_rad=0.1, flap_aft_rad=0.0
    )
    assert exact.read(6.5).heave_m == pytest.approx(0.5)
    noisy = CraftSensors(voyage, heave_noise_m=0.05, pitch_noise_rad=0.005, seed=1, name="craft")
    readings = [noisy.read(2.0 * k) for k in range(2000)]
    assert np.std([reading.heave_m for reading in readings]) == pytest.approx(0.05, rel=0.1)
    assert np.std([reading.pitch_rad for reading in readings]) == pytest.approx(0.005, rel=0.1)


def test_devices_of_the_stages_are_read_by_their_roles() -> None:
    (_, _, crane), (craft,) = (load(data_directory() / name).device for name in ("hull.toml", "hydrofoil.toml"))
    assert isinstance(crane, DeviceSpec)
    instruments = Instruments(seaway("S5", 1), seed=1)
    first = instruments.read(crane, 1.0)
    assert first == Instruments(seaway("S5", 1), seed=1).read(crane, 1.0)
    refused = instruments.read(craft, 1.0)
    assert isinstance(refused, CraftSample)
    assert math.isnan(refused.heave_m)  # No voyage: the device refuses.


def test_what_shakes_the_gyros_amidships_shakes_those_at_the_crane_base() -> None:
    """A line of 2 mrad/s about every axis."""
    crane = load(data_directory() / "hull.toml").device[2]
    assert isinstance(crane, DeviceSpec)
    shaken, still = (
        Instruments(seaway("S5", 1), sensor="ideal", shake=shake).second_imu(crane) for shake in ("gyros", "")
    )
    t = np.arange(0.0, 60.0, 0.05)
    a, b = (
        np.array([(r.gx_radps, r.gy_radps, r.gz_radps) for r in map(imu.read, t.tolist())]) for imu in (shaken, still)
    )
    assert np.std(a - b, axis=0) == pytest.approx([2e-3 / math.sqrt(2.0)] * 3, rel=0.02)
