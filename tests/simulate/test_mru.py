"""The simulated MRU. Oracle: the transfer function of its high-pass, and the true motion."""

from __future__ import annotations

from math import atan2, cos, hypot, pi, sin
from typing import TYPE_CHECKING

import numpy as np
import pytest

from heaved.simulate.mru import MruModel, SimulatedMru, parse_mru
from heaved.simulate.seaway import seaway
from heaved.simulate.vessel import Motion

if TYPE_CHECKING:
    from heaved.simulate.vessel import MotionSource

PERIOD_S = 10.0


class Regular:
    """One wave."""

    def at(self, t_s: float) -> Motion[float]:
        w = 2.0 * pi / PERIOD_S
        nothing = dict.fromkeys(
            ("heave_acceleration_mps2", "surge_acceleration_mps2", "sway_acceleration_mps2", "pitch_rad", "yaw_rad",
             "roll_rate_radps", "pitch_rate_radps", "yaw_rate_radps"), 0.0,
        )  # fmt: skip
        return Motion(
            t_s=t_s, heave_m=sin(w * t_s), heave_velocity_mps=w * cos(w * t_s), roll_rad=0.1 * sin(w * t_s), **nothing
        )


@pytest.mark.parametrize("highpass_s", [20.0, 100.0])
@pytest.mark.parametrize("delay_s", [0.0, 0.4])
def test_its_heave_has_passed_two_poles(highpass_s: float, delay_s: float) -> None:
    sea: MotionSource = Regular()
    mru = SimulatedMru(sea, MruModel(delay_s=delay_s, noise_m=0.0, noise_deg=0.0, highpass_s=highpass_s), seed=1)
    t = 200.0 + 0.1 * np.arange(1000)
    samples = [mru.read(float(one)) for one in t]
    w = 2.0 * pi / PERIOD_S
    pole = 1j * w / (1j * w + 2.0 * pi / highpass_s)
    expected = pole**2 * np.exp(-1j * w * delay_s)
    columns = np.column_stack((np.sin(w * t), np.cos(w * t)))
    inphase, quadrature = np.linalg.lstsq(columns, np.array([one.heave_m for one in samples]), rcond=None)[0]
    assert hypot(inphase, quadrature) == pytest.approx(abs(expected), rel=0.01)
    assert atan2(quadrature, inphase) == pytest.approx(np.angle(expected), abs=0.01)
    roll = np.linalg.lstsq(columns, np.array([one.roll_rad for one in samples]), rcond=None)[0]
    assert roll == pytest.approx([0.1 * cos(w * delay_s), -0.1 * sin(w * delay_s)], abs=1e-9)
    slope = np.gradient([one.heave_m for one in samples], 0.1)
    assert np.std(slope[5:-5] - np.array([one.heave_velocity_mps for one in samples])[5:-5]) < 0.03


def test_noise_is_as_large_as_it_is_said_to_be() -> None:
    sea = seaway("S4", 1)
    mru = SimulatedMru(sea, MruModel(delay_s=0.0, noise_m=0.05, noise_deg=1.0, highpass_s=0.0), seed=2)
    samples = [mru.read(0.1 * k) for k in range(2000)]
    off = [one.heave_m - sea.at(one.t_s).heave_m for one in samples]
    assert np.std(off) == pytest.approx(0.05, rel=0.1)
    assert np.degrees(np.std([one.pitch_rad - sea.at(one.t_s).pitch_rad for one in samples])) == pytest.approx(
        1.0, rel=0.1
    )


def test_how_it_is_told() -> None:
    assert parse_mru("") == MruModel()
    assert parse_mru("delay=0.3, noise=0.02,highpass=0") == MruModel(delay_s=0.3, noise_m=0.02, highpass_s=0.0)
    for wrong in ("late=1", "delay", "delay=-1", "noise=nan", "delay=x"):
        with pytest.raises(ValueError, match="give delay, noise, angle_noise, highpass"):
            parse_mru(wrong)
