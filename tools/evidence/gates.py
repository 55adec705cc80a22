"""Regression gates: short deterministic runs whose errors may not grow beyond what they were when the gates were set.

The gates are data, in gates.json beside this file, written by ``tools/accuracy.py gates --set`` from the lines that the
same command has just added to results.jsonl. They say nothing about how good the product is; ``asked.py`` does.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import isfinite
from pathlib import Path
from typing import Final

import msgspec

from evidence.heave import Task
from evidence.scenarios import HORIZONS_S, Setting, triplet
from evidence.summary import Result

FILE: Final = Path(__file__).with_name("gates.json")
MARGIN: Final = 1.05
"""Gate over measured: for another processor and another BLAS."""
SHORT: Final = Setting(tilt="none", rate_hz=10.0, duration_s=240.0, scored_from_s=120.0)
FIGURES: Final = ("rms_m", *(f"forecast {horizon:g} s" for horizon in HORIZONS_S), "delayed", "outside ±1.96 std")
CASES: Final[tuple[tuple[str, Setting], ...]] = (
    ("S4", SHORT),
    ("S6", msgspec.structs.replace(SHORT, tilt="noisy")),
    ("T1", msgspec.structs.replace(SHORT, tilt="noisy")),
    ("T3", msgspec.structs.replace(SHORT, tilt="noisy", sensor="B", laser="50%")),
)


class Gate(msgspec.Struct, frozen=True, kw_only=True):
    """One error of one estimator on one case."""

    scenario: str
    setting: Setting
    estimator: str
    figure: str
    """One of :data:`FIGURES`."""
    measured: float
    most: float


class Gates(msgspec.Struct, frozen=True, kw_only=True):
    """The file."""

    commit: str
    observers: tuple[str, ...]
    """That were run."""
    gates: tuple[Gate, ...]


def tasks(observers: tuple[str, ...]) -> list[Task]:
    return [Task(scenario=name, seeds=triplet(1), setting=setting, estimators=observers) for name, setting in CASES]


def figures(result: Result) -> dict[str, float]:
    """What can be held by a gate: the errors that there are, by name."""
    ahead = {f"forecast {horizon} s": later.rms_m for horizon, later in result.forecast.items()}
    delayed = {"delayed": result.delayed.rms_m} if result.delayed is not None else {}
    outside = {"outside ±1.96 std": 1.0 - result.coverage}
    return {name: v for name, v in ({"rms_m": result.rms_m} | ahead | delayed | outside).items() if isfinite(v)}


def made_of(results: Iterable[Result], commit: str, observers: tuple[str, ...]) -> Gates:
    """Gates a hair above what was measured. Shares get two points of room instead: a few samples decide them."""
    gates = [
        Gate(
            scenario=result.scenario,
            setting=result.setting,
            estimator=result.estimator,
            figure=name,
            measured=value,
            most=value + 0.02 if name.startswith("outside") else value * MARGIN,
        )
        for result in results
        for name, value in figures(result).items()
    ]
    return Gates(commit=commit, observers=observers, gates=tuple(gates))


def broken(gates: Sequence[Gate], results: Iterable[Result]) -> list[str]:
    """One line for each gate that does not hold, or whose figure is not there any more."""
    there = {
        (result.scenario, result.setting, result.estimator, name): value
        for result in results
        for name, value in figures(result).items()
    }
    messages = []
    for gate in gates:
        value = there.get((gate.scenario, gate.setting, gate.estimator, gate.figure))
        name = f"{gate.scenario}, sensor {gate.setting.sensor}, {gate.estimator}: {gate.figure}"
        if value is None:
            messages.append(f"{name} is not there any more")
        elif not value <= gate.most:
            messages.append(f"{name} is {value:.4g}, the gate {gate.most:.4g} (it was {gate.measured:.4g})")
    return messages


def load(path: Path = FILE) -> Gates:
    """
    Raises:
        ValueError: the file is not one of gates.
        OSError: it cannot be read.
    """
    return msgspec.json.decode(path.read_bytes(), type=Gates)


def save(gates: Gates, path: Path = FILE) -> None:
    path.write_bytes(msgspec.json.format(msgspec.json.encode(gates), indent=1) + b"\n")
