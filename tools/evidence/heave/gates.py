"""Regression gates: short deterministic runs whose errors may not grow beyond what they were when the gates were set.

The gates are data, in gates.json beside this file, written by ``tools/accuracy.py gates --set`` from the lines that the
same command has just added to results.jsonl. They say nothing about how good the product is; ``asked.py`` does.
"""

from __future__ import annotations

from math import isfinite, nan
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

from evidence.heave.evaluate import Task
from evidence.scenarios import Setting, triplet

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from evidence.heave.summary import Result

FILE: Final = Path(__file__).with_name("gates.json")
MARGIN: Final = 1.05
"""Gate over measured: for another processor and another BLAS."""
SHORT: Final = Setting(tilt="none", rate_hz=10.0, duration_s=240.0, scored_from_s=120.0)
OUTSIDE: Final = "outside 1.96 std"
OUTSIDE_ROOM: Final = 0.02
"""Added to that share instead: a few samples decide it."""
CASES: Final[tuple[tuple[str, Setting], ...]] = (
    ("S4", SHORT),
    ("S6", msgspec.structs.replace(SHORT, tilt="noisy")),
    ("S6", msgspec.structs.replace(SHORT, shake="line-3.1")),
    ("S4", msgspec.structs.replace(SHORT, shake="whipping")),
    ("T1", msgspec.structs.replace(SHORT, tilt="noisy")),
    ("T3", msgspec.structs.replace(SHORT, tilt="noisy", sensor="B", laser="50%")),
)


class Gate(msgspec.Struct, frozen=True, kw_only=True):
    """Errors of one estimator on one case when the gates were set, by name."""

    scenario: str
    setting: Setting
    estimator: str
    measured: dict[str, float]


class Gates(msgspec.Struct, frozen=True, kw_only=True):
    """The file."""

    commit: str
    observers: tuple[str, ...]
    """That were run."""
    gates: tuple[Gate, ...]


def tasks(observers: tuple[str, ...]) -> list[Task]:
    return [Task(scenario=name, seeds=triplet(1), setting=setting, estimators=observers) for name, setting in CASES]


def errors(result: Result) -> dict[str, float]:
    """What can be held by a gate: RMS errors (m) now, ahead and delayed, and the share outside 1.96 std."""
    ahead = {f"forecast {horizon} s": later.rms_m for horizon, later in result.forecast.items()}
    delayed = {"delayed": result.delayed.rms_m} if result.delayed is not None else {}
    found = {"heave": result.rms_m} | ahead | delayed | {OUTSIDE: 1.0 - result.coverage}
    return {name: float(f"{value:.6g}") for name, value in found.items() if isfinite(value)}


def most(name: str, measured: float) -> float:
    """How large an error may be."""
    return measured + OUTSIDE_ROOM if name == OUTSIDE else measured * MARGIN


def made_of(results: Iterable[Result], commit: str, observers: tuple[str, ...]) -> Gates:
    """Gates of what was measured."""
    gates = [Gate(scenario=r.scenario, setting=r.setting, estimator=r.estimator, measured=errors(r)) for r in results]
    gates.sort(key=lambda gate: (gate.scenario, gate.setting.sensor, gate.estimator))
    return Gates(commit=commit, observers=observers, gates=tuple(gates))


def broken(gates: Sequence[Gate], results: Iterable[Result]) -> list[str]:
    """One line for each error that is too large, or not there any more."""
    there = {(result.scenario, result.setting, result.estimator): errors(result) for result in results}
    messages = []
    for gate in gates:
        found = there.get((gate.scenario, gate.setting, gate.estimator), {})
        for name, before in gate.measured.items():
            shaken = f", {gate.setting.shake}" if gate.setting.shake else ""
            what = f"{gate.scenario}{shaken}, sensor {gate.setting.sensor}, {gate.estimator}: {name}"
            if name not in found:
                messages.append(f"{what} is not there any more")
            elif not found[name] <= most(name, before):
                messages.append(f"{what} is {found[name]:.4g}, at most {most(name, before):.4g} (it was {before:.4g})")
    return messages


def table(gates: Sequence[Gate], results: Iterable[Result]) -> str:
    """Markdown: every error beside what it may be."""
    there = {(result.scenario, result.setting, result.estimator): errors(result) for result in results}
    lines = ["| case | estimator | error | measured | at most |", "|---|---|---|---|---|"]
    for gate in gates:
        found = there.get((gate.scenario, gate.setting, gate.estimator), {})
        case = ", ".join(filter(None, (gate.scenario, gate.setting.shake, f"sensor {gate.setting.sensor}")))
        lines += [
            f"| {case} | {gate.estimator} | {name} | {found.get(name, nan):.4g} | {most(name, before):.4g} |"
            for name, before in gate.measured.items()
        ]
    return "\n".join(lines)


def load(path: Path = FILE) -> Gates:
    """
    Raises:
        ValueError: the file is not one of gates.
        OSError: it cannot be read.
    """
    return msgspec.json.decode(path.read_bytes(), type=Gates)


def save(gates: Gates, path: Path = FILE) -> None:
    """A line for each gate, so that a difference is one of gates."""
    head = msgspec.json.encode({"commit": gates.commit, "observers": gates.observers})
    lines = b",\n".join(msgspec.json.encode(gate) for gate in gates.gates)
    path.write_bytes(head.removesuffix(b"}") + b',"gates":[\n' + lines + b"\n]}\n")
