"""What shakes the gyros: the same at any poll, of the size that is said, each reading disturbed as often as is said."""

from __future__ import annotations

import numpy as np
import pytest

from heaved.simulate.gyro_shaking import GYRO_SHAKES, GyroHum, GyroLine, GyroShake, GyroShaking, gyro_shake

T = np.arange(1, 12_001) / 20.0


@pytest.mark.parametrize("name", GYRO_SHAKES)
def test_a_realisation_is_known_at_any_instant_and_by_its_seed(name: str) -> None:
    once, again, other = (GyroShaking(name, seed, local=True) for seed in (1, 1, 2))
    assert np.array_equal(once.rates(T)[::2], again.rates(T[::2]))
    vibrates = bool(gyro_shake(name).vibration)
    assert np.array_equal(once.rates(T), other.rates(T)) is not vibrates


@pytest.mark.parametrize(("local", "amplitude"), [(False, 2e-3), (True, 4e-3)])
def test_a_line_has_its_frequency_and_its_amplitude_at_either_foot(local: bool, amplitude: float) -> None:
    rates = GyroShaking("line-3.1", 1, local=local).rates(T)
    assert np.sqrt(2.0 * np.mean(rates**2)) == pytest.approx(amplitude, rel=0.01)
    f = np.fft.rfftfreq(len(T), 1.0 / 20.0)
    assert f[np.argmax(np.abs(np.fft.rfft(rates[:, 0])))] == pytest.approx(3.1, abs=0.01)


def test_a_line_wanders_within_its_share() -> None:
    line = GyroLine(hz=2.0, midships_radps=1.0, local_radps=1.0, wander=0.05)
    rate = GyroShaking(GyroShake(vibration=(line,)), 1, local=False).rates(T)[:, 0]
    crossings = T[1:][(rate[1:] > 0.0) & (rate[:-1] <= 0.0)]
    found = 20.0 / (crossings[20:] - crossings[:-20])
    assert 1.88 < found.min() < 1.98
    assert 2.02 < found.max() < 2.12


def test_a_hum_stays_in_its_band() -> None:
    hum = GyroHum(from_hz=2.0, to_hz=4.0, midships_radps=1e-3, local_radps=2e-3)
    rates = GyroShaking(GyroShake(vibration=(hum,)), 1, local=True).rates(T)
    assert np.std(rates) == pytest.approx(2e-3, rel=0.1)
    power = np.abs(np.fft.rfft(rates[:, 1] * np.hanning(len(T)))) ** 2
    f = np.fft.rfftfreq(len(T), 1.0 / 20.0)
    assert power[(f < 1.9) | (f > 4.1)].sum() < 1e-3 * power.sum()


def test_spikes_and_losses_are_as_frequent_as_is_said() -> None:
    shake = GyroShake(spike_share=0.01, spike_radps=0.3, lost_share=0.3)
    read = GyroShaking(shake, 1, local=False).readings(T, np.zeros((len(T), 3)))
    lost = np.isnan(read).all(axis=1)
    assert lost.mean() == pytest.approx(0.3, abs=0.02)
    spikes = np.abs(read[~lost]).max(axis=1)
    assert np.mean(spikes > 0.0) == pytest.approx(0.01, abs=0.004)
    assert spikes[spikes > 0.0].min() >= 0.03
    assert spikes.max() <= 0.3


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown shake"):
        GyroShaking("earthquake", 1, local=True)
