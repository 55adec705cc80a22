"""What is slow in a shaking gyro, against the tones that were put in: lines, hums, holes, spikes."""

from __future__ import annotations

import numpy as np
import pytest

from heaved.estimation.common.rotations import ARCSEC
from heaved.estimation.hull.slow_motion import SlowMotion, SlowPair
from heaved.estimation.hull.tuning import TUNING
from heaved.simulate.gyro_shaking import GYRO_SHAKES, GyroHum, GyroShake, GyroShaking

RATE_HZ = 10.0
LEAST = 5e-7
W = 2.0 * np.pi / np.array([8.0, 6.0, 10.0])
A = np.radians([4.0, 2.0, 3.0])
T = np.arange(1, 1201) / RATE_HZ


def waves(t: np.ndarray, derivative: int = 0) -> np.ndarray:
    """(n, 3) rates of a ship that rolls, pitches and yaws, and their derivatives."""
    return np.asarray(A * W ** (derivative + 1) * np.cos(np.multiply.outer(t, W) + derivative * np.pi / 2.0))


def read(shake: str | GyroShake, seed: int = 1) -> np.ndarray:
    """(n, 9) a record of both triads, the local one along the hull's axes."""
    rng = np.random.default_rng(seed)
    triads = [
        GyroShaking(shake, seed, local=local).readings(T, waves(T) + 5e-8 * rng.standard_normal((len(T), 3)))
        for local in (False, True)
    ]
    return np.column_stack([T, *triads, np.zeros((len(T), 2))])


def learned(rows: np.ndarray) -> SlowPair:
    pair = SlowPair(SlowMotion(RATE_HZ, LEAST), SlowMotion(RATE_HZ, LEAST))
    pair.learn(rows, to_end=False)
    pair.identify(rows, 4)
    return pair


def test_the_motion_comes_with_its_derivatives() -> None:
    pair = learned(read(""))
    for t, midships, local in pair.through(read(""))[20:]:
        assert midships is not None
        assert local is not None
        truth = np.array([waves(np.array([t]), k)[0] / f for k, f in enumerate((1.0, 1.0, 2.0))])
        assert midships.motion[0] == pytest.approx(truth[0], abs=0.2 * ARCSEC)
        assert midships.motion[1] == pytest.approx(truth[1], abs=5.0 * ARCSEC)
        assert midships.motion[2] == pytest.approx(truth[2], abs=20.0 * ARCSEC)


@pytest.mark.parametrize(
    ("shake", "within_arcsec"),
    [
        ("line-1.3", 6.0),
        ("line-3.1", 0.5),
        ("line-3.1 in phase", 0.5),
        ("engines", 2.0),
        ("hum", 40.0),
        ("spikes", 0.5),
        ("losses", 1.0),
        ("line-3.1, spikes, losses", 15.0),
    ],
)
def test_what_vibrates_is_left_out_and_what_is_left_is_said(shake: str, within_arcsec: float) -> None:
    """The local gyro's lines of 4 mrad/s are 580 arcsec/s RMS each; the hum of 1 mrad/s is 206."""
    rows = read(shake)
    pair = learned(rows)
    found = [(t, local) for t, _, local in pair.through(rows)[20:] if local is not None]
    error = np.array([local.motion[0] for _, local in found]) - waves(np.array([t for t, _ in found]))
    rms = float(np.sqrt(np.mean(error**2)))
    assert len(found) > 240
    assert rms < within_arcsec * ARCSEC
    said = float(np.sqrt(np.mean([local.variance for _, local in found])))
    assert rms < 2.0 * said + 0.2 * ARCSEC


def test_a_spike_is_found_and_nothing_else() -> None:
    rows = read("line-3.1")
    pair = learned(rows.copy())
    rows[600, 5] += 0.1
    rows[603, 4] -= 0.3
    struck = rows.copy()
    pair.through(struck)
    wrong = np.flatnonzero(np.isnan(struck[:, 4:7]).all(axis=1))
    assert wrong.tolist() == [600, 603]
    assert np.isfinite(struck[:, 1:4]).all()


def test_a_jump_in_vibration_is_no_row_of_spikes_and_its_size_is_said() -> None:
    rows, quiet = read("line-3.1"), read("")
    pair = learned(quiet.copy())
    rows[:600] = quiet[:600]
    found = [(t, local) for t, _, local in pair.through(rows) if t > 63.0 and local is not None]
    assert len(found) > 130
    error = np.array([local.motion[0] for _, local in found]) - waves(np.array([t for t, _ in found]))
    said = np.sqrt([local.variance for _, local in found])
    assert np.mean(np.abs(error) < 2.0 * said) > 0.9


def test_nothing_is_said_across_a_hole_and_all_behind_it() -> None:
    rows = read("")
    pair = learned(rows.copy())
    rows[500:508, 4:7] = np.nan
    t = np.array([t for t, _, local in pair.through(rows) if local is None])
    assert t.min() > 49.0
    assert t.max() < 52.0
    assert all(midships is not None for _, midships, _ in pair.through(rows))


def test_the_spectrum_above_the_waves_is_that_of_what_vibrates() -> None:
    """A hum of 1 mrad/s between 2 and 4.5 Hz has a two-sided density of 1e-6 / (2 * 2.5); none is claimed below."""
    shake = GyroShake(vibration=(GyroHum(from_hz=2.0, to_hz=4.5, midships_radps=1e-3, local_radps=1e-3),))
    band = learned(read(shake)).local
    f = np.linspace(0.0, 0.5 * RATE_HZ, len(band.power))
    hum = (f > 2.2) & (f < 4.3)
    assert np.mean(band.power[hum]) == pytest.approx(1e-6 / 5.0, rel=0.3)
    assert np.max(band.power[f < TUNING.waves_end_hz]) < 1e-3 * np.mean(band.power[hum])


def test_a_record_too_short_has_no_window() -> None:
    pair = SlowPair(SlowMotion(RATE_HZ, LEAST), SlowMotion(RATE_HZ, LEAST))
    assert pair.learn(read("")[: 2 * TUNING.shortest_window], to_end=True) == []
    assert all(name in GYRO_SHAKES for name in ("slams", "whipping"))
