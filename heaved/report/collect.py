"""What is taken down of a recording while it goes through the pipeline, in memory that does not grow with its length.

Frames are kept until the future has shown what they foretold: the delayed heave of the furthest moment that they speak
of comes a minute after that. They are then gone through in blocks, and what is left of them are sums, spectra,
envelopes of a bounded number of bins, and a few stretches to be shown as they were.
"""

from __future__ import annotations

from collections import Counter, deque
from math import inf, nan
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.rock.params import STANDARD_HORIZONS_S
from heaved.replay.replay import without_numbers
from heaved.replay.table import MAX_STEP_S
from heaved.report.columns import Column
from heaved.report.spectra import Spectra
from heaved.report.statistics import Envelope, Errors, Moments, between, measured_at
from heaved.report.timeline import Timeline
from heaved.samples import (
    GRAVITY_MPS2,
    CraftSample,
    CraneSample,
    Fault,
    HeaveState,
    ImuSample,
    LaserSample,
    MotionFrame,
    MruComparison,
    MruSample,
    RatesSample,
    Sample,
    SeaState,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.config import Config
    from heaved.estimation.heave.sea.model import SeaModel
    from heaved.estimation.heave.sea.refit import SeaFit
    from heaved.pipeline import Pipeline
    from heaved.replay.live import RecordedRun
    from heaved.replay.replay import Run

Array = NDArray[np.float64]

BLOCK: Final = 2048
"""Frames that are gone through at once."""
AVERAGED_S: Final = 0.05
"""The sea is fitted to means of samples over about this long; spectra are those of the same means."""
LATE_S: Final = 10.0
"""Beyond twice the age of the delayed heave: what has not come by then does not come."""
MEASURED_S: Final = 0.1
"""A roll that was measured no longer ago than this is held against what was predicted for then."""
ANGLE_STEP_S: Final = 0.25
"""Angles further apart are no line."""
STRETCH_S: Final = 60.0
"""Of the stretches that are shown as they were."""
SHORTEST_STRETCH_S: Final = 20.0
MOST_STRETCHES: Final = 12
"""That are kept of an even spacing: when there are more, every second one goes."""
MOST_COMBINATIONS: Final = 4096
"""Of reasons, whose kinds are remembered."""
STATES: Final = tuple(HeaveState)
AXES: Final = ("roll", "pitch")

DRAWN: Final = (
    "heave", "std", "delayed", "reference", "error", "laser_error", "laser_std", "nees", "laser_nees",
    "lead", "correction", *AXES,
)  # fmt: skip
"""Columns of the envelope."""

_DEVICES: Final = {
    ImuSample: "IMU",
    LaserSample: "laser",
    RatesSample: "second IMU",
    CraftSample: "craft",
    CraneSample: "crane",
    MruSample: "reference MRU",
}
_DEGREES: Final = 180.0 / np.pi

# Columns of a frame's row; those of its forecasts, predictions and points follow.
(T, VALID, HEAVE, STD, CORRECTION, LEAD, READ, REFERENCE, ROLL, PITCH, MEASURED, AX, AY, AZ, STATE) = range(15)
FIXED: Final = 15


class Stretch(msgspec.Struct, frozen=True, eq=False):
    """A minute as it was: rows of frames at least 50 ms apart, from as long before as the furthest forecast reaches."""

    begin_s: float
    end_s: float
    nees: float
    """Mean square of the heave's error over its claim."""
    rows: Array
    """(n, columns), delayed heave and its standard deviation the last two."""


class _Block(msgspec.Struct, eq=False):
    rows: Array
    reasons: list[tuple[int, ...]]
    laser: list[tuple[int, ...]]
    correction: list[tuple[int, ...]]


class Layout:
    """Where in a row the forecasts, the predictions and the points are.

    Attributes:
        forecasts_s: horizons of the heave.
        rock_s: horizons of roll and pitch.
        points: names.
        width: of a row.
    """

    def __init__(self, config: Config) -> None:
        self.forecasts_s = tuple(config.heave.forecast_horizons_s)
        self.rock_s = tuple(sorted({*config.rock.horizons_s, *STANDARD_HORIZONS_S}))
        self.points = tuple(point.name for point in config.point)
        self._rock = FIXED + 2 * len(self.forecasts_s)
        self._points = self._rock + 6 * len(self.rock_s)
        self.width = self._points + 2 * len(self.points)
        self.furthest_s = max((*self.forecasts_s, *self.rock_s, config.compensation.lead_s))

    def forecast(self, i: int) -> slice:
        """Heave and standard deviation of the i-th horizon, m."""
        return slice(FIXED + 2 * i, FIXED + 2 * i + 2)

    def rock(self, axis: int, i: int) -> slice:
        """Angle, standard deviation and half-width of the interval of the i-th horizon, rad."""
        begin = self._rock + 6 * i + 3 * axis
        return slice(begin, begin + 3)

    def point(self, i: int) -> slice:
        """Heave and standard deviation of the i-th point, m."""
        return slice(self._points + 2 * i, self._points + 2 * i + 2)


class SeaAt(msgspec.Struct, frozen=True, kw_only=True):
    """What a fit said of the sea."""

    t_s: float
    """When it came into force."""
    sea: SeaState
    """Without its spectrum."""


class Collector:
    """Feed it every step of a replay, then :meth:`finish`.

    Attributes:
        layout: of the rows in stretches.
        frames, begin_s, end_s: how many, and the times of the first and the last.
        interval_s: usual time between frames; nan: there are too few.
        realtime, laser: errors of the heave against the delayed heave and the laser, by state.
        reference_mru: by what the heave of an existing MRU differs from ours, its mean taken out, beside what both
            explain.
        forecasts, rock: by horizon; by axis and horizon.
        quality, reasons, laser_states, corrections: what held when.
        reason_texts: by their kinds, as first given; varied: kinds that came with other numbers.
        envelope, points: for drawing.
    """

    def __init__(self, config: Config) -> None:
        self.layout = layout = Layout(config)
        self._laser_std_m = config.laser.noise_std_m
        self._too_old_s = 2.0 * config.heave.sea.delay_s + layout.furthest_s + LATE_S
        self.frames, self.begin_s, self.end_s, self.interval_s = 0, nan, nan, nan
        self.realtime = {state: Errors() for state in STATES}
        self.all_realtime, self.settled_realtime = Errors(), Errors()
        self.laser = {state: Errors() for state in STATES}
        self.all_laser, self.settled_laser = Errors(), Errors()
        self.reference_mru = Errors()
        self._compared: MruComparison | None = None
        self._differences: list[tuple[float, float, float]] = []
        self.forecasts = [Errors() for _ in layout.forecasts_s]
        self.rock = {axis: [Errors() for _ in layout.rock_s] for axis in AXES}
        self.quality, self.reasons, self.laser_states, self.corrections = (Timeline() for _ in range(4))
        self._state_places = [(self.quality.place(state.value),) for state in STATES]
        self.reason_texts: dict[str, str] = {}
        self.varied: set[str] = set()
        self._combinations: dict[tuple[str, ...], tuple[int, ...]] = {}
        self.moments = {name: Moments() for name in ("heave", "delayed", "delayed_std", "roll", "pitch", "correction")}
        self.expected_nees = Moments()
        """1 - the variance of the delayed heave over that of the real-time one."""
        self.point_moments = [Moments() for _ in layout.points]
        self.point_stds = [Moments() for _ in layout.points]
        self.envelope = Envelope(DRAWN)
        self.points = Envelope(layout.points or ("none",))
        self.columns: dict[str, Column] = {}
        self.faults: Counter[tuple[str, Fault]] = Counter()
        self.sea: list[SeaAt] = []
        self._sea: SeaState | None = None
        self.mean_sea = MeanSpectra()
        self.spectra: dict[str, Spectra] = {}
        self.stretches: list[Stretch] = []
        self.worst: Stretch | None = None
        self._stretch_every, self._stretch_count = 1, 0
        self._recent: list[Array] = []
        self._recent_from_s = nan
        self._thinned_s = -inf
        self._samples: dict[type[Sample], list[tuple[object, ...]]] = {}
        self._rows: list[tuple[float, ...]] = []
        self._told: tuple[list[tuple[int, ...]], ...] = ([], [], [])
        self._blocks: deque[_Block] = deque()
        self._before = np.full((0, layout.width), nan)
        self._delayed: list[tuple[float, float, float]] = []
        self._delayed_known = np.empty((0, 3))
        self._delayed_s = -inf
        self._averaged = 1
        self._rest = np.empty((0, 2))
        self._none_ahead = (nan,) * (2 * len(layout.forecasts_s))
        self._none_rocking = (nan,) * (6 * len(layout.rock_s))
        self._none_at_points = (nan,) * (2 * len(layout.points))

    # --- step by step ------------------------------------------------------------------------------------------------

    def take(self, run: Run | RecordedRun, sample: Sample, frame: MotionFrame | None) -> None:
        """One step of the replay."""
        kind = type(sample)
        told = self._samples.setdefault(kind, [])
        told.append(msgspec.structs.astuple(sample)[:-1])
        if sample.fault is not Fault.NONE:
            self.faults[_DEVICES[kind], sample.fault] += 1
        if len(told) >= BLOCK:
            self._take_down(kind)
        if frame is not None:
            if frame.sea is not self._sea:
                self._note_sea(frame, run.fit)
            self._note_reference_mru(frame)
            self._rows.append(self._row(run.pipeline, frame, sample))
            if (delayed := frame.delayed) is not None and delayed.t_s > self._delayed_s:
                self._delayed_s = delayed.t_s
                self._delayed.append((delayed.t_s, delayed.heave_m, delayed.std_m))
            if len(self._rows) >= BLOCK:
                self._close_block()
                self._settle()

    def finish(self) -> None:
        """There is no more: go through what still waits."""
        for kind in self._samples:
            self._take_down(kind)
        if self._rows:
            self._close_block()
        self._settle(is_last=True)
        if self._recent:
            self._end_stretch(self.end_s, at_least_s=SHORTEST_STRETCH_S)
        self.mean_sea.end(self.end_s)

    def _row(self, pipeline: Pipeline, frame: MotionFrame, sample: Sample) -> tuple[float, ...]:
        assert isinstance(sample, ImuSample)
        layout, quality, reference = self.layout, frame.quality, pipeline.laser.reference
        reasons, laser, correction = self._told
        reasons.append(self._kinds(quality.reasons))
        laser.append((self.laser_states.place(quality.laser.value),))
        correction.append((self.corrections.place(quality.correction.value),))
        t_s = frame.t_s
        ahead: Sequence[float] = self._none_ahead
        if len(frame.forecast) == len(layout.forecasts_s):
            ahead = [x for one in frame.forecast for x in (one.heave_m, one.std_m)]
        rocking: Sequence[float] = self._none_rocking
        if len(frame.rock) == len(layout.rock_s):
            rocking = [
                x
                for one in frame.rock
                for x in (
                    one.roll_rad, one.roll_std_rad, one.roll_interval_rad,
                    one.pitch_rad, one.pitch_std_rad, one.pitch_interval_rad,
                )
            ]  # fmt: skip
        at_points: Sequence[float] = self._none_at_points
        if frame.points:
            at_points = [x for one in frame.points for x in (one.heave_m, one.heave_std_m)]
        return (
            t_s,
            t_s + frame.compensation_lead_s,
            frame.heave_m,
            frame.heave_std_m,
            frame.correction_m,
            frame.lead_s,
            reference.value_t_s,
            reference.value_m if reference.is_known else nan,
            frame.roll_rad,
            frame.pitch_rad,
            pipeline.vertical.attitude.measured_s,
            sample.ax_mps2,
            sample.ay_mps2,
            sample.az_mps2,
            STATES.index(quality.heave),
            *ahead,
            *rocking,
            *at_points,
        )

    def _kinds(self, reasons: tuple[str, ...]) -> tuple[int, ...]:
        known = self._combinations.get(reasons)
        if known is None:
            if len(self._combinations) >= MOST_COMBINATIONS:
                self._combinations.clear()
            kinds = dict.fromkeys(map(without_numbers, reasons))
            for text in reasons:
                kind = without_numbers(text)
                if self.reason_texts.setdefault(kind, text) != text:
                    self.varied.add(kind)
            known = self._combinations[reasons] = tuple(self.reasons.place(kind) for kind in kinds)
        return known

    def _note_sea(self, frame: MotionFrame, fit: SeaFit | None) -> None:
        self._sea = frame.sea
        if frame.sea is not None:
            bare = msgspec.structs.replace(frame.sea, frequencies_hz=(), spectrum_m2phz=())
            self.sea.append(SeaAt(t_s=frame.t_s, sea=bare))
            is_of_fit = fit is not None and fit.sea is not None
            model, dt_s = (fit.model, fit.dt_s) if is_of_fit and fit is not None else (None, nan)
            self.mean_sea.change(frame.t_s, frame.sea, model, dt_s)

    def _note_reference_mru(self, frame: MotionFrame) -> None:
        found = frame.reference_mru
        if found is not None and found is not self._compared:
            self._compared, heave = found, found.heave
            self._differences.append((found.t_s, heave.difference - heave.mean_difference, heave.explained))

    def _take_down(self, kind: type[Sample]) -> None:
        """Samples of one device, column by column."""
        told = self._samples[kind]
        if not told:
            return
        table = np.array(told, dtype=np.float64)
        told.clear()
        names = msgspec.structs.fields(kind)
        for field, values in zip(names[1:-1], table.T[1:], strict=True):
            is_angle = field.name.endswith("_rad")
            name = f"{field.name.removesuffix('_rad')}_deg" if is_angle else field.name
            key = f"{_DEVICES[kind]}: {name}"
            if np.isfinite(values).any() or key in self.columns:
                column = self.columns.setdefault(key, Column(_DEVICES[kind], name))
                column.push(table[:, 0], values * _DEGREES if is_angle else values)

    # --- block by block ----------------------------------------------------------------------------------------------

    def _close_block(self) -> None:
        rows = np.array(self._rows, dtype=np.float64)
        if self.frames == 0:
            self.begin_s = float(rows[0, T])
        if np.isnan(self.interval_s) and len(rows) > 1:
            self._set_interval(float(np.median(np.diff(rows[:, T]))))
        self.frames += len(rows)
        self.end_s = float(rows[-1, T])
        self._blocks.append(_Block(rows, *self._told))
        self._rows, self._told = [], ([], [], [])
        if self._differences:
            self.reference_mru.push(*np.array(self._differences).T)
            self._differences = []
        if self._delayed:
            self._delayed_known = np.concatenate((self._delayed_known, np.array(self._delayed)))
            self._delayed = []

    def _set_interval(self, interval_s: float) -> None:
        self.interval_s = interval_s
        self._averaged = max(1, int(AVERAGED_S / interval_s + 0.25))
        averaged_s = self._averaged * interval_s
        self.spectra = {name: Spectra(averaged_s) for name in ("acceleration", "heave", "delayed", "error")}
        if self._averaged > 1:
            self.spectra["all acceleration"] = Spectra(interval_s)

    def _settle(self, is_last: bool = False) -> None:
        """Go through the blocks whose future is known, or will not be."""
        while self._blocks and (is_last or len(self._blocks) > 1):
            end_s = float(self._blocks[0].rows[-1, T])
            is_known = min(self._delayed_s, self.end_s) > end_s + self.layout.furthest_s
            if not (is_last or is_known or self.end_s - end_s > self._too_old_s):
                return
            block = self._blocks.popleft()
            later = [one.rows for one in self._blocks]
            rows = block.rows
            next_s = float(later[0][0, T]) if later else end_s + (self.interval_s if self.interval_s > 0.0 else 0.0)
            self._go_through(block, np.diff(rows[:, T], append=next_s), np.concatenate((self._before, rows, *later)))
            self._before = rows[-1:]
            # Every later row asks for later moments; the next one may lie before the block's own end, by no lead.
            kept = np.searchsorted(self._delayed_known[:, 0], end_s) - 1
            self._delayed_known = self._delayed_known[max(int(kept), 0) :]

    def _go_through(self, block: _Block, step_s: Array, around: Array) -> None:
        """A block, the time from each of its frames to the next, and its rows with the one before and those after."""
        rows, layout = block.rows, self.layout
        t_s, valid_s, heave, std = rows[:, T], rows[:, VALID], rows[:, HEAVE], rows[:, STD]
        states = rows[:, STATE].astype(np.int64)
        self.quality.push(t_s, step_s, [self._state_places[state] for state in states.tolist()])
        self.reasons.push(t_s, step_s, block.reasons)
        self.laser_states.push(t_s, step_s, block.laser)
        self.corrections.push(t_s, step_s, block.correction)

        delayed, delayed_std = self._delayed_at(valid_s)
        error = heave - delayed
        self._push_by_state(self.realtime, self.all_realtime, self.settled_realtime, states, t_s, error, std)
        laser_error, laser_std = self._laser_errors(rows, around)
        self._push_by_state(self.laser, self.all_laser, self.settled_laser, states, t_s, laser_error, laser_std)

        for i, horizon_s in enumerate(layout.forecasts_s):
            foretold, claimed = rows[:, layout.forecast(i)].T
            self.forecasts[i].push(t_s, foretold - self._delayed_at(t_s + horizon_s)[0], claimed)
        angles = (rows[:, ROLL], rows[:, PITCH])
        measured = around[around[:, T] - around[:, MEASURED] <= MEASURED_S]
        for axis, (name, place) in enumerate(zip(AXES, (ROLL, PITCH), strict=True)):
            self.moments[name].push(angles[axis] * _DEGREES)
            for i, horizon_s in enumerate(layout.rock_s):
                predicted, claimed, width = _DEGREES * rows[:, layout.rock(axis, i)].T
                then = _DEGREES * measured_at(t_s + horizon_s, measured[:, T], measured[:, place], ANGLE_STEP_S)
                self.rock[name][i].push(t_s, predicted - then, claimed, width)

        self.moments["heave"].push(heave)
        self.moments["delayed"].push(delayed)
        self.moments["delayed_std"].push(delayed_std)
        self.moments["correction"].push(rows[:, CORRECTION])
        with np.errstate(divide="ignore", invalid="ignore"):
            self.expected_nees.push(np.where(np.isfinite(error), np.maximum(1.0 - (delayed_std / std) ** 2, 0.0), nan))
            nees, laser_nees = (error / std) ** 2, (laser_error / laser_std) ** 2
        reference = np.where(np.isfinite(laser_error), rows[:, REFERENCE], nan)
        self.envelope.push(
            t_s, heave, std, delayed, reference, error, laser_error, laser_std, nees, laser_nees,
            rows[:, LEAD], rows[:, CORRECTION], _DEGREES * angles[0], _DEGREES * angles[1],
        )  # fmt: skip
        at_points = [rows[:, layout.point(i)] for i in range(len(layout.points))]
        for i, at_point in enumerate(at_points):
            self.point_moments[i].push(at_point[:, 0])
            self.point_stds[i].push(at_point[:, 1])
        if at_points:
            self.points.push(t_s, *(at_point[:, 0] for at_point in at_points))
        self._push_spectra(rows, heave, delayed, error)
        self._push_stretch(np.column_stack((rows, delayed, delayed_std)))

    def _delayed_at(self, t_s: Array) -> tuple[Array, Array]:
        """Delayed heave and its standard deviation at some times."""
        known_s, heave, std = self._delayed_known.T
        return between(t_s, known_s, heave, MAX_STEP_S), between(t_s, known_s, std, MAX_STEP_S)

    def _laser_errors(self, rows: Array, around: Array) -> tuple[Array, Array]:
        """Heave minus each new reading of the laser, at the time of that, and what was claimed for the difference; nan
        in rows that bring none.
        """
        read_s = rows[:, READ]
        is_new = read_s != np.concatenate((self._before[:, READ] if len(self._before) else [nan], read_s[:-1]))
        read_s = np.where(is_new, read_s, nan)
        heave, std = (between(read_s, around[:, VALID], around[:, place], MAX_STEP_S) for place in (HEAVE, STD))
        return heave - rows[:, REFERENCE], np.hypot(std, self._laser_std_m)

    def _push_by_state(
        self,
        by_state: dict[HeaveState, Errors],
        everywhere: Errors,
        settled: Errors,
        states: NDArray[np.int64],
        t_s: Array,
        error: Array,
        std: Array,
    ) -> None:
        everywhere.push(t_s, error, std)
        for i, state in enumerate(STATES):
            of_it = states == i
            if of_it.any():
                by_state[state].push(t_s[of_it], error[of_it], std[of_it])
                if state in (HeaveState.VALID, HeaveState.DEGRADED):
                    settled.push(t_s[of_it], error[of_it], std[of_it])

    def _push_spectra(self, rows: Array, heave: Array, delayed: Array, error: Array) -> None:
        if not self.spectra:
            return
        t_s, roll, pitch = rows[:, T], rows[:, ROLL], rows[:, PITCH]
        ax, ay, az = rows[:, AX], rows[:, AY], rows[:, AZ]
        mast = np.sin(roll) * ay + np.cos(roll) * az
        level = np.sin(pitch) * ax + np.cos(pitch) * mast
        # Where there are never angles, the tilt stays in it; where they are missing, it would be of another kind.
        up = (level if self.moments["roll"].count else az) - GRAVITY_MPS2
        if "all acceleration" in self.spectra:
            self.spectra["all acceleration"].push(t_s, up)
        k = self._averaged
        known = np.isfinite(up)
        measured = np.concatenate((self._rest, np.column_stack((t_s[known], up[known]))))
        # Two plain means, one after the other, as they are fitted: each of its own samples and of those before.
        triangle = np.convolve(np.ones(k), np.ones(k)) / k**2
        count = (len(measured) - len(triangle)) // k + 1
        if count > 0:
            means = np.stack([np.convolve(series, triangle, "valid")[::k] for series in measured.T])
            self.spectra["acceleration"].push(*means)
            measured = measured[count * k :]
        self._rest = measured
        for name, values in (("heave", heave), ("delayed", delayed), ("error", error)):
            self.spectra[name].push(t_s[::k], values[::k])

    # --- stretches ---------------------------------------------------------------------------------------------------

    def _push_stretch(self, rows: Array) -> None:
        thin_s = 0.98 * AVERAGED_S
        kept = []
        for i, t_s in enumerate(rows[:, T].tolist()):
            if t_s - self._thinned_s >= thin_s:
                self._thinned_s = t_s
                kept.append(i)
        for row_block in np.array_split(rows[kept], max(len(kept) // 64, 1)):
            if len(row_block) == 0:
                continue
            if np.isnan(self._recent_from_s):
                self._recent_from_s = float(row_block[0, T])
            self._recent.append(row_block)
            if row_block[-1, T] - self._recent_from_s >= STRETCH_S:
                self._end_stretch(float(row_block[-1, T]))

    def _end_stretch(self, end_s: float, at_least_s: float = STRETCH_S) -> None:
        rows = np.concatenate(self._recent)
        begin_s = self._recent_from_s
        inside = rows[rows[:, T] >= begin_s]
        error, std = inside[:, HEAVE] - inside[:, -2], inside[:, STD]
        known = np.isfinite(error) & (std > 0.0)
        enough = np.count_nonzero(known) >= 0.5 * len(inside) and end_s - begin_s >= at_least_s
        if enough and end_s - begin_s < 2.0 * STRETCH_S:
            nees = float(np.mean((error[known] / std[known]) ** 2))
            stretch = Stretch(begin_s, end_s, nees, rows)
            if self.worst is None or nees > self.worst.nees:
                self.worst = stretch
            if self._stretch_count % self._stretch_every == 0:
                self.stretches.append(stretch)
            self._stretch_count += 1
            if len(self.stretches) > MOST_STRETCHES:
                self.stretches = self.stretches[::2]
                self._stretch_every *= 2
        self._recent = [rows[rows[:, T] >= end_s - self.layout.furthest_s]]
        self._recent_from_s = end_s

    @property
    def typical(self) -> Stretch | None:
        """That of the kept ones whose claims were as good as those of half of the others; None: there is none."""
        in_order = sorted(self.stretches, key=lambda one: one.nees)
        return in_order[len(in_order) // 2] if in_order else None


class Parts(msgspec.Struct, frozen=True, eq=False):
    """Fitted spectrum of the vertical acceleration at ``f_hz`` (k,), one-sided, (m/s2)2/Hz."""

    f_hz: Array
    whole: Array
    waves: Array
    vibration: Array
    noise: Array
    """White, and the walk of the bias."""


class MeanSpectra:
    """Means of what the fits said, each for as long as it was in force."""

    def __init__(self) -> None:
        self._since_s = nan
        self._heave: tuple[Array, Array] | None = None
        self._parts: Parts | None = None
        self._f_hz, self._grid_hz = np.empty(0), np.empty(0)
        self._heave_sum, self._sums = np.empty(0), np.empty((4, 0))
        self._seconds = self._parts_seconds = 0.0

    def change(self, t_s: float, sea: SeaState, model: SeaModel | None, dt_s: float) -> None:
        """Something else is in force from now on; ``model`` of samples every ``dt_s``, if there is one."""
        self.end(t_s)
        f_hz, density = np.array(sea.frequencies_hz), np.array(sea.spectrum_m2phz)
        if len(self._f_hz) == 0:
            self._f_hz, self._heave_sum = f_hz, np.zeros(len(f_hz))
        self._heave = f_hz, density
        self._parts = None
        if model is not None and dt_s > 0.0:
            if len(self._grid_hz) == 0:
                self._grid_hz = np.linspace(0.0, 0.5 / dt_s, 4097)[1:]
                self._sums = np.zeros((4, len(self._grid_hz)))
            self._parts = parts_of(model, self._grid_hz, dt_s)

    def end(self, t_s: float) -> None:
        """What was in force is so no longer."""
        if self._heave is not None and t_s > self._since_s:
            lasted_s = t_s - self._since_s
            self._heave_sum += lasted_s * np.interp(self._f_hz, *self._heave)
            self._seconds += lasted_s
            if self._parts is not None:
                p = self._parts
                self._sums += lasted_s * np.stack([p.whole, p.waves, p.vibration, p.noise])
                self._parts_seconds += lasted_s
        self._since_s = t_s

    def heave(self) -> tuple[Array, Array] | None:
        """Frequencies (k,) and heave spectrum (k,), m2/Hz; None: there was no fit."""
        return (self._f_hz, self._heave_sum / self._seconds) if self._seconds > 0.0 else None

    def acceleration(self) -> Parts | None:
        """Likewise of the acceleration."""
        return Parts(self._grid_hz, *(self._sums / self._parts_seconds)) if self._parts_seconds > 0.0 else None


def parts_of(model: SeaModel, f_hz: Array, dt_s: float) -> Parts:
    """What a fitted model says of the acceleration, part by part."""
    whole = model.acceleration_spectrum(f_hz, dt_s)
    w2 = (2.0 * np.pi * f_hz) ** 2
    waves = w2**2 * model.wave_spectrum(f_hz)
    vibration = np.zeros_like(f_hz)
    for one in model.resonances:
        if one.is_heave:
            waves += one.spectrum(f_hz, dt_s)
        else:
            vibration += one.spectrum(f_hz, dt_s)
    return Parts(f_hz, whole, waves, vibration, model.noise_psd + 2.0 * model.bias_walk_psd / w2)
