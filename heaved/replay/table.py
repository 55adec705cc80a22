"""The result of a replay as text: a row per frame, many frames at a time.

Numbers of a block of frames are put side by side and made into text together (:mod:`heaved.replay.decimals`). A block
waits until the delayed heave of all its rows is known, a minute later; if it never is, until there are too many that
wait.
"""

from __future__ import annotations

from array import array
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from itertools import chain, groupby
from math import inf, nan, pi
from operator import attrgetter
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.config import Config
from heaved.estimation.rock.maximum_likelihood import STANDARD_HORIZONS_S
from heaved.predictions import RockPredictions, turned
from heaved.replay.decimals import lines
from heaved.samples import DelayedHeave, HeaveState, MotionFrame

Array = NDArray[np.float64]

_TEXTS: Final = {state: state.value for state in HeaveState}
_DEGREES: Final = 180.0 / pi
_ATTITUDE: Final = (("z", "m"), ("z_rate", "mps"), ("pitch", "deg"), ("pitch_rate", "degps"))
_NOW: Final = ("heave_m", "heave_std_m", "heave_velocity_mps", "observer_m", "correction_m", "lead_s")
_OF_FRAME: Final = attrgetter(*_NOW)
MAX_STEP_S: Final = 0.5
"""Delayed heaves further apart than this have a hole between them."""

FASTEST_HZ: Final = 250.0
"""Rows a second that wait as long as they should. Of more, some are written before their delayed heave is known."""


class Table:
    """Writes frames as they come; what is not known is blank, never zero.

    Attributes:
        names: of the columns.
    """

    def __init__(self, config: Config, write: Callable[[str], object]) -> None:
        """``write`` gets the header at once, and whole lines later."""
        self._write = write
        self._forecasts = config.heave.forecast_horizons_s
        self._rocks = tuple(sorted({*config.rock.horizons_s, *STANDARD_HORIZONS_S}))
        self._hull, self._attitude = config.hull.enabled, config.attitude.enabled
        forecasts = [f"forecast_{h:g}s_{what}" for h in self._forecasts for what in ("m", "std_m")]
        rocks = [
            f"{axis}_{h:g}s_{what}"
            for axis in ("roll", "pitch", "yaw")
            for h in self._rocks
            for what in ("deg", "std_deg")
        ]
        hull = [*(f"hull_{axis}_deg" for axis in "xyz"), *(f"hull_static_{axis}_deg" for axis in "xyz"),
                *(f"hull_{axis}_std_arcsec" for axis in "xyz")]  # fmt: skip
        attitude = [f"attitude_{what}_{unit}" for quantity, unit in _ATTITUDE for what in (quantity, f"{quantity}_std")]
        staged = (hull if self._hull else []) + (attitude if self._attitude else [])
        self.names = ("t_s", *_NOW, "quality", "delayed_heave_m", *forecasts, *rocks, *staged)
        self._delayed = DelayedColumn()
        self._waiting: deque[_Block] = deque()
        self._waiting_rows = 0
        self._most_rows = int(2.0 * config.heave.sea.delay_s * FASTEST_HZ)
        write(",".join(self.names) + "\n")

    def put(self, frames: Sequence[MotionFrame]) -> None:
        """Rows for some frames, one or more."""
        now = np.frombuffer(array("d", chain.from_iterable(map(_OF_FRAME, frames)))).reshape(len(frames), -1)
        parts = [
            np.full((len(frames), 1), nan),  # delayed heave
            _forecast_numbers(frames, self._forecasts),
            _rock_numbers(frames, self._rocks),
        ]
        if self._hull:
            parts.append(np.array([_hull_numbers(frame) for frame in frames]))
        if self._attitude:
            parts.append(np.array([_attitude_numbers(frame) for frame in frames]))
        block = _Block(
            t_s=np.array([frame.t_s for frame in frames]),
            now=now,
            states=[_TEXTS[frame.quality.heave] for frame in frames],
            ahead=np.concatenate(parts, axis=1),
        )
        self._waiting.append(block)
        self._waiting_rows += len(frames)
        self._delayed.take(frame.delayed for frame in frames)
        while self._waiting and (
            self._waiting[0].t_s[-1] <= self._delayed.newest_s or self._waiting_rows > self._most_rows
        ):
            self._write_out()

    def flush(self) -> None:
        """Write what still waits: the delayed heave of most of it is not known any more."""
        while self._waiting:
            self._write_out()

    def _write_out(self) -> None:
        block = self._waiting.popleft()
        self._waiting_rows -= len(block.t_s)
        block.ahead[:, 0] = self._delayed.at(block.t_s)
        rows = zip(block.t_s.tolist(), lines(block.now), block.states, lines(block.ahead), strict=True)
        self._write("".join([f"{t_s:.6f},{now},{state},{ahead}\n" for t_s, now, state, ahead in rows]))


class _Block(msgspec.Struct, frozen=True, eq=False, kw_only=True):
    """Some rows: what is known at their time, and what is known of later, in the order of the columns."""

    t_s: Array
    now: Array
    """(n, 6)"""
    states: list[str]
    ahead: Array
    """(n, k), delayed heave first."""


class DelayedColumn:
    """Delayed heaves as they become known, each offered with many frames, and the heave of any time from them.

    Attributes:
        newest_s: time of the newest; later ones can only change what is after it.
    """

    def __init__(self) -> None:
        self.newest_s = -inf
        self._last: DelayedHeave | None = None
        self._t_s: list[float] = []
        self._heave_m: list[float] = []

    def take(self, delayed: Iterable[DelayedHeave | None]) -> None:
        """What was the newest with each frame. One that is not later than those before says nothing new."""
        for newest in delayed:
            if newest is not self._last and newest is not None:
                self._last = newest
                if newest.t_s > self.newest_s:
                    self.newest_s = newest.t_s
                    self._t_s.append(newest.t_s)
                    self._heave_m.append(newest.heave_m)

    def at(self, t_s: Array) -> Array:
        """(n,) heave at increasing times (n,): linear, since neighbours are 50 ms apart; nan outside, and in holes.

        Earlier times than the last cannot be asked for any more.
        """
        if not self._t_s:
            return np.full(len(t_s), nan)
        known_s, heave_m = np.array([*self._t_s, inf]), np.array([*self._heave_m, nan])
        after = np.searchsorted(known_s, t_s)
        before = np.maximum(after - 1, 0)
        step_s = known_s[after] - known_s[before]
        share = (t_s - known_s[before]) / np.where(step_s > 0.0, step_s, nan)
        between = heave_m[before] + share * (heave_m[after] - heave_m[before])
        found = np.where(known_s[after] == t_s, heave_m[after], np.where(step_s <= MAX_STEP_S, between, nan))
        passed = max(int(after[-1]) - 1, 0)
        del self._t_s[:passed], self._heave_m[:passed]
        return found


def _forecast_numbers(frames: Sequence[MotionFrame], horizons_s: tuple[float, ...]) -> Array:
    """(n, 2 H): heave and its standard deviation, horizon by horizon."""
    rows = []
    for frame in frames:
        found = {one.horizon_s: (one.heave_m, one.std_m) for one in frame.forecast}
        rows.append([found.get(h, (nan, nan)) for h in horizons_s])
    return np.array(rows).reshape(len(frames), -1)


def _rock_numbers(frames: Sequence[MotionFrame], horizons_s: tuple[float, ...]) -> Array:
    """(n, 6 H): angle and its standard deviation in degrees, axis by axis and there horizon by horizon."""
    rocks = [RockPredictions.of(frame.rock, horizons_s) for frame in frames]
    numbers = np.empty((len(rocks), 3, len(horizons_s), 2))
    angles, stds = numbers[..., 0], numbers[..., 1]
    angles[:] = RockPredictions.angles_of(rocks).transpose(0, 2, 1)
    angles[:, 2] = turned(angles[:, 2] + np.array([rock.yaw_from_rad for rock in rocks])[:, None])
    end = 0
    for _, alike in groupby([rock.stds_rad for rock in rocks], key=id):  # they change once every few seconds
        same = list(alike)
        stds[end : end + len(same)] = same[0].T
        end += len(same)
    return numbers.reshape(len(rocks), -1) * _DEGREES


def _hull_numbers(frame: MotionFrame) -> list[float]:
    """The newest deformation, some tenths of a second older than the row."""
    if frame.hull is None:
        return [nan] * 9
    angles = [_DEGREES * angle for angle in (*frame.hull.total_rad, *frame.hull.static_rad)]
    return angles + [3600.0 * _DEGREES * std for std in frame.hull.std_rad]


def _attitude_numbers(frame: MotionFrame) -> list[float]:
    motion = frame.attitude
    if motion is None:
        return [nan] * 8
    return [
        motion.heave_m,
        motion.heave_std_m,
        motion.heave_velocity_mps,
        motion.heave_velocity_std_mps,
        _DEGREES * motion.pitch_rad,
        _DEGREES * motion.pitch_std_rad,
        _DEGREES * motion.pitch_rate_radps,
        _DEGREES * motion.pitch_rate_std_radps,
    ]
