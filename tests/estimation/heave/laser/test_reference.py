"""Oracle: readings made as sign * (heave + constant) + noise, with the heave known."""

from __future__ import annotations

import copy
from math import isfinite, nan, pi, sqrt
from typing import Literal

import numpy as np
import pytest

from heaved.estimation.heave.laser.reference import Params, Reading, Reference

RATE_HZ = 20.0


def heave(t: float, amplitude_m: float = 0.05) -> float:
    return amplitude_m * float(np.sin(2 * pi * t / 6.3))


class Gauge:
    """Feeds a Reference with a gauge of known constant; the estimate is off by a tone of ``error_m`` RMS."""

    def __init__(self, params: Params, error_m: float = 0.002, seed: int = 1) -> None:
        self.reference = Reference(params)
        self.sign = params.sign
        self.error_m = error_m
        self.rng = np.random.default_rng(seed)

    def read(self, t: float, constant_m: float, modelled_std_m: float = 0.002, off_m: float = 0.0) -> Reading:
        reading = self.sign * (heave(t) + constant_m) + 0.002 * self.rng.standard_normal() + off_m
        estimate = heave(t) + self.error_m * np.sqrt(2.0) * float(np.sin(2 * pi * t / 5.1))
        return self.reference.step(t, self.sign * reading, estimate, modelled_std_m)

    def run(self, start: float, end: float, constant_m: float, modelled_std_m: float = 0.002) -> list[Reading]:
        return [self.read(t, constant_m, modelled_std_m) for t in np.arange(start, end, 1.0 / RATE_HZ).tolist()]


@pytest.mark.parametrize("sign", [1, -1])
def test_the_constant_is_found_and_the_sign_applied(sign: Literal[1, -1]) -> None:
    gauge = Gauge(Params(sign=sign))
    assert set(gauge.run(100.0, 114.0, 12.3)) == {Reading.ACCEPTED}
    assert not gauge.reference.is_known
    assert not isfinite(gauge.reference.constant_m)
    assert not isfinite(gauge.reference.error_rms_m())
    gauge.run(114.0, 160.0, 12.3)
    assert gauge.reference.constant_m == pytest.approx(12.3, abs=0.001)
    assert gauge.reference.value_m == pytest.approx(heave(159.95), abs=0.008)
    assert gauge.reference.error_rms_m() == pytest.approx(np.hypot(0.002, 0.002), rel=0.25)


def test_a_tide_is_followed() -> None:
    """1 m in an hour: the lag of a first-order follower is its time constant times the slope."""
    gauge = Gauge(Params(constant_time_s=60.0), error_m=0.0)
    slope = 1.0 / 3600.0
    for t in np.arange(0.0, 500.0, 1.0 / RATE_HZ).tolist():
        gauge.read(t, 12.0 + slope * t)
    assert gauge.reference.constant_m == pytest.approx(12.0 + slope * (500.0 - 60.0), abs=0.002)


def test_outliers_are_refused_and_leave_no_trace() -> None:
    gauge, clean = Gauge(Params()), Gauge(Params())
    gauge.run(0.0, 60.0, 12.0)
    clean.run(0.0, 60.0, 12.0)
    constant = gauge.reference.constant_m
    for k in range(20):  # spray: one second
        assert gauge.read(60.0 + k / RATE_HZ, 12.0, off_m=-3.0) is Reading.OUTLIER
    assert gauge.reference.constant_m == constant
    assert not gauge.reference.is_fresh(61.0)
    assert gauge.read(61.0, 12.0) is Reading.ACCEPTED
    assert gauge.reference.is_fresh(61.0)
    # Outliers that come and go never add up to a new constant.
    for k in range(200):
        gauge.read(62.0 + k / RATE_HZ, 12.0, off_m=-3.0 if k % 20 else 0.0)
    assert gauge.reference.restarts == 0
    assert gauge.reference.constant_m == pytest.approx(12.0, abs=0.005)


def test_a_step_of_the_constant_is_taken_after_three_seconds() -> None:
    gauge = Gauge(Params())
    gauge.run(0.0, 60.0, 12.0)
    verdicts = gauge.run(60.0, 70.0, 11.0)
    first = verdicts.index(Reading.NEW_TARGET)
    assert first / RATE_HZ == pytest.approx(3.0, abs=0.1)
    assert set(verdicts[:first]) == {Reading.OUTLIER}
    assert set(verdicts[first + 1 :]) == {Reading.ACCEPTED}
    assert gauge.reference.restarts == 1
    assert not gauge.reference.is_fresh(70.0)  # fifteen seconds of the new one are needed
    gauge.run(70.0, 100.0, 11.0)
    assert gauge.reference.constant_m == pytest.approx(11.0, abs=0.002)


def test_a_heave_that_is_made_otherwise_is_no_leap_of_the_laser() -> None:
    """A lead that has just been learned moves it at once; what leaps beside it is seen as ever."""
    gauge = Gauge(Params(), error_m=0.02)
    gauge.run(0.0, 60.0, 12.0)
    leapt = copy.deepcopy(gauge)
    assert Reading.OUTLIER in leapt.run(60.0, 62.0, 12.12)
    gauge.reference.rebase(60.0 - 1.0 / RATE_HZ)
    assert set(gauge.run(60.0, 70.0, 12.12)) == {Reading.ACCEPTED}
    assert Reading.OUTLIER in gauge.run(70.0, 72.0, 12.24)
    leapt.reference.rebase(62.0 - 1.0 / RATE_HZ)
    assert Reading.ACCEPTED not in leapt.run(62.0, 62.5, 12.12)


def test_freshness_ends_with_the_age_of_the_last_reading() -> None:
    gauge = Gauge(Params(max_age_s=0.5))
    assert not gauge.reference.is_fresh(0.0)
    gauge.run(0.0, 30.0, 12.0)
    last = 30.0 - 1.0 / RATE_HZ
    assert gauge.reference.is_fresh(last)
    assert gauge.reference.is_fresh(last + 0.49)
    assert not gauge.reference.is_fresh(last + 0.51)


@pytest.mark.parametrize(("error_m", "modelled_m", "scale"), [(0.01, 0.01, 1.0), (0.02, 0.01, 2.0)])
def test_the_scale_is_the_ratio_of_shown_and_modelled_error(error_m: float, modelled_m: float, scale: float) -> None:
    gauge = Gauge(Params(), error_m=error_m)
    assert gauge.reference.scale.value == 1.0
    gauge.run(0.0, 600.0, 12.0, modelled_std_m=modelled_m)
    assert gauge.reference.scale.value == pytest.approx(scale, rel=0.15)


def test_a_smaller_error_is_believed_as_far_as_it_is_sure_and_fades_with_the_laser() -> None:
    """Nine independent numbers in the memory of the comparison: two standard errors of a variance are 2 sqrt(2/9)."""
    gauge = Gauge(Params(), error_m=0.004)
    gauge.run(0.0, 900.0, 12.0, modelled_std_m=0.02)
    sure = 0.2 * sqrt(1.0 + 2.0 * sqrt(2.0 / 9.0))
    assert gauge.reference.scale.at(900.0) == pytest.approx(sure, rel=0.15)
    faded = [gauge.reference.scale.at(900.0 + s) for s in (60.0, 180.0, 360.0, 3600.0)]
    assert faded == sorted(faded)
    assert faded[1] > 0.75
    assert faded[-1] == pytest.approx(1.0, abs=1e-6)
    gauge.run(4500.0, 4501.0, 12.0, modelled_std_m=0.02)  # It comes back, and has to show it again.
    assert gauge.reference.scale.at(4501.0) > 0.95
    assert gauge.reference.scale.at(3000.0) == gauge.reference.scale.value


def test_a_larger_error_stays_when_the_laser_has_gone() -> None:
    gauge = Gauge(Params(), error_m=0.02)
    gauge.run(0.0, 600.0, 12.0, modelled_std_m=0.01)
    assert gauge.reference.scale.at(9000.0) == gauge.reference.scale.value > 1.5


def test_the_scale_is_bounded_and_needs_a_model() -> None:
    gauge = Gauge(Params(), error_m=0.05)
    gauge.run(0.0, 300.0, 12.0, modelled_std_m=1e-5)
    assert gauge.reference.scale.value <= 10.0
    gauge = Gauge(Params(), error_m=0.05)
    gauge.run(0.0, 100.0, 12.0, modelled_std_m=nan)
    gauge.run(100.0, 110.0, 12.0, modelled_std_m=0.0)
    assert gauge.reference.scale.value == 1.0


def test_a_reading_of_the_same_moment_does_no_harm() -> None:
    gauge = Gauge(Params())
    gauge.run(0.0, 60.0, 12.0)
    constant = gauge.reference.constant_m
    gauge.read(59.95, 12.05)
    assert gauge.reference.constant_m == constant
