"""What a recording comes to, in numbers and in words: all that the tables of a report hold, and its JSON. Pure."""

from __future__ import annotations

from math import hypot, isfinite, nan, sqrt
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from heaved import __version__
from heaved.report.collect import AXES, Collector
from heaved.report.columns import ColumnHealth
from heaved.report.statistics import ErrorStatistics
from heaved.report.timeline import Spells
from heaved.samples import HeaveState, vibration_in_words

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.config import Config
    from heaved.pipeline import PipelineSummary
    from heaved.replay.replay import Summary

SETTLED = "valid and degraded"
EVERYWHERE = "all published"


class Source(msgspec.Struct, frozen=True, kw_only=True):
    """The file that a report is of."""

    name: str
    size_bytes: int
    sha256: str
    """Empty: it was no file, but a pipe."""
    columns: tuple[str, ...]


class ReasonHeld(msgspec.Struct, frozen=True, kw_only=True):
    """One reason that frames gave for their quality, and for how long."""

    text: str
    """As the first of them gave it."""
    varies: bool
    """Others gave it with other numbers."""
    held: Spells


class HorizonErrors(msgspec.Struct, frozen=True, kw_only=True):
    """Errors of what was foretold for one horizon."""

    horizon_s: float
    errors: ErrorStatistics


class Sea(msgspec.Struct, frozen=True, kw_only=True):
    """What the fits said, and what the heave itself shows; nan: not known."""

    fits: int = 0
    """That were in force."""
    significant_height_m: float = nan
    """Median of the fits, least and greatest; likewise the periods."""
    least_height_m: float = nan
    greatest_height_m: float = nan
    peak_period_s: float = nan
    shortest_peak_period_s: float = nan
    longest_peak_period_s: float = nan
    mean_period_s: float = nan
    is_still: bool = False
    """The last one found no motion above the sensor's noise."""
    systems: str = ""
    """Swell and wind sea of the last fit, in words."""
    vibration: str = ""
    """Of the strongest that a fit found, in words."""
    noise_mps2_rthz: float = nan
    bias_walk_mps2_rts: float = nan
    heave_height_m: float = nan
    """4 standard deviations of the real-time heave,"""
    delayed_height_m: float = nan
    """and of the delayed one."""


class PointFound(msgspec.Struct, frozen=True, kw_only=True):
    """How a monitoring point moved."""

    name: str
    significant_height_m: float
    """4 standard deviations."""
    lowest_m: float
    highest_m: float
    claimed_rms_m: float


class Learned(msgspec.Struct, frozen=True, kw_only=True):
    """What the laser has taught, at the end; nan: nothing."""

    lead_s: float
    learned_lead_s: float
    gain: float
    comparisons: int
    laser_constant_m: float
    correction_rms_m: float
    trainings: dict[str, int]
    fits: dict[str, int]
    failure: str
    spikes: int
    rejected: int
    out_of_order: int


class Findings(msgspec.Struct, frozen=True, kw_only=True):
    """All of it."""

    release: str
    source: Source
    made: str
    """UTC, ISO 8601."""
    command: str
    config_name: str
    config: dict[str, object]
    """Every key of the tables that a replay uses that is not at its default, by its path."""
    devices: tuple[str, ...]
    """Lines of the sensors, as configured."""
    rows: int
    frames: int
    duration_s: float
    begin_s: float
    rate_hz: float
    told_s: float
    """With samples,"""
    silent_s: float
    """and without."""
    quality: dict[str, Spells]
    reasons: tuple[ReasonHeld, ...]
    laser_states: dict[str, Spells]
    corrections: dict[str, Spells]
    realtime: dict[str, ErrorStatistics]
    """Errors against the delayed heave, m: by state, and of them together."""
    delayed_std_rms_m: float
    expected_nees: float
    """Of the heave against the delayed one, were every claim right: that has part of the same error."""
    independent_errors: float
    """How many independent errors the heave's are worth, by their spectrum."""
    laser: dict[str, ErrorStatistics]
    reference_mru: ErrorStatistics
    """What the heave of an existing MRU differs from ours, m, beside what the errors of both explain."""
    forecasts: tuple[HorizonErrors, ...]
    """m"""
    rock: dict[str, tuple[HorizonErrors, ...]]
    """degrees"""
    roll_std_deg: float
    pitch_std_deg: float
    sea: Sea
    points: tuple[PointFound, ...]
    columns: tuple[ColumnHealth, ...]
    faults: dict[str, int]
    learned: Learned

    @property
    def has_laser(self) -> bool:
        """Whether there is a column of the laser."""
        return "laser_m" in self.source.columns

    @property
    def implied_rms_m(self) -> float:
        """RMS error of the settled real-time heave, that of the delayed heave included: the two add up in square, since
        a smoothed value and what it corrects are uncorrelated.
        """
        return hypot(self.realtime[SETTLED].rms, self.delayed_std_rms_m)

    @property
    def nees_scatter(self) -> float:
        """Standard deviation that the NEES of the heave would have by chance."""
        return self.expected_nees * sqrt(2.0 / self.independent_errors) if self.independent_errors > 0.0 else nan

    def share(self, spells: Spells) -> float:
        """Of the whole time, the silent one included."""
        whole_s = self.told_s + self.silent_s
        return spells.seconds / whole_s if whole_s > 0.0 else nan


def findings(
    collector: Collector,
    *,
    source: Source,
    made: str,
    command: str,
    config: Config,
    config_name: str,
    summary: Summary,
    learned: PipelineSummary,
) -> Findings:
    """What has been collected, when it is finished."""
    layout = collector.layout
    error_spectrum = collector.spectra["error"].spectrum() if collector.spectra else None
    independent_s = error_spectrum.independent_s if error_spectrum is not None else 0.0
    compared = collector.all_realtime.statistics().count * collector.interval_s
    by_state = {state.value: collector.realtime[state].statistics() for state in HeaveState}
    laser_by_state = {state.value: collector.laser[state].statistics() for state in HeaveState}
    return Findings(
        release=__version__,
        source=source,
        made=made,
        command=command,
        config_name=config_name,
        config=changed_keys(config),
        devices=tuple(
            f"{one.name} ({one.role}): {one.link} id {one.device_id}, {one.profile.name} at {one.rate_hz:g} Hz"
            for one in config.device
        ),
        rows=summary.rows,
        frames=collector.frames,
        duration_s=summary.duration_s,
        begin_s=collector.begin_s,
        rate_hz=1.0 / collector.interval_s if collector.interval_s > 0.0 else nan,
        told_s=collector.quality.seconds,
        silent_s=collector.quality.silent_s,
        quality={state.value: collector.quality.spells(state.value) for state in HeaveState},
        reasons=tuple(
            ReasonHeld(
                text=collector.reason_texts.get(kind, kind),
                varies=kind in collector.varied,
                held=collector.reasons.spells(kind),
            )
            for kind in collector.reasons.names
        ),
        laser_states={name: collector.laser_states.spells(name) for name in collector.laser_states.names},
        corrections={name: collector.corrections.spells(name) for name in collector.corrections.names},
        realtime={
            **by_state,
            SETTLED: collector.settled_realtime.statistics(),
            EVERYWHERE: collector.all_realtime.statistics(),
        },
        delayed_std_rms_m=collector.moments["delayed_std"].rms,
        expected_nees=collector.expected_nees.mean,
        independent_errors=compared / independent_s if independent_s > 0.0 else nan,
        reference_mru=collector.reference_mru.statistics(),
        laser={
            **laser_by_state,
            SETTLED: collector.settled_laser.statistics(),
            EVERYWHERE: collector.all_laser.statistics(),
        },
        forecasts=tuple(
            HorizonErrors(horizon_s=horizon_s, errors=errors.statistics())
            for horizon_s, errors in zip(layout.forecasts_s, collector.forecasts, strict=True)
        ),
        rock={
            axis: tuple(
                HorizonErrors(horizon_s=horizon_s, errors=errors.statistics())
                for horizon_s, errors in zip(layout.rock_s, collector.rock[axis], strict=True)
            )
            for axis in AXES
        },
        roll_std_deg=collector.moments["roll"].std,
        pitch_std_deg=collector.moments["pitch"].std,
        sea=_sea(collector),
        points=tuple(
            PointFound(
                name=name,
                significant_height_m=4.0 * moments.std,
                lowest_m=moments.least,
                highest_m=moments.most,
                claimed_rms_m=stds.rms,
            )
            for name, moments, stds in zip(layout.points, collector.point_moments, collector.point_stds, strict=True)
        ),
        columns=tuple(column.health() for column in collector.columns.values()),
        faults={f"{device}: {fault.value}": count for (device, fault), count in collector.faults.most_common()},
        learned=Learned(
            lead_s=learned.lead_s,
            learned_lead_s=learned.lead_learned_s,
            gain=learned.gain_learned,
            comparisons=learned.lead_comparisons,
            laser_constant_m=learned.laser_constant_m,
            correction_rms_m=collector.moments["correction"].rms,
            trainings=summary.trainings,
            fits=summary.fits,
            failure=summary.failure,
            spikes=learned.spikes,
            rejected=learned.rejected,
            out_of_order=learned.out_of_order,
        ),
    )


def _sea(collector: Collector) -> Sea:
    heave_height_m, delayed_height_m = (4.0 * collector.moments[name].std for name in ("heave", "delayed"))
    seas = [one.sea for one in collector.sea]
    if not seas:
        return Sea(heave_height_m=heave_height_m, delayed_height_m=delayed_height_m)
    height = np.array([sea.significant_height_m for sea in seas])
    period = np.array([sea.peak_period_s for sea in seas])
    shaken = max(seas, key=lambda sea: max((one.rms_mps2 for one in sea.vibration), default=0.0))
    last = seas[-1]
    return Sea(
        fits=len(seas),
        significant_height_m=float(np.median(height)),
        least_height_m=float(height.min()),
        greatest_height_m=float(height.max()),
        peak_period_s=float(np.median(period)),
        shortest_peak_period_s=float(period.min()),
        longest_peak_period_s=float(period.max()),
        mean_period_s=float(np.median([sea.mean_period_s for sea in seas])),
        is_still=last.is_still,
        systems=" and ".join(
            f"{system.kind} of {system.significant_height_m:.2f} m and {system.peak_period_s:.1f} s"
            for system in last.systems
        ),
        vibration=vibration_in_words(shaken.vibration),
        noise_mps2_rthz=float(np.median([sea.noise_mps2_rthz for sea in seas])),
        bias_walk_mps2_rts=float(np.median([sea.bias_walk_mps2_rts for sea in seas])),
        heave_height_m=heave_height_m,
        delayed_height_m=delayed_height_m,
    )


# ---- the configuration -----------------------------------------------------------------------------------------------

USED = ("heave", "laser", "correction", "rock", "hull", "attitude", "reference_mru", "quiet", "point", "compensation")
"""Tables that change what a replay computes."""


def keys(config: Config) -> dict[str, object]:
    """Every key of the tables that a replay uses, by its path."""
    found: dict[str, object] = {}

    def walk(path: str, value: object) -> None:
        if isinstance(value, dict):
            for key, part in value.items():
                walk(f"{path}.{key}", part)
        elif isinstance(value, list | tuple) and value and all(isinstance(part, dict) for part in value):
            for i, part in enumerate(value):
                walk(f"{path}[{i}]", part)
        else:
            found[path] = value

    for table in USED:
        walk(table, msgspec.to_builtins(getattr(config, table)))
    return found


def changed_keys(config: Config) -> dict[str, object]:
    """Those that are not at their default."""
    default = keys(type(config)())
    nothing = object()
    return {path: value for path, value in keys(config).items() if default.get(path, nothing) != value}


# ---- in words --------------------------------------------------------------------------------------------------------


def in_words(found: Findings) -> list[str]:
    """The report in some sentences: what the sea was, how well what was known, and what was wrong for how long."""
    if found.frames == 0:
        return ["The recording has no sample of the vertical acceleration: there is nothing to report."]
    return [*_sea_in_words(found), *_heave_in_words(found), *_ahead_in_words(found), *_wrong_in_words(found)]


def _sea_in_words(found: Findings) -> list[str]:
    sea = found.sea
    whole = duration(found.duration_s)
    if sea.fits == 0:
        return [f"{whole} of motion, in which no sea could be fitted to the acceleration: there is no heave."]
    if sea.is_still:
        return [f"{whole} of a still ship: no motion above the noise of the sensor."]
    text = (
        f"{whole} in a sea of {sea.significant_height_m:.2f} m significant height of the heave "
        f"({sea.least_height_m:.2f} to {sea.greatest_height_m:.2f} m over {sea.fits} fits), "
        f"peak period {sea.peak_period_s:.1f} s"
    )
    text += f"; at the end {sea.systems}." if sea.systems else "."
    return [text, *([f"On top of it {sea.vibration}."] if sea.vibration else [])]


def _heave_in_words(found: Findings) -> list[str]:
    settled = found.realtime[SETTLED]
    words = []
    if settled.count:
        sea_m = 0.25 * found.sea.delayed_height_m
        is_moving = sea_m > 0.0 and not found.sea.is_still
        of_sea = f" ({100.0 * settled.rms / sea_m:.1f} % of the standard deviation of the heave)" if is_moving else ""
        words.append(
            f"Once settled, the real-time heave was within {length(settled.rms)} RMS of the delayed heave{of_sea}, "
            f"where {length(settled.claimed_rms)} was claimed; {_shares(settled)}."
        )
    else:
        words.append("There is no settled heave with a delayed one to compare it with.")
    laser = found.laser[SETTLED]
    if laser.count:
        words.append(
            f"Against {laser.count} readings of the laser it was within {length(laser.rms)} RMS, where "
            f"{length(laser.claimed_rms)} was claimed; {_shares(laser)}."
        )
    elif found.has_laser:
        words.append("No reading of the laser could be compared with the heave.")
    else:
        words.append("There was no laser: nothing but the acceleration itself speaks for or against the heave.")
    mru = found.reference_mru
    if mru.count:
        words.append(
            f"An existing MRU differed from it by {length(mru.rms)} RMS over {mru.count} readings, where the errors of "
            f"both explain {length(mru.claimed_rms)}; {_shares(mru)}. Either may be the one that is right."
        )
    return words


def _shares(errors: ErrorStatistics) -> str:
    return (
        f"{100.0 * errors.within[0]:.1f} % of the errors lie within one claimed standard deviation, "
        f"{100.0 * errors.within[1]:.1f} % within two (a right claim: 68.3 and 95.4 %)"
    )


def _ahead_in_words(found: Findings) -> list[str]:
    words = []
    ahead = [one for one in found.forecasts if one.errors.count]
    if ahead:
        parts = [
            f"{length(one.errors.rms)} at {one.horizon_s:g} s (claimed {length(one.errors.claimed_rms)})"
            for one in _some(ahead)
        ]
        words.append(f"Forecasts of the heave were off by {_listed(parts)} RMS.")
    for axis, std in (("roll", found.roll_std_deg), ("pitch", found.pitch_std_deg)):
        ahead = [one for one in found.rock[axis] if one.errors.count]
        if ahead:
            parts = [f"{one.errors.rms:#.2g}° at {one.horizon_s:g} s" for one in _some(ahead)]
            words.append(f"{axis.capitalize()} ({std:#.2g}° RMS) was predicted to within {_listed(parts)}.")
    if not any(one.errors.count for axis in AXES for one in found.rock[axis]):
        words.append("There were no angles with which predictions of roll and pitch could be compared.")
    return words


def _some(ahead: Sequence[HorizonErrors]) -> list[HorizonErrors]:
    """Three at most: about half a second, about one, and the furthest."""
    near = [min(ahead, key=lambda one: abs(one.horizon_s - wanted)) for wanted in (0.5, 1.0)]
    return list(dict.fromkeys([*near, ahead[-1]]))


def _wrong_in_words(found: Findings) -> list[str]:
    if found.told_s <= 0.0:
        return []
    shares = ", ".join(
        f"{state} {100.0 * found.share(spells):.1f} % ({duration(spells.seconds)})"
        for state, spells in found.quality.items()
        if spells.spells
    )
    words = [f"The heave was {shares} of the time."]
    if found.silent_s > 0.0:
        words.append(f"For {duration(found.silent_s)} there were no samples at all.")
    named = [reason for reason in found.reasons if not reason.text.startswith("settling")]
    if named:
        worst = [f"“{reason.text}” for {duration(reason.held.seconds)}" for reason in named[:4]]
        more = len(named) - len(worst)
        words.append(f"Frames said {_listed(worst)}{f', and {more} more' if more else ''}.")
    else:
        words.append("But for settling, no frame gave a reason to doubt it.")
    return words


def _listed(parts: Sequence[str]) -> str:
    *others, last = parts
    return f"{', '.join(others)} and {last}" if others else last


def duration(seconds: float) -> str:
    """``2 h 05 min``, ``3 min 20 s``, ``12.5 s``."""
    if not isfinite(seconds):
        return "—"
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def length(metres: float) -> str:
    """``3.2 mm``, ``41.4 mm``, ``25.3 cm`` or ``1.25 m``."""
    if not isfinite(metres):
        return "—"
    size = abs(metres)
    if size < 0.1:
        return f"{1000.0 * metres if size >= 5e-5 else 0.0:.1f} mm"
    return f"{100.0 * metres:.1f} cm" if size < 1.0 else f"{metres:.2f} m"
