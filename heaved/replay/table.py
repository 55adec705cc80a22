"""The result of a replay as text: a row per frame; what is not known is blank, never zero.

Numbers and units are those of the one table in :mod:`heaved.outputs.fields`. A row waits until the delayed heave of its
time is known, a minute later; if it never is, until there are too many that wait.
"""

from __future__ import annotations

from collections import deque
from math import inf, nan
from typing import TYPE_CHECKING, Final, TypeVar

from heaved.estimation.rock.params import STANDARD_HORIZONS_S
from heaved.outputs.fields import ATTITUDE, FORECAST, HULL, HULL_STD, MOTION, ROCK, compiled
from heaved.samples import CraftMotion, DelayedHeave, HeaveForecast, HullAngles, MotionFrame, RockPrediction

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
_ROCK: Final = tuple(ROCK.only(f"{axis}_deg", f"{axis}_std_deg") for axis in _AXES)
_HULL: Final = (
    HULL.only(*(f"{axis}_deg" for axis in "xyz"), *(f"static_{axis}_deg" for axis in "xyz")),
    HULL_STD.only(*(f"{axis}_std_arcsec" for axis in "xyz")),
)
PLACES: Final = "?,?"
"""Of quality and delayed heave, until they are known."""
_NO_FORECAST: Final = HeaveForecast(horizon_s=nan)
_NO_ROCK: Final = RockPrediction(horizon_s=nan)
_NO_HULL: Final = HullAngles(t_s=nan, state="")
_NO_ATTITUDE: Final = CraftMotion(
    t_s=nan,
    heave_m=nan,
    heave_velocity_mps=nan,
    pitch_rad=nan,
    pitch_rate_radps=nan,
    heave_std_m=nan,
    heave_velocity_std_mps=nan,
    pitch_std_rad=nan,
    pitch_rate_std_radps=nan,
)


class Table:
    """Writes frames as they come.

    Attributes:
        names: of the columns.
    """

    def __init__(self, config: Config, write: Callable[[str], object]) -> None:
        """``write`` gets the header at once, and whole lines later."""
        self._write = write
        self._forecast_horizons_s = list(config.heave.forecast_horizons_s)
        self._rock_horizons_s = sorted({*config.rock.horizons_s, *STANDARD_HORIZONS_S})
        # What is known of later, and of the stages: names of the columns, and expressions of their values.
        ahead: list[tuple[str, str]] = []
        for i, h in enumerate(self._forecast_horizons_s):
            names = f"forecast_{h:g}s_m", f"forecast_{h:g}s_std_m"
            ahead += zip(names, FORECAST.outside(f"forecasts[{i}]"), strict=True)
        for axis, fields in zip(_AXES, _ROCK, strict=True):
            for i, h in enumerate(self._rock_horizons_s):
                names = f"{axis}_{h:g}s_deg", f"{axis}_{h:g}s_std_deg"
                ahead += zip(names, fields.outside(f"rocks[{i}]"), strict=True)
        if config.hull.enabled:
            for angles in _HULL:
                ahead += zip([f"hull_{name}" for name in angles.names], angles.outside("hull"), strict=True)
        if config.attitude.enabled:
            # Of a craft, z is what is heave elsewhere.
            craft = [name.replace("heave_velocity", "z_rate").replace("heave", "z") for name in ATTITUDE.names]
            ahead += zip([f"attitude_{name}" for name in craft], ATTITUDE.outside("attitude"), strict=True)
        self.names = ("t_s", *_NOW.names, "quality", "delayed_heave_m", *(name for name, _ in ahead))
        values = ["frame.t_s", *_NOW.outside("frame"), *(value for _, value in ahead)]
        self._numbers: Callable[..., tuple[float, ...]] = compiled(
            f"({', '.join(values)})", ["frame", "forecasts", "rocks", "hull", "attitude"]
        )
        """All but quality and delayed heave, in the order of the columns."""
        cells = ["%.6f"] * (1 + len(_NOW.names)) + [PLACES] + ["%.6f"] * len(ahead)
        self._row = (",".join(cells) + "\n").encode()
        """All numbers at once, in two thirds of the time of one after the other, and as bytes, which is a tenth faster
        again. Quality and delayed heave are put in when it is written."""
        self._delayed = DelayedColumn()
        self._waiting: deque[tuple[float, str, str]] = deque()
        """Times of rows, their quality, and their numbers."""
        self._most_rows = int(2.0 * config.heave.sea.delay_s * FASTEST_HZ)
        write(",".join(self.names) + "\n")

    def begin_run(self) -> None:
        """What follows is of another run of the daemon, whose clock may have begun anew."""
        self.flush()
        self._delayed = DelayedColumn()

    def push(self, frame: MotionFrame) -> None:
        """Add the row of a frame."""
        numbers = self._numbers(
            frame,
            _of_horizons(frame.forecast, self._forecast_horizons_s, _NO_FORECAST),
            _of_horizons(frame.rock, self._rock_horizons_s, _NO_ROCK),
            frame.hull or _NO_HULL,
            frame.attitude or _NO_ATTITUDE,
        )
        text = (self._row % numbers).decode()
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
        before, _, after = text.partition(PLACES)
        self._write(f"{before}{quality},{_blank(f'{self._delayed.at(t_s):.6f}')}{after}")


def _of_horizons(found: Sequence[Ahead], horizons_s: list[float], none: Ahead) -> Sequence[Ahead]:
    """Those of these horizons; ``none`` where there is none. Nearly always they are all that are found, in order."""
    if [one.horizon_s for one in found] == horizons_s:
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
