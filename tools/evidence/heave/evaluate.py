"""Heave in figures: every estimator over every scenario, in parallel.

See ``scenarios.py`` for what is run, ``estimators.py`` for what runs, ``scores.py`` for what is counted, ``tables.py``
for how it is shown.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np

from evidence.commands import completed
from evidence.heave import baselines, estimators
from evidence.heave.estimators import Conditions
from evidence.heave.summary import Judged, Result, judged, summary
from evidence.scenarios import HORIZONS_S, REAL, Seeds, Setting, build, files, triplet
from heaved.samples import ImuSample
from heaved.simulate.seaway import TRAINS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

LEVEL_SEA: Final = Setting(tilt="none")
TRAIN: Final = Setting(scored_from_s=200.0)
HALF: Final = "50%"
HEADLINE: Final[tuple[tuple[str, Setting], ...]] = (
    *((name, LEVEL_SEA) for name in ("S4", "S5", "S6", "S6S", "SL", "Hebrides")),
    ("S6", Setting(tilt="exact")),
    ("S6", Setting()),
    ("SX", Setting(tilt="exact")),
    *((name, TRAIN) for name in TRAINS),
    *((name, msgspec.structs.replace(TRAIN, laser=HALF)) for name in TRAINS),
    *((name, msgspec.structs.replace(TRAIN, sensor="B", laser=HALF)) for name in TRAINS),
    ("S6", Setting(sensor="B", laser=HALF)),
    *((name, Setting()) for name in ("palmer", "flume", "static", "S0")),
)
"""What the asked figures are about: the true vertical acceleration on level seas, tilt and laser where they matter."""


class Task(msgspec.Struct, frozen=True, kw_only=True):
    """One record, and who is to run over it."""

    scenario: str
    seeds: Seeds
    setting: Setting
    estimators: tuple[str, ...]
    figures: Path | None = None
    """Folder to draw the record into."""


def tasks(
    rows: Iterable[tuple[str, Setting]], names: tuple[str, ...], records: int, figures: Path | None = None
) -> list[Task]:
    """A task for each record: ``records`` triplets of a simulated scenario, every file of a real one (none where they
    are absent); the first of each row is drawn.
    """
    return [
        Task(
            scenario=scenario,
            seeds=triplet(number),
            setting=setting,
            estimators=names,
            figures=figures if number == 1 else None,
        )
        for scenario, setting in rows
        for number in range(1, 1 + (len(files(scenario)) if scenario in REAL else records))
    ]


def run(task: Task) -> Judged:
    """Make the record, run every estimator over it, judge them.

    Raises:
        ValueError: as :func:`scenarios.build` and :func:`estimators.traces`.
    """
    case = build(task.scenario, task.seeds, task.setting)
    samples = list(case.recording.samples())
    conditions = Conditions(
        rate_hz=case.rate_hz,
        period_s=case.period_s,
        has_laser=task.setting.laser != "off",
        horizons_s=HORIZONS_S,
    )
    traces = [trace for name in task.estimators for trace in estimators.traces(name, samples, conditions)]
    if task.figures is not None:
        from evidence.heave.figures import draw_record  # matplotlib only when it is wanted

        draw_record(task.figures, case, traces)
    return judged(traces, case)


def run_all(
    todo: Sequence[Task], jobs: int = 1, watch: Callable[[Judged], None] = lambda _: None
) -> Iterator[list[Result]]:
    """Run in ``jobs`` processes; the results of each scenario and setting as soon as its last record is done.

    Raises:
        ValueError: as :func:`run`.
    """
    open_rows: dict[tuple[str, Setting], list[Judged]] = {}
    due = {(task.scenario, task.setting): 0 for task in todo}
    for task in todo:
        due[task.scenario, task.setting] += 1
    for _, found in completed(run, todo, jobs):
        watch(found)
        key = (found.scenario, found.setting)
        row = open_rows.setdefault(key, [])
        row.append(found)
        if len(row) == due[key]:
            yield summary(sorted(open_rows.pop(key), key=lambda one: one.seeds.waves))


@cache
def equal_tuning() -> float:
    """Largest difference (m) between KF and UKF on T1 with equal model and tuning."""
    case = build("T1", triplet(1), msgspec.structs.replace(TRAIN, duration_s=700.0))
    inertial = baselines.Inertial()
    samples = (sample for sample in case.recording.samples() if isinstance(sample, ImuSample))
    measured = np.array([inertial.step(sample.t_s, baselines.vertical(sample)) for sample in samples])
    return baselines.ukf_against_kf(measured, case.rate_hz, case.period_s)
