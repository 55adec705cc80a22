"""Configurations beside each other: errors of many recordings as one, over those that all of them got through. Pure."""

from __future__ import annotations

from math import sqrt
from statistics import median
from typing import TYPE_CHECKING

import msgspec

from heaved.backtest.task import Accuracy, Ahead, Result
from heaved.samples import HeaveState

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """A recording with a configuration, and what came of it."""

    source: str
    """Relative to the directory."""
    configuration: str
    configuration_sha256: str
    release: str
    result: Result


class Compared(msgspec.Struct, frozen=True, kw_only=True):
    """One configuration over all recordings that every configuration got through."""

    configuration: str
    configuration_sha256: str
    recordings: int
    duration_s: float
    realtime: Accuracy
    """m"""
    expected_nees: float | None
    laser: Accuracy
    forecasts: tuple[Ahead, ...]
    roll: tuple[Ahead, ...]
    """degrees"""
    pitch: tuple[Ahead, ...]
    shares: dict[str, float]
    first_valid_s: float | None
    """Median of those that became so."""
    never_valid: int
    """Recordings that did not."""
    resets: int
    run_s: float
    """Of all its tasks together."""
    better: int
    """Recordings in which the real-time heave was nearer to the delayed one than with the first configuration,"""
    worse: int
    """and further from it."""


def common(rows: Sequence[Row]) -> list[str]:
    """The recordings that every configuration got through, in order."""
    failed = {row.source for row in rows if row.result.failure}
    return sorted({row.source for row in rows} - failed)


def compared(rows: Sequence[Row]) -> list[Compared]:
    """Each configuration, in the order of its first row."""
    sources = common(rows)
    results: dict[str, dict[str, Row]] = {}
    for row in rows:
        results.setdefault(row.configuration, {})[row.source] = row
    first: list[Result] = []
    found = []
    for name, by_source in results.items():
        mine = [by_source[source].result for source in sources]
        first = first or mine
        sha256 = next(iter(by_source.values())).configuration_sha256
        found.append(_compared(name, sha256, mine, first))
    return found


def _compared(name: str, sha256: str, mine: Sequence[Result], first: Sequence[Result]) -> Compared:
    valid = [one.first_valid_s for one in mine if one.first_valid_s is not None]
    pairs = [(_rms(one), _rms(other)) for one, other in zip(mine, first, strict=True)]
    told = [(a, b) for a, b in pairs if a is not None and b is not None]
    return Compared(
        configuration=name,
        configuration_sha256=sha256,
        recordings=len(mine),
        duration_s=sum(one.duration_s for one in mine),
        realtime=together(one.realtime for one in mine),
        expected_nees=_mean((one.realtime.count, one.expected_nees) for one in mine if one.realtime is not None),
        laser=together(one.laser for one in mine),
        forecasts=_ahead(mine, lambda one: one.forecasts),
        roll=_ahead(mine, lambda one: one.roll),
        pitch=_ahead(mine, lambda one: one.pitch),
        shares={
            state.value: _mean((one.duration_s, one.shares.get(state.value, 0.0)) for one in mine) or 0.0
            for state in HeaveState
        },
        first_valid_s=median(valid) if valid else None,
        never_valid=len(mine) - len(valid),
        resets=sum(one.resets for one in mine),
        run_s=sum(one.run_s for one in mine),
        better=sum(a < b for a, b in told),
        worse=sum(a > b for a, b in told),
    )


def _rms(result: Result) -> float | None:
    return None if result.realtime is None else result.realtime.rms


def _ahead(results: Sequence[Result], of: Callable[[Result], tuple[Ahead, ...]]) -> tuple[Ahead, ...]:
    """By horizon, in order; configurations within the recordings may have others."""
    by_horizon: dict[float, list[Accuracy]] = {}
    for result in results:
        for one in of(result):
            by_horizon.setdefault(one.horizon_s, []).append(one.errors)
    return tuple(
        Ahead(horizon_s=horizon_s, errors=together(errors)) for horizon_s, errors in sorted(by_horizon.items())
    )


def together(parts: Iterable[Accuracy | None]) -> Accuracy:
    """Errors of several recordings as one: each error has the same weight."""
    known = [one for one in parts if one is not None and one.count > 0]
    return Accuracy(
        count=sum(one.count for one in known),
        rms=_root_mean_square((one.count, one.rms) for one in known),
        claimed_rms=_root_mean_square((one.count, one.claimed_rms) for one in known),
        nees=_mean((one.count, one.nees) for one in known),
        within_1std=_mean((one.count, one.within_1std) for one in known),
        within_2std=_mean((one.count, one.within_2std) for one in known),
        within_3std=_mean((one.count, one.within_3std) for one in known),
    )


def _root_mean_square(parts: Iterable[tuple[float, float | None]]) -> float | None:
    square = _mean((weight, None if value is None else value * value) for weight, value in parts)
    return None if square is None else sqrt(square)


def _mean(parts: Iterable[tuple[float, float | None]]) -> float | None:
    known = [(weight, value) for weight, value in parts if value is not None]
    total = sum(weight for weight, _ in known)
    return sum(weight * value for weight, value in known) / total if total > 0 else None
