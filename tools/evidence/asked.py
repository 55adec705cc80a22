"""What is asked of the product, as data, and the table of it: asked, measured, kept or not.

Each figure is found in the lines of results.jsonl, the last that fits: so a table never shows what was not measured.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import inf, nan
from typing import Any, Final

import msgspec
import numpy as np

from evidence.estimators import TITLES, WITH_LASER

Line = Mapping[str, Any]
"""One line of results.jsonl."""
PUBLISHED: Final = 0.995
"""A figure of an estimator that was silent for longer does not count."""
PAPERS: Final = "harmonic"
"""Observer of the paper's method, shown beside the product's."""


class Asked(msgspec.Struct, frozen=True, kw_only=True):
    """One figure that is asked for."""

    what: str
    where: dict[str, object]
    """Field of a result (``setting.sensor`` for one inside another) -> the value it has to have."""
    figure: str
    """The field that is asked about, ``/`` between levels: ``forecast/0.5/ratio_to_limit``; ``reasons/WORD``: the share
    of time in which a reason has that word in it."""
    least: float = -inf
    most: float = inf
    unit: str = ""
    times: float = 1.0
    """From the unit of the result to the unit of the table."""
    by_observer: bool = True
    """The result of an observer of the product: its title is the estimator."""


def _asked(
    what: str,
    scenario: str,
    figure: str,
    most: float,
    *,
    least: float = -inf,
    sensor: str = "A",
    tilt: str = "none",
    laser: str = "off",
    **shown: Any,
) -> Asked:
    fields = {"kind": "heave", "scenario": scenario}
    setting = {"setting.sensor": sensor, "setting.tilt": tilt, "setting.laser": laser}
    setting |= {"setting.rate_hz": 20.0, "setting.duration_s": None}
    return Asked(what=what, where=fields | setting, figure=figure, least=least, most=most, **shown)


def _heave() -> Iterator[Asked]:
    for scenario, most in (("S4", 1.25), ("S6S", 1.25), ("Hebrides", 1.25), ("SL", 1.4)):
        yield _asked(f"{scenario}, A: error over the causal limit", scenario, "ratio_to_limit", most)
    yield _asked("S6 with tilt and attitude noise, A: the same", "S6", "ratio_to_limit", 1.7, tilt="noisy")
    mm = {"unit": "mm", "times": 1e3}
    for scenario, most in (("T1", 1.0), ("T2", 1.2), ("T3", 2.0)):
        yield _asked(f"{scenario}, A, no laser: error", scenario, "rms_m", most / 1e3, tilt="noisy", **mm)
    half = {"sensor": "B", "tilt": "noisy", "laser": "50%"}
    for scenario, most in (("T1", 1.6), ("T3", 3.0)):
        yield _asked(f"{scenario}, B, laser half the time: error", scenario, "rms_m", most / 1e3, **half, **mm)
    percent = {"unit": "% of σ", "times": 100.0}
    yield _asked("S6, B, laser half the time: error", "S6", "share_of_sigma", 0.03, **half, **percent)
    for horizon, most in (("0.5", 1.5), ("1", 1.5), ("2", 1.6), ("5", 1.4)):
        for scenario in ("S4", "S6", "S6S"):
            where = f"forecast/{horizon}"
            yield _asked(f"{scenario}, A: {horizon} s ahead, over its limit", scenario, f"{where}/ratio_to_limit", most)
            within = {"least": 0.90, "unit": "%", "times": 100.0}
            yield _asked(f"{scenario}, A: the same, in ±1.96 std", scenario, f"{where}/coverage", 0.99, **within)
    for scenario in ("S4", "S5", "S6"):
        yield _asked(f"{scenario}, A: delayed heave", scenario, "delayed/share_of_sigma", 0.006, **percent)
    what = "Hebrides, A: delayed heave over the non-causal limit"
    yield _asked(what, "Hebrides", "delayed/ratio_to_limit", 2.0)
    still = {"tilt": "noisy"}
    yield _asked("static IMU: error", "static", "rms_m", 0.005, **still, **mm)
    says = {"least": 0.95, "unit": "% of the time", "times": 100.0}
    yield _asked('static IMU: says "still"', "static", "reasons/still", inf, **still, **says)
    for scenario in ("S4", "S6"):
        yield _asked(f"{scenario}, A: settled within 6 % of σ from", scenario, "settled_s", 60.0, unit="s")
    for part, most in (
        ("growing", 0.12),
        ("first minute after", 0.10),
        ("second and third", 0.05),
        ("then", 0.035),
    ):
        yield _asked(f"SX, A: {part}", "SX", f"segments/{part}", most, tilt="exact", **percent)
    for scenario in ("S4", "S6", "S6S", "SL", "Hebrides"):
        within = {"least": 0.90, "unit": "%", "times": 100.0}
        yield _asked(f"{scenario}, A: in ±1.96 std while valid", scenario, "valid_coverage", inf, **within)


ASKED: Final[tuple[Asked, ...]] = tuple(_heave())


def measured(lines: Iterable[Line], asked: Asked, observer: str) -> float:
    """The figure in the unit of the table from the last line that fits; nan: there is none; inf: it says null."""
    wanted = dict(asked.where)
    if asked.by_observer:
        with_laser = asked.where.get("setting.laser", "off") != "off"
        wanted["estimator"] = TITLES.get(observer, observer) + (WITH_LASER if with_laser else "")
    found = nan
    for line in lines:
        if all(_field(line, path.split(".")) == value for path, value in wanted.items()):
            found = _figure(line, asked.figure) * asked.times
    return found


def _figure(line: Line, path: str) -> float:
    if line.get("published", 1.0) < PUBLISHED:
        return inf
    *parents, name = path.split("/")
    parent = _field(line, parents)
    if parents == ["reasons"]:
        return max((share for text, share in parent.items() if name in text), default=0.0)
    if not isinstance(parent, Mapping) or name not in parent:
        return nan
    return inf if parent[name] is None else float(parent[name])


def _field(line: Any, path: Sequence[str]) -> Any:
    for key in path:
        line = line.get(key) if isinstance(line, Mapping) else None
    return line


def kept(asked: Asked, value: float) -> bool:
    """Whether a measured value, in the unit of the table, is what was asked."""
    return bool(asked.least * asked.times <= value <= asked.most * asked.times)


def table(lines: Sequence[Line], observer: str) -> str:
    """Markdown: every asked figure beside what was measured, the paper's method beside the product's."""
    rows = [
        "| | asked | measured | | the paper's method |",
        "|---|---|---|---|---|",
    ]
    verdicts = []
    for asked in ASKED:
        value = measured(lines, asked, observer)
        papers = measured(lines, asked, PAPERS)
        verdict = "not measured" if np.isnan(value) else "ok" if kept(asked, value) else "**not reached**"
        verdicts.append(verdict)
        rows.append(f"| {asked.what} | {_bounds(asked)} | {_shown(value)} | {verdict} | {_shown(papers)} |")
    counts = ", ".join(f"{verdicts.count(verdict)} {verdict.strip('*')}" for verdict in dict.fromkeys(verdicts))
    return "\n".join([*rows, "", f"{len(verdicts)} figures: {counts}."])


def _bounds(asked: Asked) -> str:
    least, most = asked.least * asked.times, asked.most * asked.times
    if np.isfinite(least) and np.isfinite(most):
        text = f"{least:g}–{most:g}"
    else:
        text = f"≤ {most:g}" if np.isfinite(most) else f"≥ {least:g}"
    return f"{text} {asked.unit}".rstrip()


def _shown(value: float) -> str:
    return "–" if np.isnan(value) else "never" if np.isinf(value) else f"{value:.3g}"
