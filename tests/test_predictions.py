"""Predictions as columns are the records that they stand for."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan, nan, nextafter, pi

import numpy as np
import pytest

from heaved.block_outlook import BlockMaps, BlockOutlook, worked_out
from heaved.predictions import TURN, RockPredictions, turned
from heaved.samples import HeaveForecast, RockPrediction

HORIZONS_S = (0.05, 0.5, 2.0)
FORECASTS = tuple(HeaveForecast(horizon_s=h, heave_m=h + 1.0, std_m=0.1 * h) for h in HORIZONS_S)


def rocks(yaw_rad: float = 1.0) -> tuple[RockPrediction, ...]:
    return tuple(
        RockPrediction(
            horizon_s=h,
            roll_rad=0.1 * h,
            pitch_rad=-0.2 * h,
            yaw_rad=yaw_rad,
            roll_std_rad=0.01 * h,
            pitch_std_rad=0.02 * h,
            yaw_std_rad=0.03 * h,
            roll_interval_rad=0.04 * h,
            pitch_interval_rad=0.05 * h,
            yaw_interval_rad=0.06 * h,
        )
        for h in HORIZONS_S
    )


def test_columns_are_the_sequence_of_their_records() -> None:
    records = rocks()
    columns = RockPredictions.of(records, HORIZONS_S)
    assert isinstance(columns, Sequence)
    assert len(columns) == len(records) == 3
    assert list(columns) == list(records)
    assert [columns[0], columns[1], columns[-1]] == [records[0], records[1], records[2]]
    assert tuple(columns[1:]) == records[1:]
    assert list(reversed(columns)) == list(reversed(records))
    assert records[1] in columns
    assert columns.index(records[2]) == 2
    assert columns == records
    assert records == columns
    assert columns != records[:2]
    assert columns != 3
    assert hash(columns) == hash(records)
    assert repr(columns) == repr(records)
    with pytest.raises(IndexError):
        columns[3]


def test_columns_of_these_horizons_stay_what_they_are() -> None:
    rock = RockPredictions.of(rocks(), HORIZONS_S)
    assert RockPredictions.of(rock, HORIZONS_S) is rock


def test_other_horizons_are_picked_and_what_is_not_there_is_not_known() -> None:
    asked = (2.0, 1.0, 0.05)
    rock = RockPredictions.of(rocks(), asked)
    assert (rock[0], rock[2]) == (rocks()[2], rocks()[0])
    for found, h in ((rock[1], 1.0), (RockPredictions.unknown(HORIZONS_S)[1], 0.5)):
        assert found.horizon_s == h
        assert all(isnan(getattr(found, name)) for name in RockPrediction.__struct_fields__ if name != "horizon_s")


@pytest.mark.parametrize("turns", [-2, 0, 3])
def test_yaw_is_a_heading_whatever_it_is_counted_from(turns: int) -> None:
    yaws = np.array([0.0, 0.25, 6.25]) + TURN * turns
    angles = np.column_stack((np.zeros(3), np.zeros(3), yaws - 1.5))
    rock = RockPredictions(HORIZONS_S, angles, 1.5, np.zeros((3, 3)), np.zeros((3, 3)))
    off = [prediction.yaw_rad - expected for prediction, expected in zip(rock, (0.0, 0.25, 6.25), strict=True)]
    assert all(abs((d + pi) % TURN - pi) < 1e-12 for d in off)
    assert all(0.0 <= prediction.yaw_rad < TURN for prediction in rock)


def test_a_hair_below_north_is_north_and_never_a_whole_turn() -> None:
    hair = -nextafter(0.0, 1.0)
    assert hair % TURN == TURN  # what the remainder rounds to
    assert turned(hair) == 0.0
    assert turned(np.array([hair, -1.0, nan])).tolist()[:2] == [0.0, TURN - 1.0]


# -- worked out when asked for -----------------------------------------------------------------------------------------

PLACES, NODES, AXES = 4, 5, 3


def block_maps(rng: np.random.Generator) -> BlockMaps:
    """Any that depend on no later innovation than the block has had."""
    weights = rng.standard_normal((AXES, PLACES, len(HORIZONS_S), NODES + PLACES - 1))
    for place in range(PLACES):
        weights[:, place, :, NODES + place :] = 0.0
    return BlockMaps(
        weights=weights,
        slopes=rng.standard_normal((PLACES, len(HORIZONS_S), NODES)),
        gates=rng.uniform(0.5, 2.0, (PLACES - 1, AXES)),
    )


def by_hand(outlook: BlockOutlook, place: int, off: float) -> list[list[float]]:
    """The sums written out."""
    maps, found = outlook.maps, []
    for h in range(len(HORIZONS_S)):
        row = []
        for axis in range(AXES):
            total = 0.0
            for node in range(NODES):
                weight = maps.weights[axis, place, h, node] + off * maps.slopes[place, h, node]
                total += weight * outlook.curve[node, axis]
            for k in range(place):
                e = outlook.innovations[k * AXES + axis]
                if abs(e) <= maps.gates[k, axis]:
                    total += maps.weights[axis, place, h, NODES + k] * e
            row.append(total)
        found.append(row)
    return found


def test_predictions_worked_out_alone_or_together_are_the_sums() -> None:
    """Over blocks with one maps or another, with spikes and samples that are not there, on time and late."""
    rng = np.random.default_rng(1)
    moments: list[tuple[BlockOutlook, int, float]] = []
    for maps in (block_maps(rng), block_maps(rng)):
        for block in range(3):
            innovations = rng.standard_normal((PLACES - 1) * AXES)
            innovations[rng.random(len(innovations)) < 0.2] = nan
            outlook = BlockOutlook(rng.standard_normal((NODES, AXES)), innovations.tolist(), maps)
            moments += [(outlook, place, 0.3 * rng.standard_normal() * (block == 1)) for place in range(PLACES)]
    expected = np.array([by_hand(*moment) for moment in moments])
    alone = np.array([outlook.at(place, off) for outlook, place, off in moments])
    known = rng.standard_normal((len(HORIZONS_S), AXES))
    together = worked_out([known, *moments, known, known])
    np.testing.assert_allclose(alone, expected, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(together[1:-2], expected, rtol=0.0, atol=1e-12)
    assert all(np.array_equal(together[i], known) for i in (0, -2, -1))
    nothing = np.zeros((len(HORIZONS_S), AXES))
    rock = [RockPredictions(HORIZONS_S, moment, 1.5, nothing, nothing) for moment in moments]
    np.testing.assert_allclose(RockPredictions.angles_of(rock), expected, rtol=0.0, atol=1e-12)
    assert [[p.roll_rad, p.pitch_rad] for p in rock[5]] == pytest.approx(expected[5, :, :2], abs=1e-12)
    np.testing.assert_allclose(RockPredictions.angles_of(rock), expected, rtol=0.0, atol=1e-12)  # one is known
