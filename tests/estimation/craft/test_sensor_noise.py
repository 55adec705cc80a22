"""What vibrates in heave and pitch readings, against the motion and the lines that were put in."""

from __future__ import annotations

from math import nan

import numpy as np
import pytest

from heaved.estimation.craft.sensor_noise import CraftNoise
from heaved.simulate.hydrofoil import CraftLine, CraftShake, CraftShaking

STD = (0.05, 0.005)
CONFIGURED = (STD[0] ** 2, STD[1] ** 2)


def motion(t: np.ndarray) -> np.ndarray:
    """(n, 2) heave and pitch of a craft in waves met every 2.5 s, and every 1.3 s."""
    heave = 0.6 * np.sin(2.5 * t) + 0.1 * np.sin(4.8 * t + 1.0)
    return np.column_stack([heave, 0.06 * np.sin(2.5 * t + 0.5) + 0.01 * np.sin(4.8 * t)])


def through(shake: str, rate_hz: float = 20.0, duration_s: float = 60.0, noisier: float = 1.0) -> np.ndarray:
    """(n, 2, 2) errors of the readings as they are split, and the deviations that are said of them."""
    t = np.arange(1, round(rate_hz * duration_s) + 1) / rate_hz
    rng = np.random.default_rng(3)
    clean = motion(t) + noisier * np.array(STD) * rng.standard_normal((len(t), 2))
    read = CraftShaking(shake, 3, STD).readings(t, clean)
    noise = CraftNoise(CONFIGURED)
    found = [noise.step(stamp, (heave, pitch)) for stamp, (heave, pitch) in zip(t.tolist(), read.tolist(), strict=True)]
    readings, variances = (np.array([pair[k] for pair in found]) for k in (0, 1))
    return np.stack([readings - motion(t), np.sqrt(variances)], axis=1)


def test_without_vibration_nothing_changes() -> None:
    t = np.arange(1, 1201) / 20.0
    rng = np.random.default_rng(4)
    noise = CraftNoise(CONFIGURED)
    for stamp, row in zip(t.tolist(), motion(t) + np.array(STD) * rng.standard_normal((len(t), 2)), strict=True):
        reading = (float(row[0]), float(row[1]))
        assert noise.step(stamp, reading) == (reading, CONFIGURED)


@pytest.mark.parametrize("rate_hz", [20.0, 100.0])
@pytest.mark.parametrize("shake", ["line-3.1", "line-3.1-strong", "lines", "line-8.7", "line-3.1, spikes, losses"])
def test_lines_are_taken_out_and_what_is_left_of_them_is_said(shake: str, rate_hz: float) -> None:
    """From 30 s on: an error below 1.35 times the white noise of a reading, where the line has 1.7 to 3."""
    found = through(shake, rate_hz)[round(30.0 * rate_hz) :]
    error, said = found[:, 0], found[:, 1]
    usual = np.abs(error) < 6.0 * np.array(STD)  # spikes are the filter's to weigh
    for k in (0, 1):
        kept = usual[:, k]
        assert kept.mean() > 0.65
        rms = float(np.sqrt(np.mean(error[kept, k] ** 2)))
        assert rms < 1.35 * STD[k]
        assert 0.7 < float(np.mean((error[kept, k] / said[kept, k]) ** 2)) < 1.4


def test_noise_that_is_twice_as_large_is_said_so() -> None:
    found = through("", noisier=2.0)[600:]
    for k in (0, 1):
        assert np.mean(found[:, 1, k]) == pytest.approx(2.0 * STD[k], rel=0.2)


def test_spikes_are_not_learned_from() -> None:
    found = through("spikes")[400:]
    assert np.array_equal(found[:, 1], np.tile(STD, (len(found), 1)))


def test_after_a_silence_it_is_learned_anew() -> None:
    noise = CraftNoise(CONFIGURED)
    line = CraftLine(hz=3.1, heave_m=0.2, pitch_rad=0.02)
    t = np.arange(1, 801) / 20.0
    read = CraftShaking(CraftShake(lines=(line,)), 1, STD).readings(t, motion(t))
    for stamp, row in zip(t.tolist(), read.tolist(), strict=True):
        last = noise.step(stamp, (row[0], row[1]))
    assert last[0] != tuple(read[-1])
    assert noise.step(t[-1] + 3.0, (0.1, 0.01)) == ((0.1, 0.01), CONFIGURED)
    reading, _ = noise.step(t[-1] + 3.05, (nan, 0.01))
    assert np.isnan(reading[0])
