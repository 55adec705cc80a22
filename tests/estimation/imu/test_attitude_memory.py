"""Lean and lateness over a restart. Oracle: the time constant and delay put into the simulated sensor."""

from __future__ import annotations

from functools import cache
from math import inf, nan

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from heaved.estimation.imu.attitude import level_acceleration
from heaved.estimation.imu.attitude_error import AttitudeError
from heaved.estimation.imu.attitude_memory import SavedAttitudeError
from heaved.samples import ImuSample
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import SENSORS, Recording, record

Array = NDArray[np.float64]
RATE_HZ = 10.0
STOPPED_S, AWAY_S, END_S = 330.0, 60.0, 560.0
QUIET = msgspec.structs.replace(SENSORS["A"], noise_mps2_rthz=3e-4, bias_walk_mps2_rts=1e-6)


@cache
def recorded(lean_s: float, late_s: float) -> Recording:
    sensor = msgspec.structs.replace(QUIET, attitude_lean_s=lean_s, attitude_late_s=late_s)
    return record(seaway("S6", 2), END_S, imu_rate_hz=RATE_HZ, sensor=sensor, laser="off", seed=2)


def go(one: AttitudeError, recording: Recording, from_s: float, to_s: float) -> Array:
    """(n, 5) without gyroscopes: time since ``from_s``, lean and lateness, and their standard deviations."""
    slope = [np.gradient(angle, 1.0 / RATE_HZ) for angle in (recording.roll_rad, recording.pitch_rad)]
    found = []
    for i, sample in enumerate(sample for sample in recording.samples() if isinstance(sample, ImuSample)):
        if not from_s <= sample.t_s < to_s:
            continue
        roll, pitch = sample.roll_rad, sample.pitch_rad
        x, y, up = level_acceleration(sample.ax_mps2, sample.ay_mps2, sample.az_mps2, roll, pitch)
        one.step(sample.t_s, x, y, up, roll, pitch, slope[0][i], slope[1][i], are_rates_measured=False)
        std = np.sqrt(np.diag(one.covariance))
        found.append((sample.t_s - from_s, one.lean_per_s, one.late_s, *std))
    return np.array(found)


@cache
def first_run(lean_s: float, late_s: float) -> SavedAttitudeError:
    one = AttitudeError()
    go(one, recorded(lean_s, late_s), 0.0, STOPPED_S)
    saved = one.saved()
    assert saved is not None
    return msgspec.json.decode(msgspec.json.encode(saved), type=SavedAttitudeError)


@pytest.mark.parametrize(("lean_s", "late_s"), [(8.0, 0.04), (20.0, 0.06), (inf, 0.0)])
def test_a_restart_knows_them_from_the_first_look_on(lean_s: float, late_s: float) -> None:
    """Where a cold start knows nothing for three minutes."""
    saved, truth = first_run(lean_s, late_s), np.array([1.0 / lean_s, late_s])
    warm, cold = AttitudeError(), AttitudeError()
    warm.restore(saved, AWAY_S)
    now, alone = (go(one, recorded(lean_s, late_s), STOPPED_S, END_S) for one in (warm, cold))
    off = np.abs(now[:, 1:3] - truth)
    known = now[:, 0] > 21.0
    off_saved = np.abs([saved.lean_per_s, saved.late_s] - truth)
    assert np.all(off[known] < off_saved + np.array([0.02, 0.01]))
    assert np.all(off < 4.0 * now[:, 3:])
    early = (alone[:, 0] > 21.0) & (alone[:, 0] < 150.0)
    assert np.all(now[early, 3:] < 0.6 * alone[early, 3:])


@pytest.mark.parametrize(
    ("lean_s", "late_s", "remembered"),
    [(8.0, 0.04, (0.0, 0.09)), (20.0, 0.06, (0.12, 0.12)), (inf, 0.0, (0.12, 0.05)), (inf, 0.0, (0.1, -0.05))],
)
def test_those_of_another_sensor_are_dropped(lean_s: float, late_s: float, remembered: tuple[float, float]) -> None:
    """And until the record shows it they are as little sure as they are wrong; then it is the cold start."""
    lean_per_s, was_late_s = remembered
    other = SavedAttitudeError(lean_per_s=lean_per_s, late_s=was_late_s, covariance=(1e-5, 0.0, 1e-5))
    wrong, cold = AttitudeError(), AttitudeError()
    wrong.restore(other, AWAY_S)
    now, alone = (go(one, recorded(lean_s, late_s), STOPPED_S, END_S) for one in (wrong, cold))
    shown = alone[:, 3] < 0.09
    assert np.array_equal(now[shown][-1, 1:], alone[shown][-1, 1:])
    off = np.abs(now[:, 1:3] - [1.0 / lean_s, late_s])
    assert np.all(off < np.maximum(4.0 * now[:, 3:], np.abs(alone[:, 1:3] - [1.0 / lean_s, late_s]) + 1e-12))


def test_until_the_record_shows_them_they_are_saved_as_they_were() -> None:
    saved, one = first_run(8.0, 0.04), AttitudeError()
    one.restore(saved, AWAY_S)
    assert one.saved() == msgspec.structs.replace(saved, unconfirmed_s=AWAY_S)
    go(one, recorded(8.0, 0.04), STOPPED_S, STOPPED_S + 100.0)
    found = one.saved()
    assert found is not None
    assert found == msgspec.structs.replace(saved, unconfirmed_s=found.unconfirmed_s)
    assert AWAY_S + 60.0 < found.unconfirmed_s < AWAY_S + 100.0
    go(one, recorded(8.0, 0.04), STOPPED_S + 100.0, END_S)
    found = one.saved()
    assert found is not None
    assert found.unconfirmed_s == 0.0
    assert found.lean_per_s == one.lean_per_s


def test_the_remembered_fade_as_their_record_would_have() -> None:
    """In ten minutes at rest, where nothing shows anything, they are forgotten."""
    one, step_s = AttitudeError(), 0.125
    one.restore(first_run(8.0, 0.04), AWAY_S)
    for i in range(round(650.0 / step_s)):
        one.step(i * step_s, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, are_rates_measured=False)
    assert one.saved() is None
    assert (one.lean_per_s, one.late_s) == (0.0, 0.0)


def test_what_is_too_old_is_not_taken_and_of_unknown_age_it_is_less_sure() -> None:
    saved = first_run(8.0, 0.04)
    old, unknown, young = AttitudeError(), AttitudeError(), AttitudeError()
    old.restore(saved, 3601.0)
    assert old.saved() is None
    unknown.restore(saved, nan)
    young.restore(saved, 0.0)
    assert unknown.saved() == young.saved() == saved
    assert unknown.covariance[1, 1] > young.covariance[1, 1] + 0.014**2
    assert old.covariance[1, 1] > unknown.covariance[1, 1]


def test_before_anything_was_found_nothing_is_saved() -> None:
    one = AttitudeError()
    assert one.saved() is None
    go(one, recorded(8.0, 0.04), 0.0, 60.0)
    assert one.saved() is None
