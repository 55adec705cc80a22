"""The result of a replay as text: a row per frame; what is not known is blank, never zero.

Numbers and units are those of the one table in :mod:`heaved.outputs.fields`. A row waits until the delayed heave of its
time is known, a minute later; if it never is, until there are too many that wait.
"""

from __future__ import annotations

from collections import deque
from functools import cache
from itertools import chain
from math import inf, nan
from operator import mul
from typing import TYPE_CHECKING, Final

from heaved.estimation.rock.maximum_likelihood import STANDARD_HORIZONS_S
from heaved.outputs.fields import ATTITUDE, FORECAST, HULL, HULL_STD, MOTION, ROCK
from heaved.samples import DelayedHeave, HeaveForecast, HullAngles, MotionFrame, RockPrediction

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from heaved.config import Config

MAX_STEP_S: Final = 0.5
"""Delayed heaves further apart than this have a hole between them."""
FASTEST_HZ: Final = 250.0
"""Rows a second that wait as long as they should. Of more, some are written before their delayed heave is known."""

_NOW: Final = MOTION.only("heave_m", "heave_std_m", "heave_velocity_mps", "observer_m", "correction_m", "lead_s")
_AXES: Final = ("roll", "pitch", "yaw")
_ROCK: Final = tuple(ROCK.only(f"{axis}_deg", f"{axis}_std_deg") for axis in _AXES)
_HULL: Final = (
    HULL.only(*(f"{axis}_deg" for axis in "xyz"), *(f"static_{axis}_deg" for axis in "xyz")),
    HULL_STD.only(*(f"{axis}_std_arcsec" for axis in "xyz")),
)
_NO_FORECAST: Final = HeaveForecast(horizon_s=nan)
_NO_ROCK: Final = RockPrediction(horizon_s=nan)
_NO_HULL: Final = HullAngles(t_s=nan, state="")
_NO_ATTITUDE: Final = (nan,) * len(ATTITUDE.names)


class Table:
    """Writes frames as they come.

    Attributes:
        names: of the columns.
    """

    def __init__(self, config: Config, write: Callable[[str], object]) -> None:
        """``write`` gets the header at once, and whole lines later."""
        self._write = write
        self._forecast_horizons_s = config.heave.forecast_horizons_s
        self._rock_horizons_s = tuple(sorted({*config.rock.horizons_s, *STANDARD_HORIZONS_S}))
        self._has_hull, self._has_attitude = config.hull.enabled, config.attitude.enabled
        forecasts = [f"forecast_{h:g}s_{what}" for h in self._forecast_horizons_s for what in ("m", "std_m")]
        rocks = [
            f"{axis}_{h:g}s_{what}" for axis in _AXES for h in self._rock_horizons_s for what in ("deg", "std_deg")
        ]
        hull = [f"hull_{name}" for fields in _HULL for name in fields.names] if self._has_hull else []
        # Of a craft, z is what is heave elsewhere.
        craft = [name.replace("heave_velocity", "z_rate").replace("heave", "z") for name in ATTITUDE.names]
        attitude = [f"attitude_{name}" for name in craft] if self._has_attitude else []
        self.names = ("t_s", *_NOW.names, "quality", "delayed_heave_m", *forecasts, *rocks, *hull, *attitude)
        self._per_inside = (
            *FORECAST.per_inside * len(self._forecast_horizons_s),
            *chain.from_iterable(rock.per_inside * len(self._rock_horizons_s) for rock in _ROCK),
            *(chain.from_iterable(fields.per_inside for fields in _HULL) if self._has_hull else ()),
            *(ATTITUDE.per_inside if self._has_attitude else ()),
        )
        """Of what is known ahead: factors to the units of the columns."""
        self._delayed = DelayedColumn()
        self._waiting: deque[tuple[float, str, str]] = deque()
        """Times of rows, and what stands before and after their delayed heave."""
        self._most_rows = int(2.0 * config.heave.sea.delay_s * FASTEST_HZ)
        write(",".join(self.names) + "\n")

    def push(self, frame: MotionFrame) -> None:
        """Add the row of a frame."""
        now = map(mul, _NOW.inside(frame), _NOW.per_inside)
        ahead = map(mul, chain.from_iterable(self._ahead(frame)), self._per_inside)
        before = f"{frame.t_s:.6f},{_cells(now)},{frame.quality.heave.value}"
        self._waiting.append((frame.t_s, before, _cells(ahead)))
        self._delayed.push(frame.delayed)
        while self._waiting and (self._waiting[0][0] <= self._delayed.newest_s or len(self._waiting) > self._most_rows):
            self._write_first()

    def flush(self) -> None:
        """Write what still waits: the delayed heave of most of it is not known any more."""
        while self._waiting:
            self._write_first()

    def _write_first(self) -> None:
        t_s, before, after = self._waiting.popleft()
        self._write(f"{before},{_cells((self._delayed.at(t_s),))},{after}\n")

    def _ahead(self, frame: MotionFrame) -> Iterator[tuple[float, ...]]:
        """What is known of later, and of the stages, in the order of the columns and in units inside."""
        forecasts = {one.horizon_s: one for one in frame.forecast}
        rocks = {one.horizon_s: one for one in frame.rock}
        in_order = [rocks.get(horizon_s, _NO_ROCK) for horizon_s in self._rock_horizons_s]
        yield from [FORECAST.inside(forecasts.get(h, _NO_FORECAST)) for h in self._forecast_horizons_s]
        yield from [rock.inside(one) for rock in _ROCK for one in in_order]
        if self._has_hull:
            yield from [fields.inside(frame.hull or _NO_HULL) for fields in _HULL]
        if self._has_attitude:
            yield _NO_ATTITUDE if frame.attitude is None else ATTITUDE.inside(frame.attitude)


class DelayedColumn:
    """Delayed heaves as they become known, each offered with many frames, and the heave of any time from them.

    Attributes:
        newest_s: time of the newest; later ones can only change what is after it.
    """

    def __init__(self) -> None:
        self.newest_s = -inf
        self._known: deque[DelayedHeave] = deque()

    def push(self, delayed: DelayedHeave | None) -> None:
        """What was the newest with a frame. One that is not later than those before says nothing new."""
        if delayed is not None and delayed.t_s > self.newest_s:
            self.newest_s = delayed.t_s
            self._known.append(delayed)

    def at(self, t_s: float) -> float:
        """The heave of a time: linear, since neighbours are 50 ms apart; nan outside, and in holes.

        Earlier times than the last cannot be asked for any more.
        """
        known = self._known
        while len(known) > 1 and known[1].t_s <= t_s:
            known.popleft()
        if not known or t_s < known[0].t_s:
            return nan
        before = known[0]
        if t_s == before.t_s:
            return before.heave_m
        if len(known) == 1 or (step_s := known[1].t_s - before.t_s) > MAX_STEP_S:
            return nan
        return before.heave_m + (t_s - before.t_s) / step_s * (known[1].heave_m - before.heave_m)


def _cells(numbers: Iterable[float]) -> str:
    """Six decimals each, commas between; blank what is not finite."""
    cells = tuple(numbers)
    text = _format(len(cells)) % cells
    return text.replace("nan", "").replace("-inf", "").replace("inf", "")


@cache
def _format(cells: int) -> str:
    """Of so many cells at once, which takes two thirds of the time of one after the other."""
    return ",".join(["%.6f"] * cells)
