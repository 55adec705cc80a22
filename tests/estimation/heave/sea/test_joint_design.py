"""What roll and pitch have in common with the heave, found again in a small system whose coefficients are known; and
what the filter of all three should reach, by the limits of the accuracy tool, which are computed in their own way.
"""

from __future__ import annotations

from functools import cache
from math import nan
from typing import NamedTuple

import msgspec
import numpy as np
import pytest
from evidence.channel_limits import PITCH, ROLL, causal_limits, measured_spectra
from seas import model, simulated

from heaved.estimation.heave.sea import joint_design, joint_learning
from heaved.estimation.heave.sea.joint_design import TUNING
from heaved.estimation.heave.sea.joint_learning import TUNING as LEARNING
from heaved.estimation.heave.sea.joint_learning import Learned
from heaved.estimation.heave.sea.model import SeaSystem, Steady

Array = np.ndarray
DT_S = 0.2
SYSTEM = SeaSystem(msgspec.structs.replace(model(noise_psd=1e-4), bias_walk_psd=9e-8))


def _steady() -> Steady:
    found = SYSTEM.steady(DT_S)
    assert found is not None
    return found


STEADY = _steady()
ROLL_OF = (0.004, 0.03)
"""Coefficients of heave (rad/m) and of its velocity (rad s/m)."""
PITCH_OF = (-0.01, 0.012)
NOISE_RAD = 2e-4


class Record(NamedTuple):
    a_mps2: Array
    heave_m: Array
    angles_rad: Array


def driven(states: Array, coefficients: tuple[float, float]) -> Array:
    return coefficients[0] * (states @ SYSTEM.heave) + coefficients[1] * (states @ SYSTEM.velocity)


@cache
def record(rest: float, seed: int = 1, seconds: float = 600.0) -> Record:
    """Angles that follow from the heave, and ``rest`` times the same of another sea beside."""
    count = round(seconds / DT_S)
    states, a = simulated(SYSTEM, DT_S, count, seed)
    rng = np.random.default_rng(seed + 100)
    angles = []
    for k, coefficients in enumerate((ROLL_OF, PITCH_OF)):
        other, _ = simulated(SYSTEM, DT_S, count, seed + 10 * (k + 1))
        angle = driven(states, coefficients) + rest * driven(other, coefficients)
        angles.append(angle + NOISE_RAD * rng.standard_normal(count) + (0.02, -0.01)[k])
    return Record(a, states @ SYSTEM.heave, np.column_stack(angles))


def test_the_coefficients_of_a_small_system_are_found_again() -> None:
    one = record(0.2)
    found = joint_learning.learned(SYSTEM.model, one.a_mps2, one.angles_rad, DT_S)
    assert found is not None
    inside = (found.f_hz > 0.08) & (found.f_hz < 0.2)
    for k, (of_heave, of_velocity) in enumerate((ROLL_OF, PITCH_OF)):
        truth = of_heave + 2j * np.pi * found.f_hz * of_velocity
        error = np.abs(found.transfer[inside, k] - truth[inside]) / np.abs(truth[inside])
        assert np.sqrt(np.mean(error**2)) < 0.2  # 0.2 / sqrt(about 5 pieces), and what they leave out
        share = found.rest[inside, k, k].real / np.abs(truth[inside]) ** 2
        assert 0.2**2 < np.mean(share) < 0.12  # the rest, and what is never taken to follow
    assert found.offsets_rad == pytest.approx((0.02, -0.01), abs=5e-4)
    assert 0.9 < found.coherence < 1.0 / 1.02


def test_of_angles_of_another_sea_nothing_is_learned() -> None:
    one, other = record(0.2), record(0.2, 5)
    found = joint_design.joint(SYSTEM, STEADY, one.a_mps2, other.angles_rad, (1.0,))
    assert found is not None
    assert found.ratios[0] > 0.97
    assert found.coherence < 0.3


def test_the_heave_in_hindsight_is_the_heave() -> None:
    one = record(0.2)
    found = joint_learning.in_hindsight(SYSTEM.model, one.a_mps2, DT_S)
    inside = slice(200, -200)
    assert np.std(found[inside] - one.heave_m[inside]) < 0.05 * np.std(one.heave_m)


@pytest.mark.parametrize("share", [0.6, 0.9])
def test_the_filter_leaves_what_the_limit_of_three_channels_leaves(share: float) -> None:
    f = np.linspace(0.02, 1.0, 99)
    transfer = np.column_stack([h + 2j * np.pi * f * v for h, v in (ROLL_OF, PITCH_OF)])
    rest = np.zeros((len(f), 2, 2), dtype=np.complex128)
    for k in range(2):
        rest[:, k, k] = np.abs(transfer[:, k]) ** 2 * (1.0 / share - 1.0)
    psd = 2.0 * DT_S * NOISE_RAD**2
    known = Learned(f, transfer, rest, (psd, psd), (0.0, 0.0), 0.02, (0.0, 0.0), share)
    horizons_s = (0.0, 1.0, 3.0)
    found = joint_design.designed(SYSTEM, STEADY, known, horizons_s)
    assert found is not None

    grid = np.linspace(0.0, 0.5 / DT_S, 4001)
    sea, transfer, rest = joint_design._on_grid(SYSTEM.model, known, grid)
    follows = np.column_stack((np.ones(len(grid)), transfer))
    motion = sea[:, None, None] * follows[:, :, None] * follows[:, None, :].conj()
    motion[:, 1:, 1:] += sea[:, None, None] * rest
    walk = SYSTEM.model.noise_psd + 2.0 * SYSTEM.model.bias_walk_psd / (2.0 * np.pi * np.maximum(grid, grid[1])) ** 2
    wander = TUNING.least_wander / np.maximum(grid, 0.5 * grid[1]) ** 2
    alone, both = (
        causal_limits(measured_spectra(grid, np.asarray(motion), walk, psd + wander[:, None], angles), horizons_s)
        for angles in ((), (ROLL, PITCH))
    )
    assert found.ratios == pytest.approx(np.array(both) / np.array(alone), abs=0.03)
    assert found.ratios[0] < (0.95 if share < 0.8 else 0.85)


def test_a_list_makes_no_heave_that_stays() -> None:
    one = record(0.2)
    found = joint_design.joint(SYSTEM, STEADY, one.a_mps2, one.angles_rad, ())
    assert found is not None
    assert found.ratios[0] < 0.9
    fine, coarse = (
        np.frombuffer(part, np.float16).astype(float).reshape(2, -1, 3) for part in (found.fine, found.coarse)
    )
    for k in (1, 2):
        list_rad = np.radians(0.1)
        stays_m = list_rad * abs(fine[0, :, k].sum() + coarse[0, :, k].sum())
        assert stays_m < 0.2 * found.stds_m[0]
        assert stays_m < 0.1 * list_rad * (np.abs(fine[0, :, k]).sum() + np.abs(coarse[0, :, k]).sum())


def test_the_past_counts_since_the_vessel_has_headed_as_it_does() -> None:
    t_s = np.arange(0.0, 100.0, 0.5)
    yaw = np.radians(np.where(t_s < 40.0, 300.0, np.where(t_s < 60.0, 330.0, 355.0)) + 8.0 * np.sin(t_s)) % (
        2.0 * np.pi
    )
    yaw[(t_s > 50.0) & (t_s < 55.0)] = nan
    heading_rad, since_s = joint_learning.heading(t_s, yaw)
    assert abs(np.angle(np.exp(1j * (heading_rad - np.radians(355.0))))) < np.radians(1.5)
    assert 58.0 < since_s < 60.0
    assert joint_learning.heading(t_s, np.full(len(t_s), nan)) == pytest.approx((nan, -np.inf), nan_ok=True)
    assert joint_learning.heading(t_s[:0], yaw[:0])[1] == -np.inf


def test_horizons_that_are_close_share_a_node() -> None:
    assert joint_design.nodes((5.0, 0.05, 0.1, 0.5, 1.0, 2.0, 0.0)) == (0.0, 0.5, 1.0, 2.0, 5.0)
    assert joint_design.nodes(()) == (0.0,)


@pytest.mark.parametrize(
    ("seconds", "missing"),
    [
        (LEARNING.least_s + 2.0 * LEARNING.edge_s - 1.0, slice(0, 0)),
        (300.0, slice(450, 1000)),
        (300.0, np.arange(1500) % 350 < 20),
        (300.0, slice(0, None)),
    ],
    ids=["short", "hole", "holes", "no angles"],
)
def test_too_little_of_a_record_teaches_nothing(seconds: float, missing: slice | Array) -> None:
    one, count = record(0.2), round(seconds / DT_S)
    angles = one.angles_rad[-count:].copy()
    angles[missing, 1] = nan
    assert joint_design.joint(SYSTEM, STEADY, one.a_mps2[-count:], angles, ()) is None


@pytest.mark.parametrize("is_of_angles", [True, False], ids=["angles", "acceleration"])
def test_both_sides_of_a_long_hole_teach(is_of_angles: bool) -> None:
    """Each by itself is too short."""
    one, count = record(0.2), round(300.0 / DT_S)
    a, angles = one.a_mps2[-count:].copy(), one.angles_rad[-count:].copy()
    (angles[:, 0] if is_of_angles else a)[650:850] = nan
    for part in (slice(0, 650), slice(850, count)):
        assert joint_learning.learned(SYSTEM.model, a[part], angles[part], DT_S) is None
    found = joint_learning.learned(SYSTEM.model, a, angles, DT_S)
    assert found is not None
    inside = (found.f_hz > 0.08) & (found.f_hz < 0.2)
    for k, (of_heave, of_velocity) in enumerate((ROLL_OF, PITCH_OF)):
        truth = of_heave + 2j * np.pi * found.f_hz * of_velocity
        error = np.abs(found.transfer[inside, k] - truth[inside]) / np.abs(truth[inside])
        assert np.sqrt(np.mean(error**2)) < 0.3  # fewer pieces than in ten minutes
    assert 0.85 < found.coherence < 1.0 / 1.02


def test_trim_and_list_are_those_since_a_long_hole() -> None:
    one = record(0.2)
    angles = one.angles_rad.copy()
    angles[:1500] += 0.05
    angles[1500:1700] = nan
    found = joint_learning.learned(SYSTEM.model, one.a_mps2, angles, DT_S)
    assert found is not None
    assert found.offsets_rad == pytest.approx((0.02, -0.01), abs=1e-3)


def test_angles_are_interpolated_between_near_neighbours_alone() -> None:
    t_s = np.array([0.0, 0.1, 0.2, 0.3, 2.0, 2.1, 2.2])
    rows = np.column_stack((t_s, t_s, -t_s))
    rows[1, 2] = nan
    found = joint_learning.even_angles(rows, 2.15, 0.1, 26)
    at = 2.15 - 0.1 * np.arange(25, -1, -1.0)
    near = ((at > -0.1) & (at < 0.3)) | (at > 2.0)
    assert np.array_equal(np.isfinite(found[:, 0]), near)
    inside = near & (at >= 0.0)
    assert found[inside] == pytest.approx(np.column_stack((at, -at))[inside])
    assert np.isnan(joint_learning.even_angles(rows[:1], 2.15, 0.1, 3)).all()
