"""One look at the past: what it makes of seas that stay, change and break off, and of what is no record."""

from __future__ import annotations

from math import nan

import msgspec
import numpy as np
import pytest

from heaved.estimation.heave.sea.joint_design import TUNING as JOINT
from heaved.estimation.heave.sea.model import SeaSystem, heave_std
from heaved.estimation.heave.sea.observer import TUNING
from heaved.estimation.heave.sea.record import EvenRecord, even
from heaved.estimation.heave.sea.refit import Candidate, SeaFit, SeaWindow, look, unbroken, whiteness
from heaved.simulate.seaway import seaway

DT_S = 0.05
Array = np.ndarray


def sea(name: str, seconds: float, seed: int = 1) -> tuple[Array, Array, Array]:
    """Times, heave and noisy acceleration (sensor A)."""
    t = DT_S * np.arange(round(seconds / DT_S), dtype=np.float64)
    made = seaway(name, seed, attitude=False).motion(t)
    noise = 1e-3 * np.sqrt(0.5 / DT_S) * np.random.default_rng(seed).standard_normal(len(t))
    return t, made.heave_m, made.heave_acceleration_mps2 + noise


def window(t: Array, a: Array, before: SeaFit | None = None, **changes: object) -> SeaWindow:
    asked = SeaWindow(
        number=3,
        t_s=np.ascontiguousarray(t).tobytes(),
        a_mps2=np.ascontiguousarray(a).tobytes(),
        stages=6,
        components=2,
        windows_s=(120.0, 300.0, 600.0),
        bias_walk_psd=4e-10,
        delay_s=30.0,
        looked_s=nan if before is None else before.t_s,
        candidates=() if before is None else before.candidates,
    )
    return msgspec.structs.replace(asked, **changes)


@pytest.fixture(scope="module")
def s6() -> tuple[Array, Array, Array]:
    return sea("S6", 640.0)


def test_the_state_that_is_handed_over_is_the_heave_of_the_last_sample(s6: tuple[Array, Array, Array]) -> None:
    t, heave, a = s6
    fit = look(window(t[:12_000], a[:12_000]))
    assert fit.message == ""
    assert fit.model is not None
    system = SeaSystem(fit.model)
    x = np.frombuffer(fit.x)
    assert (fit.t_s, fit.dt_s) == pytest.approx((t[11_999], DT_S))
    assert fit.record_s == pytest.approx(600.0, abs=0.1)
    assert abs(system.heave @ x - heave[11_999]) < 0.05 * np.std(heave)
    predicted = np.frombuffer(fit.predicted_m)
    assert len(predicted) == round(60.0 / DT_S)
    assert len(np.frombuffer(fit.innovation)) == round(JOINT.filter_s / DT_S)
    assert np.std(predicted - heave[12_000 - len(predicted) : 12_000]) < 0.03 * np.std(heave)
    assert fit.sea is not None
    assert fit.sea.significant_height_m == pytest.approx(4.0 * np.std(heave), rel=0.15)
    assert fit.waves > 100.0
    assert 0.3 < fit.whiteness < 3.0
    assert [candidate.window_s for candidate in fit.candidates] == [120.0, 300.0, 600.0]


def test_a_length_that_is_not_reached_gets_all_there_is(s6: tuple[Array, Array, Array]) -> None:
    t, _, a = s6
    fit = look(window(t[:4000], a[:4000]))
    assert [candidate.window_s for candidate in fit.candidates] == [120.0, 300.0]


def test_a_sea_that_grew_is_judged_by_the_short_past() -> None:
    """Three times as high from 400 s on; a look every 20 s. Innovations tell the lengths apart, and none is dropped."""
    t, _, a = sea("S4", 560.0)
    a = a * np.where(t < 400.0, 1.0, 3.0)
    before = None
    chosen = {}
    for end in range(360, 561, 20):
        fit = look(window(t[: round(end / DT_S)], a[: round(end / DT_S)], before))
        assert fit.message == ""
        assert len(fit.candidates) == 3
        chosen[end], before = fit.window_s, fit
    assert chosen[520] == 120.0
    best = max(before.candidates, key=lambda c: c.score) if before else None
    assert best is not None
    assert (best.window_s, best.score) == (120.0, 0.0)


def test_a_swell_that_stays_is_judged_by_the_long_past() -> None:
    """Whatever the filters' starts have left of a swell of 16 s is not held against a length."""
    t, _, a = sea("S6S", 660.0)
    fit, lengths = None, []
    for end in range(400, 661, 20):
        fit = look(window(t[: end * 20], a[: end * 20], fit, stages=7))
        lengths.append(fit.window_s)
    assert lengths.count(600.0) >= 12
    assert 120.0 not in lengths


@pytest.mark.parametrize("ratio", [1.0, 1.0003, 1.2])
def test_a_filter_that_was_kept_scores_as_one_that_is_solved_for_again(
    ratio: float, s6: tuple[Array, Array, Array]
) -> None:
    """The model in use brings its filter's covariance along: for the same interval it is taken, else solved again."""
    t, _, a = s6
    before = look(window(t[:8000], a[:8000]))
    assert [len(c.steady_covariance) > 0 for c in before.candidates] == [
        c.window_s == before.window_s for c in before.candidates
    ]
    asked = window(ratio * t[:8600], a[:8600], before, looked_s=ratio * before.t_s)
    bare = tuple(msgspec.structs.replace(c, steady_covariance=b"", steady_dt_s=0.0) for c in before.candidates)
    kept, solved = look(asked), look(msgspec.structs.replace(asked, candidates=bare))
    for ours, theirs in zip(kept.candidates, solved.candidates, strict=True):
        assert ours.model == theirs.model
        assert ours.score == pytest.approx(theirs.score, abs=0.05)


def test_candidates_that_outlive_their_past_are_no_reason_to_fail(s6: tuple[Array, Array, Array]) -> None:
    """After a reset there is a new record, and no time of the last look."""
    t, _, a = s6
    before = look(window(t[:4000], a[:4000]))
    fit = look(window(t[4000:5000], a[4000:5000], before, looked_s=nan))
    assert fit.message == ""
    assert fit.model is not None


# --- holes -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("holes", "cuts", "expected"),
    [
        ([], [], [(0.0, 400.0)]),
        ([(200.0, 210.0)], [], [(0.0, 200.0), (210.0, 400.0)]),
        ([(100.0, 105.0), (390.0, 395.0)], [], [(0.0, 100.0), (105.0, 390.0), (395.0, 400.0)]),
        ([], [(149.0, 150.0)], [(0.0, 149.0), (150.0, 400.0)]),
        ([(100.0, 150.0)], [(120.0, 121.0)], [(0.0, 100.0), (150.0, 400.0)]),
    ],
)
def test_a_record_falls_into_its_stretches(
    holes: list[tuple[float, float]], cuts: list[tuple[float, float]], expected: list[tuple[float, float]]
) -> None:
    t = DT_S * np.arange(8000, dtype=np.float64)
    known = np.ones(8000, dtype=np.bool_)
    for first, end in holes:
        known[(t >= first - 1e-9) & (t < end - 1e-9)] = False
    found = unbroken(EvenRecord(t[-1], DT_S, t, known).cut(cuts), 8000)
    assert [(part[0], part[-1] + DT_S) for part in found] == [pytest.approx(part) for part in expected]


@pytest.mark.parametrize("hole_s", [1.0, 10.0, 40.0])
def test_a_hole_leaves_the_spectrum_of_the_sea_as_it_was(hole_s: float, s6: tuple[Array, Array, Array]) -> None:
    """The error that lives in the skirt: heave from the record with a hole is as good as without one."""
    t, heave, a = s6
    kept = (t < 400.0) | (t >= 400.0 + hole_s)
    fit = look(window(t[kept], a[kept]))
    assert fit.model is not None
    assert SeaSystem(fit.model).heave @ np.frombuffer(fit.x) == pytest.approx(heave[-1], abs=0.05 * np.std(heave))
    f = np.linspace(0.02, 0.04, 20)
    whole = look(window(t, a)).model
    assert whole is not None
    assert np.max(fit.model.acceleration_spectrum(f, DT_S) / whole.acceleration_spectrum(f, DT_S)) < 30.0
    assert fit.sea is not None
    assert fit.sea.peak_period_s < 14.0


def test_a_record_in_pieces_is_left_alone_when_there_is_a_model(s6: tuple[Array, Array, Array]) -> None:
    """Holes of seven seconds are too long to be bridged."""
    t, _, a = s6
    before = look(window(t[:4000], a[:4000]))
    kept = (t % 31.0) < 24.0
    assert "holes" in look(window(t[kept], a[kept], before)).message
    assert look(window(t[kept], a[kept])).message == ""


HOLED = {
    "0.4 s every 20 s": lambda t, rng: t % 20.0 >= 0.4,
    "1 s every 20 s": lambda t, rng: t % 20.0 >= 1.0,
    "half of them": lambda t, rng: rng.random(len(t)) > 0.5,
    "three quarters of them": lambda t, rng: rng.random(len(t)) > 0.75,
    "all but every tenth": lambda t, rng: np.arange(len(t)) % 10 == 0,
}


@pytest.mark.parametrize("name", HOLED)
@pytest.mark.parametrize("is_known_before", [False, True])
def test_a_record_with_holes_has_the_sea_of_the_whole_one(
    name: str, is_known_before: bool, s6: tuple[Array, Array, Array]
) -> None:
    """Spectrum where the waves are, and heave at the end, as from the record without holes; sensor A."""
    t, heave, a = s6
    kept = HOLED[name](t, np.random.default_rng(8))
    kept[-1] = True
    whole = look(window(t, a))
    before = look(window(t[: len(t) // 2][kept[: len(t) // 2]], a[: len(t) // 2][kept[: len(t) // 2]]))
    holed = look(window(t[kept], a[kept], before if is_known_before else None))
    assert holed.message == whole.message == ""
    f = np.linspace(0.09, 0.3, 100)
    assert whole.model is not None
    assert holed.model is not None
    ratio = np.log(holed.model.heave_spectrum(f) / whole.model.heave_spectrum(f))
    assert np.sqrt(np.mean(ratio**2)) < (1.4 if name == "three quarters of them" else 0.5)
    system = SeaSystem(holed.model)
    P = np.frombuffer(holed.P or holed.steady_covariance).reshape(len(system.H), -1)
    error_m = float(system.heave @ np.frombuffer(holed.x)) - heave[-1]
    assert abs(error_m) < 4.0 * TUNING.overconfidence * np.sqrt(system.heave @ P @ system.heave)
    assert abs(error_m) < 0.1 * np.std(heave)


# --- no record -------------------------------------------------------------------------------------------------------

T = DT_S * np.arange(3000)
BAD = {
    "short": (T[:300], np.sin(T[:300]), "too short"),
    "empty": (T[:0], T[:0], "too short"),
    "constant": (T, np.full(3000, 0.2), "constant"),
    "nan": (T, np.where(T > 100.0, np.nan, np.sin(T)), "gaps in its numbers"),
    "inf": (T, np.where(T > 100.0, np.inf, np.sin(T)), "gaps in its numbers"),
    "backwards": (T[::-1], np.sin(T), "too short"),
    "two seconds apart": (2.0 * np.arange(300.0), np.sin(np.arange(300.0)), "too far apart"),
    "a time twice": (np.repeat(T[::2], 2), np.sin(T), "gaps in its numbers"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_record_is_a_message(name: str) -> None:
    t, a, word = BAD[name]
    fit = look(window(t, a))
    assert word in fit.message
    assert (fit.number, fit.model) == (3, None)


@pytest.mark.parametrize(
    "a",
    [1e-7 * np.sin(T), 1e4 * np.sin(T), np.where(T > 60.0, 5.0, 0.0) + 1e-3 * np.sin(T), np.sin(1e3 * T), 1e-3 * T],
    ids=["tiny", "huge", "step", "aliased", "ramp"],
)
def test_what_is_no_sea_is_answered_with_numbers_or_a_word(a: Array) -> None:
    fit = look(window(T, a))
    if not fit.message:
        assert fit.model is not None
        assert np.isfinite(heave_std(fit.model))
        assert np.isfinite(np.frombuffer(fit.x)).all()


def test_noise_alone_is_no_likelier_with_waves() -> None:
    noise = 3e-3 * np.random.default_rng(5).standard_normal(12_000)
    fit = look(window(DT_S * np.arange(12_000), noise))
    assert fit.waves < 15.0


def test_whiteness_is_one_of_white_innovations_and_more_of_slow_ones(s6: tuple[Array, Array, Array]) -> None:
    t, _, a = s6
    fit = look(window(t[:3000], a[:3000]))
    assert fit.model is not None
    steady = SeaSystem(fit.model).steady(DT_S)
    assert steady is not None
    white = np.sqrt(steady.S) * np.random.default_rng(6).standard_normal(1200)
    assert whiteness(white, steady) == pytest.approx(1.0, abs=0.8)  # thirty averages
    assert whiteness(white + np.sqrt(steady.S), steady) == pytest.approx(41.0, rel=0.3)  # 40 samples to an average
    assert whiteness(white[:10], steady) == 1.0
    assert even(t, a).dt_s == pytest.approx(DT_S)


def test_candidates_travel() -> None:
    t, _, a = sea("S4", 60.0)
    fit = look(window(t, a))
    packed = msgspec.msgpack.encode(fit)
    assert msgspec.msgpack.encode(msgspec.msgpack.decode(packed, type=SeaFit)) == packed
    assert all(isinstance(candidate, Candidate) for candidate in fit.candidates)
