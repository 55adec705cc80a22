"""When the sea is fitted again, to what, and whose answer is taken."""

from __future__ import annotations

import numpy as np
import pytest

from heaved.estimation.heave.sea.record import EvenRecord, SeaRecord, even

DT_S = 0.05
Array = np.ndarray


def asked(changing_from_s: float, until_s: float = 200.0) -> list[float]:
    """Times at which a fit is due, in seconds since the first sample; first after 40 s, then every 20 s."""
    record = SeaRecord(120.0, 40.0, 20.0)
    record.start(1000.0)
    found = []
    for k in range(1, round(until_s / DT_S) + 1):
        t_s = 1000.0 + k * DT_S
        record.push(t_s, 0.0)
        if record.is_due(t_s, is_changing=t_s - 1000.0 >= changing_from_s):
            record.ask(t_s)
            found.append(t_s - 1000.0)
    return found


def test_early_fits_come_sooner_and_later_ones_as_configured() -> None:
    early = [40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 100.0, 110.0]
    assert asked(1e9) == pytest.approx([*early, 130.0, 150.0, 170.0, 190.0], abs=1.5 * DT_S)


def test_a_sea_that_changes_is_looked_at_sooner() -> None:
    assert asked(155.0, 195.0)[-5:] == pytest.approx([150.0, 160.0, 170.0, 180.0, 190.0], abs=5.5 * DT_S)


def test_before_the_first_sample_nothing_is_due() -> None:
    assert not SeaRecord(120.0, 40.0, 20.0).is_due(1e6, is_changing=True)


def test_a_fit_sees_the_longest_window() -> None:
    record = SeaRecord(120.0, 40.0, 20.0)
    record.start(0.0)
    times = DT_S * np.arange(1, 4000)
    for t_s in times.tolist():
        record.push(t_s, 2.0 * t_s)
    _, rows = record.ask(times[-1])
    expected = times[times >= times[-1] - 120.0]
    np.testing.assert_array_equal(rows, np.column_stack((expected, 2.0 * expected)))


def test_only_the_answer_that_is_awaited_is_taken_and_that_once() -> None:
    record = SeaRecord(120.0, 40.0, 20.0)
    first, _ = record.ask(40.0)
    second, _ = record.ask(50.0)
    assert not record.answered(first)
    assert record.answered(second)
    assert not record.answered(second)
    third, _ = record.ask(60.0)
    record.clear()
    assert not record.answered(third)


def test_a_cut_is_remembered_for_as_long_as_what_it_cuts() -> None:
    record = SeaRecord(120.0, 40.0, 20.0)
    for k in range(10):
        record.push(float(k), 0.0)
    record.cut(9.5, 12.0)
    for k in range(10, 20):
        assert record.follows(float(k))
        record.push(float(k), 0.0)
    assert record.since(0.0)[:, 0].tolist() == list(map(float, range(20)))
    record.cut(100.0, 101.0)
    assert record.cuts_s == ((9.5, 12.0), (100.0, 101.0))
    record.cut(140.0, 140.0)
    assert record.cuts_s == ((100.0, 101.0), (140.0, 140.0))
    assert not record.follows(19.0)


@pytest.mark.parametrize(("more_mps2", "is_due"), [(1e-2, True), (1e-5, False)])
def test_a_past_that_is_amended_much_is_looked_at_anew(more_mps2: float, is_due: bool) -> None:
    record = SeaRecord(120.0, 40.0, 20.0)
    record.start(0.0)
    for k in range(1, 3000):
        record.push(k * DT_S, 1.0)
    record.ask(150.0)
    record.amend(np.array([100.0, 140.0]), np.array([more_mps2, more_mps2]))
    assert record.is_due(162.0, is_changing=False) is is_due
    a = record.since(0.0)
    assert a[a[:, 0] > 140.1, 1] == pytest.approx(1.0)
    within = (a[:, 0] > 100.0) & (a[:, 0] < 140.0)
    assert a[within, 1] == pytest.approx(1.0 + more_mps2)


# --- an even grid ----------------------------------------------------------------------------------------------------


def signal(t: Array) -> Array:
    return np.asarray(0.8 * np.sin(0.8 * t) + 0.3 * np.sin(2.2 * t + 1.0))


def grid_of(made: EvenRecord) -> Array:
    return made.end_s - made.dt_s * np.arange(len(made.a_mps2) - 1, -1, -1.0)


@pytest.mark.parametrize("jitter", [0.0, 1e-4, 0.05, 0.2])
def test_jittered_samples_are_put_on_the_grid(jitter: float) -> None:
    rng = np.random.default_rng(3)
    t = 1e4 + DT_S * (np.arange(4000) + rng.uniform(-jitter, jitter, 4000))
    made = even(t, signal(t))
    assert made.end_s == t[-1]
    assert made.dt_s == pytest.approx(DT_S, rel=1e-3)
    assert len(made.a_mps2) == pytest.approx(4000, abs=2)
    assert made.is_known.all()
    inner = slice(20, -20)
    assert np.max(np.abs(made.a_mps2 - signal(grid_of(made)))[inner]) < (1e-4 if jitter > 1e-3 else 2e-5)


@pytest.mark.parametrize("jitter", [0.0, 0.1])
def test_missing_samples_are_filled_and_holes_are_holes(jitter: float) -> None:
    rng = np.random.default_rng(4)
    kept = rng.random(4000) > 0.05
    kept[1000:1060] = kept[2000:2200] = False
    kept[[0, 999, 1060, 1999, 2200, 3999]] = True
    i = np.flatnonzero(kept)
    t = DT_S * (i + rng.uniform(-jitter, jitter, len(i)))
    made = even(t, signal(t))
    at = grid_of(made)
    deep = ((at > 50.2) & (at < 52.7)) | ((at > 100.2) & (at < 109.7))
    near = ((at > 49.8) & (at < 53.2)) | ((at > 99.7) & (at < 110.2))
    assert not made.is_known[deep].any()
    assert made.is_known[~near].all()
    inner = ~near & (at > 1.0) & (at < 199.0)
    assert np.max(np.abs(made.a_mps2 - signal(at))[inner]) < 3e-3
    assert np.sqrt(np.mean((made.a_mps2 - signal(at))[inner] ** 2)) < 2e-4
    assert np.max(np.abs(made.a_mps2)) < 1.2  # nothing swings in a hole


def test_a_clock_that_drifts_is_followed() -> None:
    """One part in a thousand fast: over ten minutes that is twelve samples."""
    t = DT_S * 1.001 * np.arange(12_000, dtype=np.float64)
    made = even(t, signal(t))
    assert made.dt_s == pytest.approx(DT_S * 1.001, rel=1e-6)
    assert np.max(np.abs(made.a_mps2 - signal(grid_of(made)))) < 1e-4


def test_a_drift_lasts_until_it_ends_or_the_level_is_another_one() -> None:
    record = SeaRecord(300.0, 40.0, 20.0)
    record.end_drift(5.0)
    assert not record.drifts_s
    record.begin_drift(100.0)
    assert list(record.drifts_s) == [(100.0, np.inf)]
    record.end_drift(160.0)
    record.begin_drift(150.0)  # It had not ended, after all.
    assert list(record.drifts_s) == [(100.0, np.inf)]
    record.cut(200.0, 201.0)
    assert list(record.drifts_s) == [(100.0, 200.0)]
    record.begin_drift(190.0)  # What was before the step has nothing to do with what comes after.
    assert list(record.drifts_s) == [(100.0, 200.0), (201.0, np.inf)]
    record.end_drift(230.0)
    record.begin_drift(520.0)
    assert list(record.drifts_s) == [(201.0, 230.0), (520.0, np.inf)]
    record.clear()
    assert not record.drifts_s
