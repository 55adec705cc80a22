"""The correction by roll and pitch as it runs: weights on the past, holes, and when it may be used at all."""

from __future__ import annotations

from math import inf, isfinite, nan, radians

import numpy as np
import pytest

from heaved.estimation.heave.sea.joint import TUNING, Experience, JointCorrection
from heaved.estimation.heave.sea.joint_design import Joint
from heaved.samples import DelayedHeave

Array = np.ndarray
DT_S = 0.125
FINE, COARSE, GROUP = 6, 4, 3
NODES_S = (0.0, 1.0, 4.0)
OFFSETS = (0.02, -0.01)
SIZE = 2000
"""Of what an experience keeps."""


def design(
    fine: Array | None = None, coarse: Array | None = None, std_m: float = 1e3, heading_rad: float = nan
) -> Joint:
    rng = np.random.default_rng(3)
    fine = rng.normal(size=(2 * len(NODES_S), FINE, 3)).astype(np.float16) if fine is None else fine
    coarse = rng.normal(size=(2 * len(NODES_S), COARSE, 3)).astype(np.float16) if coarse is None else coarse
    return Joint(
        nodes_s=NODES_S,
        ratios=(0.6, 0.7, 0.9),
        stds_m=(std_m,) * len(NODES_S),
        coherence=0.9,
        dt_s=DT_S,
        group=GROUP,
        offsets_rad=OFFSETS,
        heading_rad=heading_rad,
        fine=fine.astype(np.float16).tobytes(),
        coarse=coarse.astype(np.float16).tobytes(),
    )


def rows(count: int) -> Array:
    return np.random.default_rng(4).normal(size=(count, 3))


def test_what_is_added_is_the_weighted_sum_of_the_past() -> None:
    made = design()
    joint, past = JointCorrection(made), rows(40)
    for i, row in enumerate(past.tolist()):
        joint.push(i * DT_S, *row)
    fine = np.frombuffer(made.fine, np.float16).astype(float).reshape(-1, FINE, 3)
    coarse = np.frombuffer(made.coarse, np.float16).astype(float).reshape(-1, COARSE, 3)
    clear = past - np.array([0.0, *OFFSETS])
    whole = np.concatenate((np.repeat(coarse / GROUP, GROUP, axis=1), fine), axis=1)
    expected = np.einsum("rkc,kc->r", whole, clear[-whole.shape[1] :])
    assert np.ravel(joint.nodes()) == pytest.approx(expected)


def test_a_past_that_is_filled_in_is_one_that_was_fed() -> None:
    filled, fed, past = JointCorrection(design()), JointCorrection(design()), rows(30)
    filled.fill(29 * DT_S, past)
    for i, row in enumerate(past.tolist()):
        fed.push(i * DT_S, *row)
    assert filled.nodes() == fed.nodes()


def test_between_its_nodes_it_is_the_cubic_with_their_slopes() -> None:
    joint = JointCorrection(design())
    joint.fill(0.0, rows(30))
    nodes = joint.nodes()
    for tau_s, told in zip(NODES_S, nodes, strict=True):
        assert joint.at(tau_s) == pytest.approx(told)
    for tau_s in (0.3, 0.9, 1.7, 3.9):
        (before_m, _), (after_m, _) = joint.at(tau_s - 1e-5), joint.at(tau_s + 1e-5)
        assert joint.at(tau_s)[1] == pytest.approx((after_m - before_m) / 2e-5, rel=1e-4)
    (h0, v0), (h1, v1) = nodes[1:]
    assert joint.at(2.5)[0] == pytest.approx((h0 + h1) / 2.0 + 3.0 * (v0 - v1) / 8.0)
    assert joint.at(-0.2)[0] == pytest.approx(nodes[0][0] - 0.2 * nodes[0][1])
    assert joint.at(-60.0) == joint.at(-TUNING.reaches_s)
    assert joint.at(60.0) == joint.at(NODES_S[-1] + TUNING.reaches_s)


def test_more_than_waves_explain_is_not_added() -> None:
    free, held = JointCorrection(design()), JointCorrection(design(std_m=0.25))
    largest_m = 0.25 * TUNING.most_stds
    for i, row in enumerate(rows(200).tolist()):
        for joint in (free, held):
            joint.push(i * DT_S, *row)
        wanted, told = np.array(free.nodes()), np.array(held.nodes())
        assert held.is_too_much == (abs(wanted[0, 0]) > largest_m)
        assert told == pytest.approx(wanted * np.minimum(1.0, largest_m / np.abs(wanted[:, :1])))
    assert not free.is_too_much
    held.push(200 * DT_S, 1e308, 1e308, 1e308)
    assert np.all(np.isfinite(held.nodes()))
    assert held.is_too_much


def test_what_waves_hardly_explain_is_in_part_not_known() -> None:
    free, held = JointCorrection(design()), JointCorrection(design(std_m=0.25))
    surely_m = 0.25 * TUNING.doubted_stds
    for i, row in enumerate(rows(200).tolist()):
        for joint in (free, held):
            joint.push(i * DT_S, *row)
        for node_s, (wanted_m, _) in zip(NODES_S, free.nodes(), strict=True):
            sure_m = (1.0 - held.doubted(node_s + 0.1)) * abs(wanted_m)
            assert sure_m == pytest.approx(min(abs(wanted_m), surely_m))
            assert free.doubted(node_s) == 0.0


@pytest.mark.parametrize(
    ("then_deg", "now_deg", "is_the_same"),
    [(10.0, 25.0, True), (350.0, 8.0, True), (-5.0, 361.0, True), (350.0, 15.0, False), (0.0, 180.0, False),
     (nan, 90.0, True), (90.0, nan, True)],
)  # fmt: skip
def test_the_weights_are_those_of_one_heading(then_deg: float, now_deg: float, is_the_same: bool) -> None:
    assert JointCorrection(design(heading_rad=radians(then_deg))).heads(radians(now_deg)) == is_the_same


def test_the_standard_deviation_shrinks_by_no_more_than_was_seen() -> None:
    joint = JointCorrection(design())
    assert joint.ratio(0.0, 0.5) == pytest.approx(0.6)
    assert joint.ratio(0.0, 0.75) == pytest.approx(0.75)
    assert joint.ratio(0.5, 0.5) == pytest.approx(0.65)
    assert joint.ratio(2.5, 0.6) == pytest.approx(0.8)
    assert joint.ratio(9.0, 0.9) == 1.0


def test_a_hole_in_the_angles_silences_it_for_a_while() -> None:
    joint = JointCorrection(design())
    t_s = 0.0
    for i in range(3000):
        t_s = i * DT_S
        is_missing = 1000 <= i < 1005 or 2000 <= i < 2050
        joint.push(t_s, 0.1, nan if is_missing else 0.01, 0.02)
        assert isfinite(joint.nodes()[0][0])
        expected = not 2000 + TUNING.bridged_s / DT_S <= i < 2050 + TUNING.hole_s / DT_S
        assert joint.is_known(t_s) == expected, i


def at_sea(t_s: float) -> tuple[float, float]:
    return 0.05 * np.sin(0.9 * t_s), 0.03 * np.sin(1.1 * t_s + 1.0)


@pytest.mark.parametrize(("missing", "within"), [(3, 2e-3), (8, 6e-3), (16, 0.03)])
def test_a_short_hole_in_the_angles_is_drawn_over(missing: int, within: float) -> None:
    rng = np.random.default_rng(8)
    fine = rng.normal(size=(2 * len(NODES_S), 40, 3)).astype(np.float16)
    whole, holed = JointCorrection(design(fine=fine)), JointCorrection(design(fine=fine))
    size, worst = 0.0, 0.0
    for i in range(200):
        angles = at_sea(i * DT_S)
        whole.push(i * DT_S, 0.0, *angles)
        holed.push(i * DT_S, 0.0, *((nan, nan) if 100 <= i < 100 + missing else angles))
        size = max(size, float(np.max(np.abs(whole.nodes()))))
        if i >= 100 + missing + TUNING.sides:
            worst = max(worst, float(np.max(np.abs(np.array(whole.nodes()) - np.array(holed.nodes())))))
    assert 0.0 < worst < within * size


def test_within_a_hole_the_angles_go_on_as_they_went() -> None:
    steady, holed = JointCorrection(design()), JointCorrection(design())
    for i in range(60):
        for joint, is_missing in ((steady, False), (holed, i >= 57)):
            joint.push(i * DT_S, 0.2, *((nan, nan) if is_missing else (0.001 * i, -0.002 * i)))
    assert np.ravel(holed.nodes()) == pytest.approx(np.ravel(steady.nodes()))


def test_innovations_may_become_others() -> None:
    amended, fed, past, now = JointCorrection(design()), JointCorrection(design()), rows(50), rows(50)
    now[:, 1:] = past[:, 1:]
    now[: -amended.amended, 0] = past[: -amended.amended, 0]
    amended.fill(0.0, past)
    fed.fill(0.0, now)
    amended.amend(now[-amended.amended :, 0])
    assert np.ravel(amended.nodes()) == pytest.approx(np.ravel(fed.nodes()))
    for i, row in enumerate(rows(20).tolist(), 1):
        for joint in (amended, fed):
            joint.push(i * DT_S, *row)
        assert np.ravel(amended.nodes()) == pytest.approx(np.ravel(fed.nodes()))


def lived(more: float, error_m: float, seconds: float, experience: Experience, from_s: float = 0.0) -> Experience:
    """Heave alone is off by ``error_m`` times a noise, of which the correction takes the share ``more`` away."""
    noise = np.random.default_rng(5).normal(size=round(seconds / DT_S)) * error_m
    for i, e in enumerate(noise.tolist()):
        t_s = from_s + i * DT_S
        experience.say(t_s, 1.0 - e, more * e)
        experience.check(DelayedHeave(t_s=t_s, heave_m=1.0, std_m=0.01), DT_S)
        experience.step(DT_S, may_be_used=True)
    return experience


@pytest.mark.parametrize(
    ("more", "weight"),
    [(0.5, 1.0), (1.0, 1.0), (2.0, 0.5), (0.03, 0.0), (-0.2, 0.0)],
    ids=["half", "all", "twice too much", "hardly anything", "the wrong way"],
)
def test_as_much_of_it_is_used_as_would_have_been_best(more: float, weight: float) -> None:
    experience = lived(more, 0.05, 300.0, Experience(SIZE))
    assert experience.weight == pytest.approx(weight)
    if weight:
        assert experience.shown == pytest.approx(abs(1.0 - weight * more), abs=1e-6)


def test_it_is_not_used_before_it_has_shown_anything() -> None:
    assert lived(0.9, 0.05, TUNING.told_s - 1.0, Experience(SIZE)).weight == 0.0


def test_it_goes_at_once_where_it_is_much_worse_and_comes_back() -> None:
    experience = lived(0.5, 0.05, 200.0, Experience(SIZE))
    experience = lived(-2.0, 0.05, TUNING.quick_s + TUNING.fades_s, experience, 200.0)
    assert experience.weight == 0.0
    assert lived(0.5, 0.05, 400.0, experience, 300.0).weight == 1.0


def test_it_fades_in_and_out() -> None:
    experience = lived(0.5, 0.05, 200.0, Experience(SIZE))
    weights = [experience.step(DT_S, may_be_used=False) for _ in range(round(TUNING.fades_s / DT_S) + 1)]
    assert np.diff([1.0, *weights]).min() >= -DT_S / TUNING.fades_s - 1e-12
    assert weights[-1] == 0.0
    assert experience.shown == inf


def test_what_has_no_counterpart_is_not_compared() -> None:
    experience = Experience(SIZE)
    for i in range(2000):
        experience.say(i * DT_S, 1.0, 0.1)
        experience.check(DelayedHeave(t_s=i * DT_S + 5.0, heave_m=1.0, std_m=0.01), DT_S)
    assert experience.step(DT_S, may_be_used=True) == 0.0
    assert experience.shown == inf
