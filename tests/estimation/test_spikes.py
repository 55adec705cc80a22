"""Oracle: readings made of a sea plus spikes at known places."""

import numpy as np
import pytest

from heaved.estimation.spikes import SpikeGate


def sea(rate_hz: float, duration_s: float = 60.0) -> tuple[np.ndarray, np.ndarray]:
    t = np.arange(0.0, duration_s, 1.0 / rate_hz)
    noise = 0.02 * np.random.default_rng(1).standard_normal(len(t))
    return t, 1.5 * np.sin(0.9 * t) + 0.5 * np.sin(2.1 * t) + noise


def passed(gate: SpikeGate, t: np.ndarray, a: np.ndarray) -> np.ndarray:
    return np.array([gate(*pair) for pair in zip(t.tolist(), a.tolist(), strict=True)])


@pytest.mark.parametrize("rate_hz", [10.0, 20.0, 100.0])
def test_a_sea_passes_untouched_and_spikes_do_not(rate_hz: float) -> None:
    t, a = sea(rate_hz)
    gate = SpikeGate()
    assert (passed(gate, t, a) == a).all()
    assert gate.rejected == 0
    at = [len(t) // 2, len(t) // 2 + 40, len(t) - 5]
    a[at] += [20.0, -5.0, 4.5]
    out = passed(gate := SpikeGate(), t, a)
    assert np.flatnonzero(np.isnan(out)).tolist() == at
    assert gate.rejected == 3


def test_a_level_that_lasts_is_let_through() -> None:
    t, a = sea(50.0)
    a[t >= 30.0] += 5.0
    out = passed(SpikeGate(), t, a)
    withheld = t[np.isnan(out)]
    assert withheld.min() == pytest.approx(30.0)
    assert withheld.max() < 30.2


@pytest.mark.parametrize("value", [20.0, -9.80665, 156.0, 3e38, -3e38])
def test_what_no_vessel_does_is_withheld_however_long_it_lasts(value: float) -> None:
    """-9.8 is a register that reads zero, 156 one at the end of its range."""
    t, a = sea(20.0)
    bad = (t >= 30.0) & (t < 40.0)
    a[bad] = value
    gate = SpikeGate()
    out = passed(gate, t, a)
    assert np.isnan(out[bad]).all()
    assert (out[~bad] == a[~bad]).all()
    assert np.isnan(SpikeGate()(0.0, value))  # the very first reading too


def test_missing_values_are_missing_and_change_nothing() -> None:
    t, a = sea(20.0)
    holes = np.random.default_rng(2).random(len(t)) < 0.3
    out = passed(SpikeGate(), t, np.where(holes, np.nan, a))
    assert np.isnan(out[holes]).all()
    assert (out[~holes] == a[~holes]).all()
    assert np.isnan(SpikeGate()(0.0, float("inf")))


def test_after_a_gap_any_level_is_a_new_beginning() -> None:
    t, a = sea(20.0)
    out = passed(gate := SpikeGate(), t[:400], a[:400])
    assert np.isfinite(out).all()
    assert gate(t[399] + 0.6, a[399] + 4.0) == a[399] + 4.0
