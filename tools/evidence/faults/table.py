"""The table of disasters as Markdown: what is asked, what was published, and where the two do not meet."""

from __future__ import annotations

from math import ceil, inf, isfinite, isnan, nan
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np

from evidence.faults.disasters import DISASTERS, HONEST_OF, Asked
from evidence.faults.judge import BY_CHANCE, KINDS, LIE, WHOLE_FROM_S, Outcome, Task

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

HEADS: Final = (
    "disaster", "what happens", "lies", "doubted", "beyond", "worst / std", "largest / σ", "largest angle", "valid",
    "degraded", "valid after", "usable after", "delayed, % of σ", "last minute, % of σ", "heave, × honest",
    "rock, × honest", "missed",
)  # fmt: skip
SHORT: Final = tuple(head for head in HEADS if head not in ("doubted", "valid", "degraded", "last minute, % of σ"))
"""Of the table that has the worst of all runs."""


class Ratios(msgspec.Struct, frozen=True, kw_only=True):
    """A run beside the honest one on the same record; nan: one of them published nothing of the kind."""

    heave: float
    rock: float
    valid_later_s: float
    """By how much longer it took until the heave was valid, of what is there from the first sample."""
    usable_later_s: float


def honest_beside(outcomes: Sequence[Outcome], outcome: Outcome) -> Ratios | None:
    """Ratios to the honest record of the same sea, rate and seed; None: that was not run."""
    name = HONEST_OF[DISASTERS[outcome.task.name].laser]
    wanted = msgspec.structs.replace(outcome.task, name=name)
    for honest in outcomes:
        if honest.task == wanted:
            from_start = DISASTERS[outcome.task.name].from_start
            span = "whole" if from_start else "last"
            heave, honest_heave = (getattr(one, f"{span}_heave_m") for one in (outcome, honest))
            rock, honest_rock = (getattr(one, f"{span}_rock_deg") for one in (outcome, honest))
            return Ratios(
                heave=heave / honest_heave if honest_heave > 0.0 else nan,
                rock=rock / honest_rock if honest_rock > 0.0 else nan,
                valid_later_s=outcome.valid_after_s - (honest.valid_after_s if from_start else 0.0),
                usable_later_s=outcome.usable_after_s - (honest.usable_after_s if from_start else 0.0),
            )
    return None


def missed(outcome: Outcome, ratios: Ratios | None) -> list[str]:
    """What is asked of the run and was not met."""
    asked = DISASTERS[outcome.task.name].asked
    found = [outcome.crash.split(":", 1)[0]] if outcome.crash else []
    found += [f"{count} {kind} lies" for kind, count in outcome.lies.items() if count > _by_chance(outcome, kind)]
    found += [f"{outcome.beyond} beyond physics"] if outcome.beyond else []
    found += [f"{outcome.infinite} not finite"] if outcome.infinite else []
    if ratios is None:
        return found
    after_s = ratios.valid_later_s if asked.back == "valid" else ratios.usable_later_s
    if asked.within_s is not None and not after_s <= asked.within_s:
        found.append(f"{asked.back} after {_seconds(after_s)} > {asked.within_s:g} s")
    for what, ratio, most in (("heave", ratios.heave, asked.heave_ratio), ("rock", ratios.rock, asked.rock_ratio)):
        if most is not None and not ratio <= most:
            found.append(f"{what} {_number(ratio, 2)} > {most:g}" if isfinite(ratio) else f"no {what} in the end")
    return found


def _by_chance(outcome: Outcome, kind: str) -> int:
    """How many would be beyond LIE standard deviations if these are right: of heave in the future, where what is to
    come is most of the error, and not a bound of it.
    """
    return ceil(BY_CHANCE * outcome.forecasts) if kind == "forecast" else 0


def report(outcomes: Sequence[Outcome], detail: bool = False) -> str:
    """Markdown: a row for each disaster, the worst of its runs in each column; with ``detail`` a row for each run."""
    names = list(dict.fromkeys(outcome.task.name for outcome in outcomes))
    lines = ["## Disasters", "", *_header(SHORT)]
    for name in names:
        runs = [outcome for outcome in outcomes if outcome.task.name == name]
        lines.append(_row(SHORT, name, DISASTERS[name].what, runs, outcomes))
    lines += ["", *_notes(outcomes)]
    if detail:
        lines += ["", "## Every run", "", *_header(HEADS)]
        for outcome in sorted(outcomes, key=lambda one: names.index(one.task.name)):
            lines.append(_row(HEADS, outcome.task.name, _record(outcome.task), [outcome], outcomes))
        lines += ["", *(line for outcome in outcomes for line in _background(outcome))]
    return "\n".join(lines)


def _record(task: Task) -> str:
    return f"{task.sea}, {task.rate_hz:g} Hz, record {task.seed}"


def _header(heads: Sequence[str]) -> list[str]:
    return ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]


def _row(heads: Sequence[str], name: str, what: str, runs: Sequence[Outcome], outcomes: Sequence[Outcome]) -> str:
    beside = [honest_beside(outcomes, run) for run in runs]
    ratios = [found for found in beside if found is not None]
    misses: dict[str, None] = {}
    for run, found in zip(runs, beside, strict=True):
        misses.update(dict.fromkeys(missed(run, found)))
    lies = {kind: sum(run.lies[kind] for run in runs) for kind in KINDS}
    chance = max((_by_chance(run, "forecast") for run in runs), default=0)
    cells = (
        name,
        what,
        ", ".join(
            f"{count} {kind}" + (f" (chance: {chance} a run)" if kind == "forecast" else "")
            for kind, count in lies.items()
            if count
        )
        or "0",
        str(sum(count for run in runs for count in run.off.values())),
        str(sum(run.beyond + run.infinite for run in runs)),
        _number(_worst(run.worst_stds for run in runs), 1),
        _number(_worst(run.largest_sigma for run in runs), 1),
        f"{_number(_worst(run.largest_rock_deg for run in runs), 0)}°",
        f"{100.0 * min(run.states['valid'] for run in runs):.0f} %",
        f"{100.0 * max(run.states['degraded'] for run in runs):.0f} %",
        _after(runs, lambda run: run.valid_after_s, name, lambda asked: asked.back == "valid"),
        _after(runs, lambda run: run.usable_after_s, name, lambda asked: asked.back == "usable"),
        _number(100.0 * _worst(run.delayed_m / run.sigma_m for run in runs), 1),
        _number(100.0 * _worst(run.last_heave_m / run.sigma_m for run in runs), 1),
        _asked([found.heave for found in ratios], DISASTERS[name].asked.heave_ratio),
        _asked([found.rock for found in ratios], DISASTERS[name].asked.rock_ratio),
        "; ".join(misses) or "–",
    )
    shown = dict(zip(HEADS, cells, strict=True))
    return "| " + " | ".join(shown[head] for head in heads) + " |"


def _after(
    runs: Sequence[Outcome], value: Callable[[Outcome], float], name: str, is_asked: Callable[[Asked], bool]
) -> str:
    asked = DISASTERS[name].asked
    text = _seconds(max(value(run) for run in runs))
    if asked.within_s is None or not is_asked(asked):
        return text
    sign = "+" if DISASTERS[name].from_start else ""
    return f"{text} (≤ {sign}{asked.within_s:g})"


def _asked(ratios: Sequence[float], most: float | None) -> str:
    """The worst of them; the median before it where there are several."""
    there = [ratio for ratio in ratios if not isnan(ratio)]
    text = _number(_worst(there), 2)
    if len(there) > 1:
        text = f"{_number(float(np.median(there)), 2)}, {text}"
    return text + (f" (≤ {most:g})" if most is not None else "")


def _worst(values: Iterable[float]) -> float:
    there = [value for value in values if not isnan(value)]
    return max(there, default=nan)


def _number(value: float, digits: int) -> str:
    if not isfinite(value):
        return "–" if isnan(value) else "∞"
    return f"{value:.{digits}f}" if abs(value) < 1e4 else f"{value:.1e}"


def _seconds(value: float) -> str:
    return f"{value:.0f} s" if value < inf else "never"


def _notes(outcomes: Sequence[Outcome]) -> list[str]:
    tasks = [outcome.task for outcome in outcomes]
    crashes = [f"* {o.task.name}, {_record(o.task)}: {o.crash}" for o in outcomes if o.crash]
    over = [sorted({getattr(task, field) for task in tasks}) for field in ("sea", "rate_hz", "seed")]
    seas, rates, seeds = (", ".join(f"{v:g}" if isinstance(v, float) else str(v) for v in values) for values in over)
    plan = tasks[0].plan
    met = sum(not missed(outcome, honest_beside(outcomes, outcome)) for outcome in outcomes)
    return [
        f"{met} of {len(outcomes)} runs have all that is asked.",
        "",
        f"Worst of: seas {seas}; {rates} Hz; records {seeds}; sensor A. Disasters begin at {plan.at_s:g} s of "
        f"{plan.duration_s:g} s, or with the record. Lies: frames from then on that are `valid` with an error beyond "
        f"{LIE:g} published standard deviations (measured angles: beyond 1°); doubted: the same in frames that are "
        "`degraded` or `settling`. Beyond: numbers that no vessel has, in any state. Ratios: of the errors of the "
        f"last minute, or of all from {WHOLE_FROM_S:g} s on where it lasts from the start; median and worst. In "
        "brackets what is asked; beside 0 lies and 0 beyond. Of forecasts as many lies as Gaussian errors with the "
        f"published standard deviations have, {1e6 * BY_CHANCE:.0f} in a million, are none.",
        *(["", "Ended by an exception:", "", *crashes] if crashes else []),
    ]


def _background(outcome: Outcome) -> list[str]:
    given = "; ".join(f"{text} ({100.0 * share:.0f} %)" for text, share in outcome.reasons.items())
    shares = ", ".join(f"{100.0 * share:.0f} % {state}" for state, share in outcome.states.items() if share)
    off = ", ".join(f"{count} {kind}" for kind, count in outcome.off.items() if count)
    worst = f"worst at {outcome.worst_std_at_s:.1f} s" if np.isfinite(outcome.worst_std_at_s) else "never valid"
    return [
        f"* {outcome.task.name}, {_record(outcome.task)}: {shares}; {worst}; point off by {outcome.point_m:.2f} m at "
        f"most; beyond {LIE:g} std but not valid: {off or 'nothing'}; resets {outcome.resets or 'none'}; "
        f"reasons: {given or 'none'}"
    ]
