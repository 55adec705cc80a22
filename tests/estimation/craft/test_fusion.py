"""Attitude fusion: what goes wrong with its input is a table, and every line of it is survived, said and got over."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from math import inf, nan
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import pytest
from evidence.craft import VESSEL, follow, voyage
from numpy.typing import NDArray

from heaved.demo.craft_at_sea import hull
from heaved.estimation.craft.dynamics import FOILLESS, Craft
from heaved.estimation.craft.fusion import AttitudeFusion, Mode, Params
from heaved.estimation.craft.inputs import Caution
from heaved.simulate.hydrofoil import Passage, Voyage, sail

if TYPE_CHECKING:
    from heaved.samples import CraftMotion

Array = NDArray[np.float64]
MODES = tuple(Mode)
Moderate = tuple[Voyage, Array, Array]
"""A voyage, its samples (n, 6) and its truth (n, 4) about the trim."""
MODERATE = Passage(stages=((0.0, 1.0),), duration_s=24.0)
T, HEAVE, PITCH, SPEED, FORE, AFT = range(6)
AT_S, RECOVERED_S = 8.0, 17.0
"""The disaster strikes at AT_S; from RECOVERED_S on there must be no trace of it."""


@pytest.fixture(scope="module")
def moderate() -> tuple[Voyage, Array, Array]:
    """A voyage, its samples (n, 6) and its truth (n, 4) about the trim."""
    made, trim = voyage(3, MODERATE)
    return made, samples(made, trim[0]), made.truth.T - np.array([trim[0], 0.0, 0.0, 0.0])


def samples(made: Voyage, zero_m: float) -> Array:
    readings = (made.measured_heave_m - zero_m, made.measured_pitch_rad)
    return np.stack((made.t_s, *readings, made.speed_mps, made.flap_fore_rad, made.flap_aft_rad), axis=1)


def run(fusion: AttitudeFusion, rows: Array) -> list[CraftMotion | None]:
    return [fusion.step(*row) for row in rows.tolist()]


def state(estimate: CraftMotion) -> tuple[float, float, float, float]:
    return estimate.heave_m, estimate.heave_velocity_mps, estimate.pitch_rad, estimate.pitch_rate_radps


def stds(estimate: CraftMotion) -> tuple[float, float, float, float]:
    e = estimate
    return e.heave_std_m, e.heave_velocity_std_mps, e.pitch_std_rad, e.pitch_rate_std_radps


def during(rows: Array, seconds: float) -> NDArray[np.bool_]:
    return (rows[:, T] >= AT_S) & (rows[:, T] < AT_S + seconds)


def setting(column: int, seconds: float, value: float) -> Callable[[Array], Array]:
    def strike(rows: Array) -> Array:
        rows[during(rows, seconds), column] = value
        return rows

    return strike


def stick(column: int) -> Callable[[Array], Array]:
    def strike(rows: Array) -> Array:
        hit = during(rows, 5.0)
        rows[hit, column] = rows[np.flatnonzero(hit)[0], column]
        return rows

    return strike


def spikes(rows: Array) -> Array:
    hit = np.flatnonzero(during(rows, 5.0))
    rows[hit[::7], HEAVE] += 3.0
    rows[hit[3::9], PITCH] -= 0.3
    return rows


def gap(rows: Array) -> Array:
    return rows[~during(rows, 5.0)]


def back_in_time(rows: Array) -> Array:
    hit = np.flatnonzero(during(rows, 2.0))
    rows[hit[5:15], T] -= 3.0
    return rows


def far_ahead_in_time(rows: Array) -> Array:
    rows[np.flatnonzero(during(rows, 1.0))[0], T] = 1e7
    return rows


def no_time(rows: Array) -> Array:
    rows[np.flatnonzero(during(rows, 1.0))[0], T] = nan
    return rows


def step_in_heave(rows: Array) -> Array:
    """The zero of the sensor jumps, and stays: 0.8 m is 16 standard deviations of its noise."""
    rows[during(rows, 5.0), HEAVE] += 0.8
    return rows


def leap_in_heave(rows: Array) -> Array:
    rows[during(rows, 5.0), HEAVE] += 6.0
    return rows


class Disaster(msgspec.Struct, frozen=True, kw_only=True):
    strike: Callable[[Array], Array]
    said: Caution | None
    """Seen in some estimate from the strike on."""
    resets: tuple[str, ...] = ()
    """Reasons that must have been counted; no other may be."""
    rejected_times: int = 0


DISASTERS = {
    "heave missing": Disaster(strike=setting(HEAVE, 4.0, nan), said=Caution.HEAVE_MISSING),
    "pitch missing": Disaster(strike=setting(PITCH, 4.0, nan), said=Caution.PITCH_MISSING),
    "both infinite": Disaster(
        strike=lambda rows: setting(PITCH, 4.0, -inf)(setting(HEAVE, 4.0, inf)(rows)), said=Caution.HEAVE_MISSING
    ),
    "heave stuck": Disaster(strike=stick(HEAVE), said=Caution.HEAVE_STUCK),
    "pitch stuck": Disaster(strike=stick(PITCH), said=Caution.PITCH_STUCK),
    "spikes": Disaster(strike=spikes, said=Caution.HEAVE_REJECTED),
    "absurd heave": Disaster(strike=setting(HEAVE, 4.0, 1e12), said=Caution.HEAVE_REJECTED),
    "absurd pitch": Disaster(strike=setting(PITCH, 4.0, 3.0), said=Caution.PITCH_REJECTED),
    "5 s gap": Disaster(strike=gap, said=Caution.RESET, resets=("gap",)),
    "back in time": Disaster(strike=back_in_time, said=None, rejected_times=10),
    "far ahead in time": Disaster(
        strike=far_ahead_in_time, said=Caution.RESET, resets=("gap", "time"), rejected_times=50
    ),
    "no time": Disaster(strike=no_time, said=None, rejected_times=1),
    "speed zero": Disaster(strike=setting(SPEED, 4.0, 0.0), said=None),
    "speed missing": Disaster(strike=setting(SPEED, 4.0, nan), said=Caution.SPEED_ASSUMED),
    "speed absurd": Disaster(strike=setting(SPEED, 4.0, 1e6), said=Caution.SPEED_ASSUMED),
    "astern": Disaster(strike=setting(SPEED, 4.0, -8.0), said=None),
    "flap absurd": Disaster(strike=setting(FORE, 4.0, 40.0), said=Caution.FLAP_ASSUMED),
    "flap missing": Disaster(strike=setting(AFT, 4.0, nan), said=Caution.FLAP_ASSUMED),
    "step in heave": Disaster(strike=step_in_heave, said=Caution.HEAVE_REJECTED),
    "leap in heave": Disaster(strike=leap_in_heave, said=Caution.HEAVE_REJECTED, resets=("heave",)),
}


@pytest.mark.parametrize("disaster", DISASTERS.values(), ids=DISASTERS.keys())
def test_disasters_are_survived_said_and_got_over(moderate: Moderate, disaster: Disaster) -> None:
    _, rows, truth = moderate
    fusion = AttitudeFusion()
    struck = disaster.strike(rows.copy())
    estimates = run(fusion, struck)
    given = [estimate for estimate in estimates if estimate is not None]
    assert all(np.isfinite(state(e)).all() and np.isfinite(stds(e)).all() and min(stds(e)) > 0.0 for e in given)
    assert all(sum(e.probabilities) == pytest.approx(1.0) for e in given)
    assert estimates.count(None) == fusion.rejected_times == disaster.rejected_times
    said = {caution for e in given if e.t_s >= AT_S for caution in e.cautions}
    assert disaster.said is None or disaster.said in said
    assert set(fusion.resets) == set(disaster.resets)
    assert given[-1].resets == fusion.resets.total()
    by_time = {e.t_s: e for e in given}
    after = [(by_time[t], truth[k]) for k, t in enumerate(rows[:, T].tolist()) if t >= RECOVERED_S and t in by_time]
    assert len(after) > 70
    error = np.array([state(e) - known for e, known in after])
    published = np.array([stds(e) for e, _ in after])
    # 140 samples of one sea: its own sharpness and luck (see the accuracy tests) take half of that.
    assert np.all(np.sqrt(np.mean(error**2, axis=0)) < 2.0 * np.sqrt(np.mean(published**2, axis=0)))


@pytest.mark.parametrize("mode", MODES)
def test_no_input_breaks_it(mode: Mode) -> None:
    """Garbage of every size in any field at any time: never an exception, but a number with its doubt, or nothing."""
    rng = np.random.default_rng(7)
    garbage = np.array([nan, inf, -inf, 0.0, 1e-300, 0.3, -0.3, 19.0, -19.0, 1e3, -1e9, 1e300])
    fusion, t, given = AttitudeFusion(Params(mode=mode)), 0.0, 0
    for _ in range(600):
        t += float(rng.choice([0.01, 0.05, 1e-9, 1.9, 0.05]))
        values = np.where(rng.random(5) < 0.5, rng.choice(garbage, 5), [0.1, 0.01, 18.0, 0.02, -0.02])
        when = float(rng.choice(garbage)) if rng.random() < 0.02 else t
        estimate = fusion.step(when, *values.tolist())
        if estimate is not None:
            given += 1
            assert np.all(np.abs(state(estimate)) < [60.0, 200.0, 10.0, 30.0])
            assert np.isfinite(stds(estimate)).all()
            assert min(stds(estimate)) > 0.0
            assert sum(estimate.probabilities) == pytest.approx(1.0)
    assert given > 200


def test_an_undisturbed_voyage_is_not_cautioned_about(moderate: Moderate) -> None:
    _, rows, _ = moderate
    fusion = AttitudeFusion()
    given = run(fusion, rows)
    cautions = [caution for e in given if e is not None for caution in e.cautions]
    assert set(cautions) <= {Caution.SETTLING, Caution.HEAVE_REJECTED, Caution.PITCH_REJECTED}
    assert cautions.count(Caution.SETTLING) == round(5.0 * MODERATE.rate_hz)
    assert not fusion.resets
    # A gate of 2.5 sigma lets 1.2 % of a Gaussian out; the sea's own sharpness adds to that.
    assert sum(fusion.gated) < 0.03 * 2 * len(rows)


def test_while_nothing_is_measured_the_doubt_grows_to_that_of_the_sea_and_no_further(moderate: Moderate) -> None:
    _, rows, truth = moderate
    fusion = AttitudeFusion()
    blind = rows.copy()
    blind[during(rows, 20.0), HEAVE] = blind[during(rows, 20.0), PITCH] = nan
    given = [e for e in run(fusion, blind) if e is not None and e.t_s >= AT_S - 1]
    heave_std = np.array([e.heave_std_m for e in given])
    assert heave_std[0] < 0.05
    assert 2.0 * np.std(truth[:, 0]) < heave_std[-1] < 10.0 * np.std(truth[:, 0])
    assert abs(heave_std[-1] - heave_std[-60]) < 0.05 * heave_std[-1]
    assert abs(given[-1].heave_m) < 0.2 * heave_std[-1]


def test_a_lost_factorisation_is_a_counted_reset(moderate: Moderate) -> None:
    _, rows, _ = moderate
    for mode in MODES:
        fusion = AttitudeFusion(Params(mode=mode))
        run(fusion, rows[:100])
        lost = fusion.filters
        assert lost is not None
        lost.P[-1, 3, 3] = -1.0
        estimate = fusion.step(*rows[100].tolist())
        assert estimate is not None
        assert Caution.RESET in estimate.cautions
        assert fusion.resets == {"covariance": 1}
        assert estimate.heave_m == pytest.approx(rows[100, HEAVE])
        assert all(e is not None for e in run(fusion, rows[101:200]))
        assert fusion.resets == {"covariance": 1}


def test_without_a_first_reading_there_is_no_estimate(moderate: Moderate) -> None:
    _, rows, _ = moderate
    fusion = AttitudeFusion()
    assert fusion.step(0.0, nan, nan, 18.0, 0.0, 0.0) is None
    with pytest.raises(ValueError, match="nothing"):
        fusion.moments()
    first = fusion.step(0.1, nan, 0.02, 18.0, 0.0, 0.0)
    assert first is not None
    assert Caution.HEAVE_MISSING in first.cautions
    assert (first.pitch_rad, first.heave_m) == pytest.approx((0.02, 0.0))
    assert first.heave_std_m > 10 * first.pitch_std_rad
    for row in rows[5:40].tolist():
        last = fusion.step(*row)
    assert last is not None
    assert last.heave_std_m < 0.05


def test_the_interval_may_be_anything() -> None:
    """Samples thinned and shifted at random, 10 to 200 ms apart: as near to the truth as the published doubt says."""
    made, trim = voyage(4, msgspec.structs.replace(MODERATE, rate_hz=100.0, duration_s=30.0))
    rng = np.random.default_rng(5)
    kept = np.cumsum(rng.integers(1, 20, 700))
    kept = kept[kept < len(made.t_s)]
    rows, truth = samples(made, trim[0])[kept], (made.truth.T - np.array([trim[0], 0.0, 0.0, 0.0]))[kept]
    for mode in MODES:
        given = run(AttitudeFusion(Params(mode=mode)), rows)
        late = [(e, known) for e, known in zip(given, truth, strict=True) if e is not None and e.t_s > 5.0]
        squares = np.mean([((state(e) - known) / stds(e)) ** 2 for e, known in late], axis=0)
        assert np.all(squares > 0.3)
        assert np.all(squares < 3.0)


def test_the_same_samples_give_the_same_estimates(moderate: Moderate) -> None:
    _, rows, _ = moderate
    first, second = (run(AttitudeFusion(), rows[:200]) for _ in range(2))
    assert first == second


def test_equal_seas_are_one_filter(moderate: Moderate) -> None:
    """Three copies of one sea: whatever the mode, nothing can be gained or lost, and each sea stays as likely."""
    _, rows, _ = moderate
    rough = Params().seas[-1]
    alone = run(AttitudeFusion(Params(seas=(rough,))), rows[:200])
    for mode in (Mode.EWMA, Mode.IMM):
        among = run(AttitudeFusion(Params(mode=mode, seas=(rough,) * 3)), rows[:200])
        for one, other in zip(alone, among, strict=True):
            assert one is not None
            assert other is not None
            last = other
            assert state(other) == pytest.approx(state(one), rel=1e-9, abs=1e-12)
            assert stds(other) == pytest.approx(stds(one), rel=1e-9)
    assert last.probabilities == pytest.approx((1 / 3,) * 3)


def test_instant_takes_per_channel_the_filter_with_the_smaller_innovation(moderate: Moderate) -> None:
    """The patent's rule, replayed from outside: the prediction of each filter against the reading, squared."""
    _, rows, _ = moderate
    params = Params(mode=Mode.INSTANT, gate_sigma=20.0)
    fusion = AttitudeFusion(params)
    seen = set()
    for row in rows[:150].tolist():
        # The same steps with nothing measured leave the filters at their prediction.
        shadow = deepcopy(fusion)
        estimate = fusion.step(*row)
        if shadow.filters is not None:
            shadow.step(row[T], nan, nan, *row[SPEED:])
            expected = shadow.filters
            by_heave = int(np.argmin((row[HEAVE] - expected.x[:, 0]) ** 2))
            by_pitch = int(np.argmin((row[PITCH] - expected.x[:, 2]) ** 2))
            assert estimate is not None
            assert fusion.serving == (by_heave, by_pitch)
            after = fusion.filters
            assert after is not None
            chosen = (*after.x[by_heave, :2].tolist(), *after.x[by_pitch, 2:4].tolist())
            assert state(estimate) == chosen
            seen.add((by_heave, by_pitch))
    assert len(seen) == 4


def test_the_probable_sea_is_the_one_that_is() -> None:
    for height, likely in ((0.3, 0), (2.5, 2)):
        made, trim = voyage(6, Passage(stages=((0.0, height),), duration_s=30.0))
        trace = follow(made, trim, AttitudeFusion())
        late = np.mean([e.probabilities for e in trace.estimates[200:]], axis=0)
        assert int(np.argmax(late)) == likely
        assert late[likely] > 0.6


def test_a_vessel_without_foils() -> None:
    """Hulls alone, stopped, no speed and no flaps known: nothing is assumed, nothing is missed."""
    craft = Craft(FOILLESS)
    passage = Passage(stages=((0.0, 1.0),), duration_s=40.0, speed_mps=0.0)
    made = sail(craft.accelerations, (0.0, 0.0), (1,), passage, hull(FOILLESS))[0]
    fusion = AttitudeFusion(Params(vessel=FOILLESS))
    late = []
    for k, (t, heave, pitch) in enumerate(
        zip(made.t_s.tolist(), made.measured_heave_m.tolist(), made.measured_pitch_rad.tolist(), strict=True)
    ):
        estimate = fusion.step(t, heave, pitch)
        assert estimate is not None
        assert not {Caution.SPEED_ASSUMED, Caution.FLAP_ASSUMED} & set(estimate.cautions)
        if t > 10.0:
            late.append((state(estimate) - made.truth[:, k]) / stds(estimate))
    squares = np.mean(np.square(late), axis=0)
    assert np.all(squares > 0.1)
    assert np.all(squares < 2.0)


@pytest.mark.parametrize(
    "bad",
    [
        {"mode": "best"},
        {"seas": []},
        {"seas": [{"heave_rms_mps2": 0.0, "pitch_rms_radps2": 0.1}]},
        {"gate_sigma": 0.0},
        {"heave_noise_m": 0.0},
        {"mean_stay_s": 0.0},
        {"wave": {"heave_peak_radps": 0.1}},
        {"vessel": {"mass_kg": 0.0}},
        {"vessel": {"mass_t": 90.0}},
        {"vessel": {"fore_foil": {"area_m2": 5.0}}},
        {"unknown": 1},
    ],
)
def test_impossible_settings_are_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(bad, Params)


def test_settings_of_a_file_are_taken() -> None:
    given = {"mode": "ewma", "vessel": {"fore_foil": {"arm_m": 7.0}, "mass_kg": 8e4}}
    params = msgspec.convert(given, Params)
    assert params.vessel.fore_foil.arm_m == 7.0
    assert params.vessel.aft_foil == VESSEL.aft_foil
