"""Heave on a hull that shakes: every disturbance on its seas and rates, beside the least error that is possible, a
textbook filter, and what is asked.

The limit is the best linear causal estimate for the sea's spectrum and the noise that the accelerometer then has: its
own, and the vibration with its colour, folded as the poll folds it. What is no stationary noise (a drift, a turn, a
list, an attitude sensor's errors) has no part in it: there the error is asked for in per cent of the heave.
"""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Final, Literal

import msgspec

from evidence.heave.asked import PUBLISHED
from evidence.heave.baselines import DOUBLE_CORNER_HZ
from evidence.heave.estimators import title
from evidence.heave.evaluate import Task, run
from evidence.heave.summary import Result, summary
from evidence.scenarios import HORIZONS_S, Setting, Tilt, triplet
from heaved.simulate.sensors import SENSORS
from heaved.simulate.shaking import NONE, SHAKES, Slams

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

OURS: Final = "sea"
TEXTBOOK: Final = "double"
RATES_HZ: Final = (20.0, 100.0)
COVERED: Final = (0.90, 0.99)
"""Share of errors within 1.96 published standard deviations."""
BY_CHANCE: Final = 2e-4
"""Share of rows beyond four standard deviations that a Gaussian error may have (6e-5 on average, and they come in
groups)."""
AFTER_S: Final = 60.0
"""So long after a turn or a list the error is asked for."""
REAL_AHRS: Final = ("AHRS",)
"""Sensors whose attitude leans and is late."""


class Question(msgspec.Struct, frozen=True, kw_only=True):
    """One disturbance, where it is run and what is asked."""

    name: str
    shake: str = NONE
    sensor: str = "A"
    tilt: Tilt = "none"
    seas: tuple[str, ...] = ("S4", "S6")
    rates_hz: tuple[float, ...] = RATES_HZ
    most: float
    """Of the error: over the limit, or over the standard deviation of the heave."""
    over: Literal["limit", "sigma"] = "limit"
    or_share: float = 0.0
    """Of the standard deviation of the heave, which is good enough whatever the limit."""
    least_valid: float = 0.0
    """Share of the scored time in which the heave is valid."""
    scored_from_s: float = 300.0


def _about(name: str) -> Question:
    """What is asked about a disturbance of the simulator."""
    shake = SHAKES[name]
    if shake.drift is not None:
        return Question(name=name, shake=name, most=1.3, or_share=0.02, rates_hz=(20.0,))
    if (event := shake.turn or shake.list) is not None:
        after_s = event.end_s + AFTER_S
        return Question(
            name=name, shake=name, tilt="noisy", most=0.02, over="sigma", rates_hz=(20.0,), scored_from_s=after_s
        )
    if any(isinstance(part, Slams) for part in shake.vibration):
        return Question(name=name, shake=name, most=1.2)
    return Question(name=name, shake=name, most=1.3, least_valid=0.95)


def _about_ahrs(name: str) -> tuple[Question, ...]:
    """What is asked about an attitude sensor: by itself, and while a turn may be taken for a list."""
    alone = Question(name=name, sensor=name, tilt="noisy", seas=("S6",), rates_hz=(20.0,), most=0.015, over="sigma")
    return alone, msgspec.structs.replace(_about("turn"), name=f"{name}-turn", sensor=name)


_ALL: Final = (
    Question(name="none", most=1.18),
    *map(_about, SHAKES),
    Question(name="poor-sensor", sensor="C", seas=("S4", "SL"), rates_hz=(20.0,), most=1.15),
    Question(name="small-craft", seas=("CRAFT",), most=1.3),
    *(question for name in REAL_AHRS if name in SENSORS for question in _about_ahrs(name)),
)
QUESTIONS: Final[Mapping[str, Question]] = {question.name: question for question in _ALL}
"""By name, in the order of the table."""


Rows = dict[tuple[str, Setting], Question]
"""What is asked of each scenario in each setting."""


def plan(
    names: Iterable[str] = QUESTIONS,
    seas: Sequence[str] = (),
    rates_hz: Sequence[float] = (),
    duration_s: float | None = None,
) -> Rows:
    """What is asked about the disturbances ``names``, on the question's own seas and rates unless others are given.

    Raises:
        ValueError: a disturbance is none of :data:`QUESTIONS`.
    """
    rows: Rows = {}
    for name in names:
        if name not in QUESTIONS:
            raise ValueError(f"unknown disturbance {name!r}: choose from {', '.join(QUESTIONS)}")
        question = QUESTIONS[name]
        for sea in seas or question.seas:
            for rate_hz in rates_hz or question.rates_hz:
                rows.setdefault((sea, setting(question, rate_hz, duration_s)), question)
    return rows


def setting(question: Question, rate_hz: float, duration_s: float | None = None) -> Setting:
    """How a question is run at one rate."""
    return Setting(
        sensor=question.sensor,
        tilt=question.tilt,
        rate_hz=rate_hz,
        shake=question.shake,
        duration_s=duration_s,
        scored_from_s=question.scored_from_s,
    )


def answer(question: Question, sea: str, rate_hz: float, *, duration_s: float | None = None, record: int = 1) -> Result:
    """The product's result on one record.

    Raises:
        ValueError: as :func:`evidence.heave.run`.
    """
    task = Task(scenario=sea, seeds=triplet(record), setting=setting(question, rate_hz, duration_s), estimators=(OURS,))
    return summary([run(task)])[0]


def missed(result: Result, question: Question) -> list[str]:
    """What a result of the product's has not kept, in words; empty: all is kept."""
    value = result.ratio_to_limit if question.over == "limit" else result.share_of_sigma
    valid = result.states.get("valid", 0.0)
    found = []
    if result.published < PUBLISHED:
        found.append(f"silent {100.0 * (1.0 - result.published):.0f} %")
    if question.over == "limit" and result.ratio_to_limit_here < value:
        value = result.ratio_to_limit_here
    if not (value <= question.most or result.share_of_sigma <= question.or_share):
        found.append(f"error {value:.2f} × the limit" if question.over == "limit" else f"error {100.0 * value:.1f} %")
    if valid < question.least_valid:
        found.append(f"valid {100.0 * valid:.0f} %")
    if not COVERED[0] <= result.coverage <= COVERED[1]:
        found.append(f"covered {100.0 * result.coverage:.0f} %")
    if result.lies > max(BY_CHANCE, result.limit_lies):
        found.append(f"lies {1000.0 * result.lies:.1f} ‰")
    return found


def report(results: Sequence[Result], rows: Rows) -> str:
    """Markdown: a line for each disturbance, sea and rate, in the order of ``rows``."""
    heads = (
        *("disturbance", "sea", "Hz", "limit", "ours", "× limit", "× its filter here", "textbook", "asked", ""),
        *("valid", "in ±1.96 std"),
        *("lies ‰", "ahead: × limit", "ahead: in ±1.96 std", "delayed: × limit", "in ±1.96 std"),
    )
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    found = {(one.scenario, one.setting, one.estimator): one for one in results}
    met = 0
    for (sea, how), question in rows.items():
        ours, textbook = (found.get((sea, how, title(name))) for name in (OURS, TEXTBOOK))
        if ours is not None and textbook is not None:
            misses = missed(ours, question)
            met += not misses
            lines.append(_line(ours, textbook, question, misses))
    count = len(lines) - 2
    return "\n".join(
        [
            *lines,
            "",
            f"{count} rows: {met} met, {count - met} missed.",
            "* Errors in % of the standard deviation of the heave; ahead: " + ", ".join(map("{:g}".format, HORIZONS_S))
            + " s. No laser, cold start.",
            "* Limit: causal and linear, with the vibration as coloured noise; of a drift, Bayes' estimate: "
            "neither its rate nor its beginning is known.",
            "* Its filter here: what the filter that reaches it, which knows the spectra and the bias, makes of the "
            "same records, which are harder than others by chance, or easier. Met: within what is asked of either.",
            f"* Textbook: double integrator, a second-order Butterworth high-pass for each, {DOUBLE_CORNER_HZ:g} Hz.",
            f"* Turn and list: scored from {AFTER_S:g} s after; all others from {_ALL[0].scored_from_s:g} s on.",
            "* Lies: rows of the whole record that are valid and off by more than 4 published std (≥: of the limit).",
        ]
    )  # fmt: skip


def _line(ours: Result, textbook: Result, question: Question, misses: Sequence[str]) -> str:
    asked = f"≤ {question.most:g} ×" if question.over == "limit" else f"≤ {100.0 * question.most:g} %"
    if question.or_share:
        asked += f" or {100.0 * question.or_share:g} %"
    silent = f" ({_percent(ours.published)} % of the time)" if ours.published < 1.0 else ""
    delayed = ours.delayed
    cells = (
        question.name,
        ours.scenario,
        f"{ours.setting.rate_hz:g}",
        _percent(ours.limit_m / ours.sigma_m, 2),
        _percent(ours.share_of_sigma, 2) + silent,
        f"{ours.ratio_to_limit:.2f}",
        f"{ours.ratio_to_limit_here:.2f}" if isfinite(ours.ratio_to_limit_here) else "–",
        _percent(textbook.share_of_sigma),
        asked,
        "met" if not misses else f"**missed**: {', '.join(misses)}",
        _percent(ours.states.get("valid", 0.0)),
        _percent(ours.coverage),
        f"{1000.0 * ours.lies:.2f}" + (f" (≥ {1000.0 * ours.limit_lies:.1f})" if ours.limit_lies else ""),
        " / ".join(f"{ahead.ratio_to_limit:.2f}" for ahead in ours.forecast.values()),
        " / ".join(_percent(ahead.coverage, 0) for ahead in ours.forecast.values()),
        "–" if delayed is None else f"{delayed.ratio_to_limit:.2f}",
        "–" if delayed is None else _percent(delayed.coverage),
    )
    return f"| {' | '.join(cells)} |"


def _percent(value: float, digits: int = 1) -> str:
    return f"{100.0 * value:.{digits}f}" if isfinite(value) else "–"
