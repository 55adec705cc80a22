"""What a burst of polls shows of a device, from its registers alone."""

from __future__ import annotations

import math

import numpy as np
import pytest

from heaved.config.read import packaged_profiles
from heaved.devices.profile import decode
from heaved.links import SerialLink
from heaved.setup.polling import Measured, Polls, measured
from heaved.setup.probe_report import folded_text, measured_lines

PROFILES = {profile.name: profile for profile in packaged_profiles()}
WITMOTION, LIDAR = PROFILES["witmotion-wt901c485"], PROFILES["benewake-tf02-i"]
LINE = SerialLink("/dev/ttyUSB0", 115200)
G = 16.0 / 32768.0 * 9.80665
"""m/s2 a count."""


def polled(name: str, rows: list[list[int]], times_s: list[float]) -> Polls:
    (block,) = PROFILES[name].blocks
    polls = Polls()
    for t_s, registers in zip(times_s, rows, strict=True):
        polls.sent_s.append(t_s)
        polls.round_trips_s.append(0.01)
        polls.registers.append(tuple(registers))
        polls.values.append(decode(block, registers).values)
    return polls


def imu(measures_hz: float, line_hz: float = 0.0, seconds: float = 20.0, seed: int = 1) -> Measured:
    """Polled 100 times a second; gravity, noise of 4 counts, and a line of 50 counts on z."""
    rng = np.random.default_rng(seed)
    ticks = np.arange(int(seconds * measures_hz) + 2)
    noise = np.round(rng.normal(0.0, 4.0, (len(ticks), 6)))
    noise[:, 2] += np.round(50.0 * np.sin(2.0 * math.pi * line_hz * ticks / measures_hz))
    times = [k / 100.0 for k in range(int(100 * seconds))]
    rows = []
    for t_s in times:
        six = noise[int(t_s * measures_hz + 1e-9)] + np.array([0, 0, 2048, 0, 0, 0])
        rows.append([int(value) & 0xFFFF for value in six] + [0, 0, 0, 364, 0xFF4A, 91])
    return measured(polled("witmotion-wt901c485", rows, times), WITMOTION, LINE, 0.0)


def test_a_sensor_that_measures_more_slowly_than_it_is_asked_is_timed_and_its_noise_known() -> None:
    shown = imu(25.0)
    assert shown.pace.kind == "clock"
    assert shown.pace.new_hz == pytest.approx(25.0, rel=0.002)
    densities = [channel.noise.density for channel in shown.channels[:3]]
    # Noise of 4 counts and the rounding of one, 25 values a second: N = sigma / sqrt(f / 2).
    assert densities == pytest.approx([math.hypot(4.0, 1.0 / math.sqrt(12.0)) * G / math.sqrt(12.5)] * 3, rel=0.2)
    text = "\n".join(measured_lines(shown, 40.0))
    assert "100.0 polls a second, 25.0 new values a second: it measures every 40 ms" in text
    assert "the device tells no time" in text
    assert "vibration: no line up to 12.5 Hz" in text
    assert "walk of the bias: not seen; above" in text


def test_vibration_is_told_with_what_it_becomes_at_the_rate_that_is_planned() -> None:
    shown = imu(100.0, line_hz=20.1)
    (line,) = shown.channels[2].lines
    assert line.frequency_hz == pytest.approx(20.1, abs=0.01)
    assert line.amplitude == pytest.approx(50.0 * G, rel=0.05)
    assert shown.channels[2].noise.density == pytest.approx(4.0 * G / math.sqrt(50.0), rel=0.2)
    text = "\n".join(measured_lines(shown, 20.0))
    # 0.24 m/s2 at 0.1 Hz: over (2 pi 0.1)^2 = 0.395.
    assert "vibration: az 0.24 m/s2 at 20.10 Hz; polled at 20 Hz it reads as a wave of 10 s and 0.61 m" in text
    assert "faster than 50 Hz, half the new values a second, shows here at another frequency" in text


@pytest.mark.parametrize(
    ("frequency_hz", "rate_hz", "expected"),
    [
        (25.1, 100.0, "it shows at 25.10 Hz, above the waves"),
        (25.0, 25.0, "it reads as a bias that wanders (of 0.000 Hz): take another rate"),
        (50.2, 25.0, "it reads as a wave of 5 s and 0.063 m: take another rate"),
    ],
)
def test_what_a_line_is_said_to_become(frequency_hz: float, rate_hz: float, expected: str) -> None:
    assert folded_text(frequency_hz, 0.1, rate_hz) == expected


def test_a_device_with_a_clock_is_timed_by_it_though_its_readings_repeat() -> None:
    """A lidar that measures 50 times a second, of something that stands: only its time changes."""
    times = [k / 100.0 for k in range(1000)]
    rows = [[1200, 900, 0, 0, 20 * int(50.0 * t_s + 1e-9)] for t_s in times]
    shown = measured(polled("benewake-tf02-i", rows, times), LIDAR, LINE, 0.0)
    assert shown.pace.kind == "clock"
    assert shown.pace.new_hz == pytest.approx(50.0, rel=0.002)
    # Every second poll is 10 ms older.
    assert shown.age_spread_s == pytest.approx(0.010, rel=0.1)
    assert "by the device's clock the age of an answer varies by 10.0 ms" in "\n".join(measured_lines(shown, 20.0))


def test_an_imu_that_stands_still_in_its_registers_is_said_to_be_finer_than_they_are() -> None:
    times = [k / 100.0 for k in range(1000)]
    rows = [[0, 0, 2048 + (k == 500), 0, 0, 0, 0, 0, 0, 364, 0xFF4A, 91] for k in range(1000)]
    text = "\n".join(measured_lines(measured(polled("witmotion-wt901c485", rows, times), WITMOTION, LINE, 0.0), 40.0))
    assert "too few to say how often it measures" in text
    assert "the rounding of the register: its own is less" in text


def test_of_no_answers_nothing_is_said() -> None:
    shown = measured(Polls(lost={"no answer": 3}), WITMOTION, LINE, 20.0)
    assert shown.channels == []
    assert math.isnan(shown.age_spread_s)
    text = "\n".join(measured_lines(shown, 20.0))
    assert "no answer to any of 3 polls" in text
    assert "too few answers to say how often it measures" in text
