"""What rings after blows, taken out of a record whose ringing is known."""

from __future__ import annotations

import numpy as np
import pytest

from heaved.estimation.heave.sea import batch_filter
from heaved.estimation.heave.sea.blow_removal import modes, ringing
from heaved.estimation.heave.sea.model import SeaModel
from heaved.estimation.heave.sea.record import EvenRecord, even
from heaved.simulate.seaway import seaway

DT_S, COUNT = 0.05, 6000
T = DT_S * np.arange(COUNT, dtype=np.float64)
BLOWS_S = (31.02, 47.51, 80.03, 81.74, 120.27, 163.76, 201.03, 240.52, 283.01)
SEA = SeaModel(
    stages=6,
    frequency_hz=(0.11, 0.16, 0.3),
    damping=(0.4, 0.6, 0.6),
    level_m2phz=(10.0, 1.0, 0.02),
    noise_psd=1e-6,
    bias_walk_psd=1e-9,
)
Array = np.ndarray


def rung(f_hz: float, damping: float, size_mps2: float = 2.0) -> Array:
    """Each is the impulse response of a mode, written in real numbers."""
    w = 2.0 * np.pi * f_hz
    total = np.zeros(COUNT)
    for k, blow_s in enumerate(BLOWS_S):
        since = np.maximum(T - blow_s, 0.0)
        turn = w * np.sqrt(1.0 - damping**2) * since
        total += size_mps2 * (1.0 - 0.1 * (k % 3)) * np.exp(-damping * w * since) * np.sin(turn)
    return total


def struck(added: Array, seed: int = 1) -> tuple[Array, list[int], EvenRecord]:
    """What is there without blows, where they are, and the record."""
    noise = 4.5e-3 * np.random.default_rng(seed).standard_normal(COUNT)
    still = seaway("S6", seed, attitude=False).motion(T).heave_acceleration_mps2 + noise
    places = [int(np.ceil(blow_s / DT_S)) for blow_s in BLOWS_S]
    record = even(T, still + added).cut((), (), tuple(T[places].tolist()))
    return still, places, record


@pytest.mark.parametrize(("f_hz", "damping"), [(2.2, 0.07), (1.1, 0.03), (4.5, 0.02)])
def test_the_mode_of_the_hull_is_found(f_hz: float, damping: float) -> None:
    _, places, record = struck(rung(f_hz, damping))
    found = modes(record, places, 2)
    nearest = found[np.argmin(np.abs(np.abs(found) - 2.0 * np.pi * f_hz))]
    assert abs(nearest) / (2.0 * np.pi) == pytest.approx(f_hz, rel=0.01)
    assert -nearest.real / abs(nearest) == pytest.approx(damping, abs=0.008)


def test_two_modes_are_told_apart() -> None:
    _, places, record = struck(rung(1.3, 0.04) + rung(3.4, 0.03, 0.7))
    found = np.sort(np.abs(modes(record, places, 2)) / (2.0 * np.pi))
    assert found == pytest.approx([1.3, 3.4], rel=0.02)


@pytest.mark.parametrize(("f_hz", "damping"), [(2.2, 0.07), (1.1, 0.03)])
def test_hardly_anything_of_it_is_left_below_the_waves(f_hz: float, damping: float) -> None:
    still, _, record = struck(rung(f_hz, damping))
    left = record.a_mps2 - ringing(record, SEA, 1).a_mps2 - still
    f = np.fft.rfftfreq(COUNT, DT_S)
    below = (f > 0.0) & (f < 0.08)
    before = np.sum(np.abs(np.fft.rfft(record.a_mps2 - still))[below] ** 2)
    assert np.sum(np.abs(np.fft.rfft(left))[below] ** 2) < 0.1 * before


def test_nothing_is_taken_out_where_nothing_rings() -> None:
    _, places, record = struck(np.zeros(COUNT))
    assert len(modes(record, places, 2)) == 0
    taken = ringing(record, SEA, 1)
    assert not taken.ringing_mps2.any()
    # A blow that was none costs the readings about it, as far as they are not what the waves foretell.
    assert np.max(np.abs(taken.spoilt_mps2)) < 0.05


def test_a_blow_at_the_very_end_is_left_alone() -> None:
    still, _, record = struck(np.zeros(COUNT))
    record = even(T, still).cut((), (), (float(T[-1]),))
    assert not ringing(record, SEA, 1).a_mps2.any()


def test_a_filter_that_leaves_the_finite_numbers_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    _, _, record = struck(rung(2.2, 0.03))
    done = batch_filter.Run(x=np.full(2, np.inf), P=None, predicted_m=np.zeros(COUNT), innovation=np.zeros(COUNT))
    monkeypatch.setattr(batch_filter, "run", lambda *_, **__: done)
    with pytest.raises(np.linalg.LinAlgError, match="leaves the finite numbers"):
        ringing(record, SEA, 1)
