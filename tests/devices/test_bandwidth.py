"""Folding. Oracle: sinusoids sampled at the rate, and where the periodogram of the samples has its peak; the group
delay of filters by differences of their phase.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import butter, freqs

from heaved.devices.bandwidth import WAVES_HZ, folding, folding_bands_hz, lag_ms, remedy
from heaved.devices.profile import BandwidthRegister

WITMOTION = BandwidthRegister(address=0x1F, choices_hz=(256.0, 188.0, 98.0, 42.0, 20.0, 10.0, 5.0))


def seen_hz(frequency_hz: float, rate_hz: float) -> float:
    """The frequency that a minute of samples shows of that motion."""
    t = np.arange(round(60.0 * rate_hz)) / rate_hz
    power = np.abs(np.fft.rfft(np.hanning(t.size) * np.sin(2.0 * math.pi * frequency_hz * t + 0.3), 8 * t.size)) ** 2
    return float(np.argmax(power)) * rate_hz / (8 * t.size)


@pytest.mark.parametrize(
    ("rate_hz", "bandwidth_hz"), [(20.0, 20.0), (10.0, 20.0), (7.3, 5.0), (4.0, 10.0), (90.0, 98.0)]
)
def test_what_is_named_reads_as_waves_and_nothing_else_does(rate_hz: float, bandwidth_hz: float) -> None:
    bands = folding_bands_hz(rate_hz, bandwidth_hz)
    assert bands
    for frequency_hz in np.arange(1.0, 2.0 * bandwidth_hz, 0.37).tolist():
        edge_hz = min(abs(abs(frequency_hz - k * rate_hz) - WAVES_HZ) for k in range(1, 50))
        if edge_hz > 0.05:  # The periodogram is no finer.
            named = any(low <= frequency_hz <= high for low, high in bands)
            assert (seen_hz(frequency_hz, rate_hz) <= WAVES_HZ) == named, frequency_hz


@pytest.mark.parametrize(("rate_hz", "bandwidth_hz"), [(100.0, 20.0), (40.0, 20.0), (10.0, 5.0), (1.6, 0.0)])
def test_twice_the_bandwidth_is_enough_and_of_an_unknown_one_nothing_is_said(
    rate_hz: float, bandwidth_hz: float
) -> None:
    assert folding_bands_hz(rate_hz, bandwidth_hz) == []
    assert folding(rate_hz, bandwidth_hz) == ""


@pytest.mark.parametrize("bandwidth_hz", [5.0, 20.0, 98.0])
def test_the_lag_is_between_that_of_the_first_and_the_second_order(bandwidth_hz: float) -> None:
    low = 1e-3 * bandwidth_hz
    delays_ms = []
    for order in (1, 2):
        _, response = freqs(*butter(order, 2.0 * math.pi * bandwidth_hz, analog=True), worN=[2.0 * math.pi * low])
        delays_ms.append(-1e3 * float(np.angle(response[0])) / (2.0 * math.pi * low))
    assert delays_ms[0] < lag_ms(bandwidth_hz) < delays_ms[1]


REMEDIES: dict[str, tuple[float, float, BandwidthRegister | None, float, tuple[str, ...]]] = {
    "a narrower filter": (20.0, 20.0, WITMOTION, math.inf, (
        "poll at 40 Hz or more, or set register 0x1F of the sensor to 5 (10 Hz) and bandwidth_hz to 10",
        "lags by about 20 ms instead of 10",
    )),
    "the widest that serves": (100.0, 256.0, WITMOTION, math.inf, ("to 3 (42 Hz)",)),
    "a line that is too slow": (20.0, 20.0, WITMOTION, 21.3, ("(the line carries 21.3: raise its baud rate first)",)),
    "no filter narrow enough": (5.0, 20.0, WITMOTION, math.inf, ("no bandwidth that register 0x1F can set is low",)),
    "a sensor of which no register is known": (20.0, 30.0, None, math.inf, (
        "poll at 60 Hz or more, or set the low-pass of the sensor to 10 Hz or less and say so as bandwidth_hz",
    )),
}  # fmt: skip


@pytest.mark.parametrize("name", REMEDIES)
def test_what_to_set_and_what_it_costs(name: str) -> None:
    rate_hz, bandwidth_hz, register, most_hz, expected = REMEDIES[name]
    for text in expected:
        assert text in remedy(rate_hz, bandwidth_hz, register, most_hz)


def test_many_bands_are_cut_short() -> None:
    assert "vibration of 9.4-10.6, 19.4-20.6, 29.4-30.6 and so on to 40.6 Hz folds" in folding(10.0, 20.0)
