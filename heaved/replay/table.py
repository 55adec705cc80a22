"""The result of a replay as text: a row per frame; what is not known is blank, never zero.

Numbers and units are those of the one table in :mod:`heaved.outputs.fields`. A row waits until the delayed heave of its
time is known, a minute later; if it never is, until there are too many that wait.
"""

from __future__ import annotations

from collections import deque
from itertools import chain
from math import inf, nan
from operator import itemgetter
from typing import TYPE_CHECKING, Final, TypeVar

from heaved.estimation.rock.maximum_likelihood import STANDARD_HORIZONS_S
from heaved.outputs.fields import ATTITUDE, FORECAST, HULL, HULL_STD, MOTION, ROCK
from heaved.samples import DelayedHeave, HeaveForecast, HullAngles, MotionFrame, RockPrediction

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from heaved.config import Config

Ahead = TypeVar("Ahead", HeaveForecast, RockPrediction)

MAX_STEP_S: Final = 0.5
"""Delayed heaves further apart than this have a hole between them."""
FASTEST_HZ: Final = 250.0
"""Rows a second that wait as long as they should. Of more, some are written before their delayed heave is known."""

_NOW: Final = MOTION.only("heave_m", "heave_std_m", "heave_velocity_mps", "observer_m", "correction_m", "lead_s")
_AXES: Final = ("roll", "pitch", "yaw")
_ROCK: Final = ROCK.only(*(f"{axis}_{what}" for axis in _AXES for what in ("deg", "std_deg")))
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
        ahead = [*forecasts, *rocks, *hull, *attitude]
        self.names = ("t_s", *_NOW.names, "quality", "delayed_heave_m", *ahead)
        width, count = len(_ROCK.names), len(self._rock_horizons_s)
        self._by_axis = itemgetter(
            *(width * i + 2 * axis + what for axis in range(len(_AXES)) for i in range(count) for what in range(2))
        )
        """Of the numbers of the predictions, one prediction after the other: in the order of the columns."""
        cells = ["%.6f"] * (1 + len(_NOW.names)) + ["%%s"] * 2 + ["%.6f"] * len(ahead)
        self._row = (",".join(cells) + "\n").encode()
        """All numbers at once, which takes two thirds of the time of one after the other, as bytes, in which they are a
        tenth faster. Quality and delayed heave are put in when it is written."""
        self._delayed = DelayedColumn()
        self._waiting: deque[tuple[float, str, str]] = deque()
        """Times of rows, their quality, and their numbers."""
        self._most_rows = int(2.0 * config.heave.sea.delay_s * FASTEST_HZ)
        write(",".join(self.names) + "\n")

    def push(self, frame: MotionFrame) -> None:
        """Add the row of a frame."""
        text = (self._row % self._numbers(frame)).decode()
        self._waiting.append((frame.t_s, frame.quality.heave.value, _blank(text)))
        self._delayed.push(frame.delayed)
        while self._waiting and (self._waiting[0][0] <= self._delayed.newest_s or len(self._waiting) > self._most_rows):
            self._write_first()

    def flush(self) -> None:
        """Write what still waits: the delayed heave of most of it is not known any more."""
        while self._waiting:
            self._write_first()

    def _write_first(self) -> None:
        t_s, quality, text = self._waiting.popleft()
        self._write(text % (quality, _blank(f"{self._delayed.at(t_s):.6f}")))

    def _numbers(self, frame: MotionFrame) -> tuple[float, ...]:
        """All but quality and delayed heave, in the order of the columns and in their units."""
        forecasts = _of_horizons(frame.forecast, self._forecast_horizons_s, _NO_FORECAST)
        rocks = _of_horizons(frame.rock, self._rock_horizons_s, _NO_ROCK)
        numbers = [frame.t_s, *_NOW.outside(frame)]
        for forecast in forecasts:
            numbers += FORECAST.outside(forecast)
        numbers += self._by_axis(list(chain.from_iterable(map(_ROCK.outside, rocks))))
        if self._has_hull:
            for fields in _HULL:
                numbers += fields.outside(frame.hull or _NO_HULL)
        if self._has_attitude:
            numbers += _NO_ATTITUDE if frame.attitude is None else ATTITUDE.outside(frame.attitude)
        return tuple(numbers)


def _of_horizons(found: Sequence[Ahead], horizons_s: tuple[float, ...], none: Ahead) -> Sequence[Ahead]:
    """Those of these horizons; ``none`` where there is none. Nearly always they are all that are found, in order."""
    if tuple([one.horizon_s for one in found]) == horizons_s:
        return found
    by_horizon = {one.horizon_s: one for one in found}
    return [by_horizon.get(horizon_s, none) for horizon_s in horizons_s]


def _blank(text: str) -> str:
    """Without the numbers that are not finite."""
    return text.replace("nan", "").replace("-inf", "").replace("inf", "") if "n" in text else text


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
