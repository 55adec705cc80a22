"""What is asked of the product, as data, and the table of it: asked, measured, kept or not.

Each figure is found in the lines of results.jsonl, the last that fits: so a table never shows what was not measured.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from math import inf, nan
from typing import Any, Final

import msgspec
import numpy as np

from evidence.closed_loop import loop as closed_loop
from evidence.heave.estimators import TITLES, WITH_LASER
from heaved.simulate.shaking import NONE

Line = Mapping[str, Any]
"""One line of results.jsonl."""
PUBLISHED: Final = 0.995
"""A figure of an estimator that was silent for longer does not count."""
PAPERS: Final = "harmonic"
"""Observer of the paper's method, shown beside the product's."""


class Asked(msgspec.Struct, frozen=True, kw_only=True):
    """One figure that is asked for."""

    what: str
    """The row of the table; figures that have it in common stand in one row."""
    of: str
    """Which of them this is."""
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


class _On(msgspec.Struct, frozen=True):
    """A scenario in a setting, as the asked figures have them."""

    scenario: str
    sensor: str = "A"
    tilt: str = "none"
    laser: str = "off"

    def fields(self) -> dict[str, object]:
        setting = {"sensor": self.sensor, "tilt": self.tilt, "laser": self.laser, "rate_hz": 20.0, "duration_s": None}
        named = {f"setting.{name}": value for name, value in setting.items()}
        return {"kind": "heave", "scenario": self.scenario} | named


_RATIO: Final = "ratio_to_limit"
_PERCENT: Final[dict[str, Any]] = {"unit": "%", "times": 100.0}
_OF_SIGMA: Final[dict[str, Any]] = {"unit": "% of σ", "times": 100.0}
_MM: Final[dict[str, Any]] = {"unit": "mm", "times": 1e3}
_FORECASTS: Final = (("0.5", 1.5), ("1", 1.5), ("2", 1.6), ("5", 1.4))
_CHANGE: Final = (("growing", 0.12), ("first minute after", 0.10), ("second and third", 0.05), ("then", 0.035))


def _asked(what: str, on: _On, figure: str, most: float = inf, *, of: str = "", **fields: Any) -> Asked:
    return Asked(what=what, of=of or on.scenario, where=on.fields(), figure=figure, most=most, **fields)


def _heave() -> Iterator[Asked]:  # a list in loops, no decisions
    for scenario, most in (("S4", 1.25), ("S6S", 1.25), ("Hebrides", 1.25), ("SL", 1.4)):
        yield _asked("A: error over the causal limit", _On(scenario), _RATIO, most)
    yield _asked("A, with tilt and attitude noise: error over the causal limit", _On("S6", tilt="noisy"), _RATIO, 1.7)
    for train, most in (("T1", 0.0010), ("T2", 0.0012), ("T3", 0.0020)):
        yield _asked("A, no laser: error", _On(train, tilt="noisy"), "rms_m", most, **_MM)
    for train, most in (("T1", 0.0016), ("T3", 0.0030)):
        yield _asked("B, laser half the time: error", _On(train, "B", "noisy", "50%"), "rms_m", most, **_MM)
    half = _On("S6", "B", "noisy", "50%")
    yield _asked("B, laser half the time: error, irregular", half, "share_of_sigma", 0.03, **_OF_SIGMA)
    seas = ("S4", "S6", "S6S")
    for horizon, most in _FORECASTS:
        for scenario in seas:
            figure = f"forecast/{horizon}/{_RATIO}"
            yield _asked(f"A: {horizon} s ahead, over its limit", _On(scenario), figure, most)
    for horizon, _ in _FORECASTS:
        for scenario in seas:
            figure, what = f"forecast/{horizon}/coverage", f"A: {horizon} s ahead, in ±1.96 std"
            yield _asked(what, _On(scenario), figure, 0.99, least=0.90, **_PERCENT)
    for scenario in ("S4", "S5", "S6"):
        yield _asked("A: delayed heave", _On(scenario), "delayed/share_of_sigma", 0.006, **_OF_SIGMA)
    yield _asked("A: delayed heave over its limit", _On("Hebrides"), f"delayed/{_RATIO}", 2.0)
    still = (_On("static", tilt="noisy"), _On("S0", tilt="noisy"))
    for at_rest in still:
        yield _asked("real IMU at rest, still ship: error", at_rest, "rms_m", 0.005, **_MM)
    for at_rest in still:
        yield _asked('real IMU at rest, still ship: says "still"', at_rest, "reasons/still", least=0.95, **_PERCENT)
    for scenario in ("S4", "S6"):
        yield _asked("A: within 6 % of σ from a cold start after", _On(scenario), "settled_s", 60.0, unit="s")
    for part, most in _CHANGE:
        changing = _On("SX", tilt="exact")
        yield _asked("A, SX: error over the local σ", changing, f"segments/{part}", most, of=part, **_OF_SIGMA)
    for scenario in ("S4", "S6", "S6S", "SL", "Hebrides"):
        yield _asked("A: in ±1.96 std while valid", _On(scenario), "valid_coverage", least=0.90, **_PERCENT)


def _closed_loop() -> Iterator[Asked]:
    setting = {"sensor": "A", "laser": "off", "shake": NONE, "observer": "sea", "warm_up_s": closed_loop.SCORED_FROM_S}
    for sea in closed_loop.DEFAULT_SEAS:
        where: dict[str, object] = {
            "kind": "closed_loop",
            "sea": sea,
            "way": closed_loop.LIVE,
            "method": closed_loop.OURS.format("sea"),
        }
        where |= {f"setting.{name}": value for name, value in setting.items()}
        what = "closed loop, live: hook motion over heave"
        yield Asked(
            what=what, of=sea, where=where, figure="share", most=0.04, by_observer=False, unit="% of heave", times=100.0
        )


ASKED: Final[tuple[Asked, ...]] = (*_heave(), *_closed_loop())


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
    *parents, name = path.split("/")
    parent = _field(line, parents)
    if parents == ["reasons"]:
        return max((share for text, share in parent.items() if name in text), default=0.0)
    if not isinstance(parent, Mapping) or name not in parent:
        return nan
    if parent[name] is None or line.get("published", 1.0) < PUBLISHED:
        return inf
    return float(parent[name])


def _field(line: Any, path: Sequence[str]) -> Any:
    for key in path:
        line = line.get(key) if isinstance(line, Mapping) else None
    return line


def kept(asked: Asked, value: float) -> bool:
    """Whether a measured value, in the unit of the table, is what was asked."""
    return bool(np.isfinite(value) and asked.least * asked.times <= value <= asked.most * asked.times)


def table(lines: Sequence[Line], observer: str) -> str:
    """Markdown: every asked figure beside what was measured, the paper's method beside the product's."""
    rows = ["| | of | asked | measured | | the paper's method |", "|---" * 6 + "|"]
    verdicts: Counter[str] = Counter()
    for what, group in groupby(ASKED, key=lambda asked: asked.what):
        members = list(group)
        values = [measured(lines, asked, observer) for asked in members]
        found = [_verdict(asked, value) for asked, value in zip(members, values, strict=True)]
        verdicts.update(found)
        cells = [
            what,
            " / ".join(asked.of for asked in members),
            f"{' / '.join(dict.fromkeys(map(_bounds, members)))} {members[0].unit}".rstrip(),
            " / ".join(map(_shown, values)),
            found[0] if len(set(found)) == 1 else "; ".join(_named(members, found)),
            " / ".join(_shown(measured(lines, asked, PAPERS) if asked.by_observer else nan) for asked in members),
        ]
        rows.append(f"| {' | '.join(cells)} |")
    counts = ", ".join(f"{count} {verdict.strip('*')}" for verdict, count in verdicts.items())
    return "\n".join([*rows, "", f"{verdicts.total()} figures: {counts}."])


def _verdict(asked: Asked, value: float) -> str:
    return "not measured" if np.isnan(value) else "ok" if kept(asked, value) else "**not reached**"


def _named(members: Sequence[Asked], verdicts: Sequence[str]) -> Iterator[str]:
    """What is not well in a row, by name."""
    for verdict in dict.fromkeys(verdicts):
        if verdict != "ok":
            names = (asked.of for asked, own in zip(members, verdicts, strict=True) if own == verdict)
            yield f"{verdict}: {', '.join(names)}"


def _bounds(asked: Asked) -> str:
    least, most = asked.least * asked.times, asked.most * asked.times
    if np.isfinite(least) and np.isfinite(most):
        return f"{least:g}–{most:g}"
    return f"≤ {most:g}" if np.isfinite(most) else f"≥ {least:g}"


def _shown(value: float) -> str:
    return "–" if np.isnan(value) else "never" if np.isinf(value) else f"{value:.3g}"
