"""The standard scenarios: records with their truth, the least error possible on each, and where it is to be scored.

Simulated: wave trains ``T1 T2 T3``, irregular seas ``S4 S5 S6 S6S SL``, a sea that grows and falls ``SX``, a still
ship ``S0``; each through sensor A or B, with the tilt known in three ways; and, where they are named, seas with
directions such as ``S6S-bow-0.8``. Real (where the records are present):
``Hebrides``, half-hours of a wave-rider, and ``palmer``, a ship under way, both through a simulated sensor; ``flume``
and ``static``, real accelerometers on a model hull and at rest.

Waves, sensor errors and the moment at which the record begins are drawn from three seeds that have nothing to do with
each other; all estimators get the same three.
"""

from __future__ import annotations

from functools import lru_cache
from math import hypot, inf, isinf, nan, sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import msgspec
import numpy as np
import recordings
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.signal import fftconvolve, welch

from evidence.limits import (
    DriftLimit,
    causal_heave_filter,
    causal_heave_limit,
    drift_limit,
    noncausal_heave_limit,
)
from heaved.simulate.directional import directional
from heaved.simulate.seaway import HIGHEST_HZ, RAMPS, SEAS, STILL, TRAINS, heave_spectrum, seaway
from heaved.simulate.sensors import REGISTER_STEPS, ImuModel, Recording, imu_model, record
from heaved.simulate.shaking import NONE, Shake, shake_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

Array = NDArray[np.float64]
Tilt = Literal["none", "exact", "noisy"]

DATA: Final = Path(__file__).resolve().parents[3] / "shared" / "data"
REAL: Final[Mapping[str, str]] = {
    "Hebrides": "hebrides_waverider/*.raw",
    "palmer": "palmer/*.csv",
    "flume": "ntnu_flume/*.csv",
    "static": "microswift/*.dat",
}
"""Scenario -> its files under the data folder."""
SIMULATED: Final = (*TRAINS, *SEAS, STILL)
NAMES: Final = (*SIMULATED, *REAL)
HORIZONS_S: Final = (0.5, 1.0, 2.0, 5.0)
"""Forecasts that are scored."""
DURATION_S: Final = 900.0
LONGER_S: Final = {"SX": 1860.0}
"""Nine minutes after the sea has fallen."""
DURATIONS_S: Final = {name: LONGER_S.get(name, DURATION_S) for name in SIMULATED}
STARTS_WITHIN_S: Final = 3600.0
FLUME_FROUDE: Final = 64.0
FLUME_UNDER_WAY: Final = 0.7
"""A flume run is scored where its RMS over 20 s is at least this share of the greatest: while the waves run."""
GRID_STEP_HZ: Final = 10.0 / 2**15
"""Of the frequencies of the limits: four times as much changes them by less than 1 %, and a line is some 65 steps wide
(:data:`heaved.simulate.shaking.LINE_WIDTH_HZ`)."""


class Seeds(msgspec.Struct, frozen=True, kw_only=True):
    """What is drawn, each from a seed of its own. Of a real record ``waves`` is the number of its file, from 1."""

    waves: int
    noise: int
    start: int


def triplet(number: int) -> Seeds:
    """The n-th triplet, from 1."""
    return Seeds(waves=number, noise=1000 + number, start=2000 + number)


class Setting(msgspec.Struct, frozen=True, kw_only=True):
    """How a scenario is run and scored."""

    sensor: str = "A"
    tilt: Tilt = "noisy"
    """"none": the vessel neither rolls nor pitches; "exact": it does, and its attitude is known without error."""
    rate_hz: float = 20.0
    laser: str = "off"
    shake: str = NONE
    """One of :data:`heaved.simulate.shaking.SHAKES`, or nothing."""
    duration_s: float | None = None
    """None: the scenario's own."""
    scored_from_s: float = 300.0


class Segment(msgspec.Struct, frozen=True):
    """A part of a changing sea, scored by itself."""

    name: str
    start_s: float
    end_s: float


class Limits(msgspec.Struct, frozen=True, kw_only=True):
    """Least RMS errors, m; nan: the sea has no continuous spectrum, or not one only."""

    causal_m: float = nan
    noncausal_m: float = nan
    forecast_m: dict[float, float] = msgspec.field(default_factory=lambda: dict.fromkeys(HORIZONS_S, nan))
    """Horizon (s) -> RMS error (m)."""
    weights: Array = msgspec.field(default_factory=lambda: np.empty(0))
    """Of the filter that reaches the first; none: it is not known."""
    lies: float = 0.0
    """Share of the record in which the best of all estimators is off by more than 4 of its own standard deviations,
    because something has begun that cannot be seen yet."""


class Case(msgspec.Struct, frozen=True, kw_only=True):
    """One record to run estimators on."""

    scenario: str
    seeds: Seeds
    setting: Setting
    recording: Recording
    period_s: float
    """What the Kalman filter is told."""
    limits: Limits
    start_s: float
    end_s: float
    """Scored from here until there."""
    local_sigma_m: Array
    """(n,) standard deviation of true heave about each instant."""
    segments: tuple[Segment, ...] = ()
    optical_std_m: float = nan
    """Standard deviation of heave by another instrument while scored: for amplitude alone."""
    from_start: bool = True
    """The sea is there from the first sample, so that settling can be told; a real one is faded in."""

    @property
    def rate_hz(self) -> float:
        """Of the samples as they are."""
        t = self.recording.t_s
        return float((t.size - 1) / (t[-1] - t[0]))

    @property
    def scored(self) -> NDArray[np.bool_]:
        """(n,) instants that are scored."""
        t = self.recording.t_s
        return (t >= self.start_s) & (t < self.end_s)


def files(scenario: str, folder: Path | None = None) -> list[Path]:
    """Records of a real scenario; none where they are absent."""
    return sorted((DATA if folder is None else folder).glob(REAL[scenario]))


def build(scenario: str, seeds: Seeds, setting: Setting, folder: Path | None = None) -> Case:
    """Make the record of a scenario.

    Raises:
        ValueError: unknown scenario, sensor, tilt, laser pattern or shake, no such record, or too short a one to score.
        OSError: a real record cannot be read.
    """
    if scenario not in NAMES and directional(scenario) is None:
        raise ValueError(f"unknown scenario {scenario!r}: choose from {', '.join(NAMES)}")
    if scenario not in REAL:
        case = _simulated(scenario, seeds, setting)
    else:
        found = files(scenario, folder)
        if not 1 <= seeds.waves <= len(found):
            raise ValueError(f"{scenario}: there is no record {seeds.waves} among the {len(found)} in {folder or DATA}")
        make: Callable[[Path, str, Seeds, Setting], Case] = {
            "flume": _flume,
            "static": _static,
        }.get(scenario, _at_sea)
        if setting.shake != NONE and make is not _at_sea:
            raise ValueError(f"{scenario}: its accelerometer is a real one, which nothing can shake any more")
        case = make(found[seeds.waves - 1], scenario, seeds, setting)
    if case.end_s < case.start_s + 20.0:
        raise ValueError(f"a record of {case.end_s:g} s cannot be scored from {case.start_s:g} s on: give more")
    return case


# --- simulated -------------------------------------------------------------------------------------------------------


def _simulated(scenario: str, seeds: Seeds, setting: Setting) -> Case:
    start_s = float(np.random.default_rng(seeds.start).uniform(0.0, STARTS_WITHIN_S))
    sea = seaway(scenario, seeds.waves, attitude=setting.tilt != "none", start_s=start_s)
    asked = directional(scenario)
    name = scenario if asked is None else asked.sea
    duration_s = DURATIONS_S[name] if setting.duration_s is None else setting.duration_s
    recording = record(
        sea,
        duration_s + HORIZONS_S[-1],  # so that the last forecasts fall due
        imu_rate_hz=setting.rate_hz,
        sensor=_sensor(setting),
        laser=setting.laser,
        shake=setting.shake,
        seed=seeds.noise,
    )
    steady = name in SEAS and name not in RAMPS
    limits = sea_limits(name, setting.sensor, setting.rate_hz, setting.shake) if steady else Limits()
    if steady and shake_of(setting.shake).drift is not None:
        limits = _drifting(limits, name, setting, duration_s)
    return Case(
        scenario=scenario,
        seeds=seeds,
        setting=setting,
        recording=recording,
        period_s=TRAINS[name].period_s if name in TRAINS else SEAS.get(name, SEAS["S6"])[0].tp_s,
        limits=limits,
        start_s=setting.scored_from_s,
        end_s=duration_s,
        local_sigma_m=sea.heave_std_m * sea.envelope(recording.t_s),
        segments=segments_of(scenario, setting.scored_from_s, duration_s),
    )


def _sensor(setting: Setting) -> ImuModel:
    if setting.tilt not in ("none", "exact", "noisy"):
        raise ValueError(f"tilt must be none, exact or noisy, not {setting.tilt!r}")
    model = imu_model(setting.sensor)
    # A level ship's sensor is noisy, too: angles that never change beside a deck that sways are those of none.
    return msgspec.structs.replace(model, attitude_noise_rad=0.0) if setting.tilt == "exact" else model


def segments_of(scenario: str, from_s: float, end_s: float) -> tuple[Segment, ...]:
    """The parts of a sea that grows and falls again, or of a turn; none for the others, nor of a record that ends
    before it has.
    """
    asked = directional(scenario)
    if asked is not None and asked.turn is not None:
        begins_s, turned_s = asked.turn.start_s, asked.turn.start_s + asked.turn.duration_s
        parts: tuple[Segment, ...] = (
            Segment("before", from_s, begins_s),
            Segment("turning", begins_s, turned_s),
            Segment("after", turned_s, end_s),
        )
        return tuple(part for part in parts if part.start_s < part.end_s <= end_s)
    if scenario not in RAMPS:
        return ()
    growth, fall = RAMPS[scenario]
    grown, fallen = growth.start_s + growth.duration_s, fall.start_s + fall.duration_s
    parts = (
        Segment("before", from_s, growth.start_s),
        Segment("growing", growth.start_s, grown),
        Segment("recovery", grown, grown + 120.0),
        Segment("grown", grown + 120.0, fall.start_s),
        Segment("falling", fall.start_s, fallen),
        Segment("first minute after", fallen, fallen + 60.0),
        Segment("second and third", fallen + 60.0, fallen + 180.0),
        Segment("then", fallen + 180.0, end_s),
    )
    return tuple(part for part in parts if part.start_s < part.end_s <= end_s)


@lru_cache
def sea_limits(scenario: str, sensor: str, rate_hz: float, shake: str | Shake = NONE) -> Limits:
    """Least errors on a steady irregular sea of the simulator."""
    return limits_of(lambda f: simulated_spectrum(scenario, f), sensor, rate_hz, shake)


def simulated_spectrum(scenario: str, f_hz: Array) -> Array:
    """One-sided spectrum of true heave, m2/Hz, as it is in the record: the simulator has no waves above an end.

    That end counts: what a forecast of a second or two cannot know is in the tail (S4, 1 s: 4.7 % of the standard
    deviation with it as it is, 6.2 % were it endless).
    """
    return np.where(f_hz <= HIGHEST_HZ[scenario], heave_spectrum(scenario, f_hz), 0.0)


def limits_of(
    spectrum: Callable[[Array], Array], sensor: str | ImuModel, rate_hz: float, shake: str | Shake = NONE
) -> Limits:
    """Least errors from this sensor's accelerometer alone, for a one-sided heave spectrum (m2/Hz of Hz).

    Errors of the attitude are left out: what they add is the price of the tilt. Vibration counts as the coloured noise
    that it is; a drift, a turn and a list are left out.
    """
    f = grid(rate_hz)
    heave, noise = spectrum(f), accelerometer_noise(f, sensor, rate_hz, shake)
    return Limits(
        weights=causal_heave_filter(f, heave, noise),
        causal_m=causal_heave_limit(f, heave, noise),
        noncausal_m=noncausal_heave_limit(f, heave, noise),
        forecast_m={horizon: causal_heave_limit(f, heave, noise, -horizon) for horizon in HORIZONS_S},
    )


def limit_here_m(case: Case) -> float:
    """RMS error on this very record, while it is scored, of the filter that reaches the limit: of one that knows both
    spectra, the bias and the attitude; nan: there is none.

    Ten minutes hold some tens of the waves that the error of heave consists of, and records with the same seeds have
    the same noise: by as much as this is off from the limit, any error is by chance.
    """
    shake, weights = shake_of(case.setting.shake), case.limits.weights
    model = imu_model(case.setting.sensor)
    is_stationary = shake.drift is None and shake.turn is None and shake.list is None
    if not (weights.size and is_stationary and isinf(model.bandwidth_hz) and model.scale == 1.0):
        return nan
    r, angles = case.recording, case.recording.truth
    mast = np.sin(angles.roll_rad) * r.ay_mps2 + np.cos(angles.roll_rad) * r.az_mps2
    up = np.sin(angles.pitch_rad) * r.ax_mps2 + np.cos(angles.pitch_rad) * mast
    known = np.isfinite(up)
    up = np.where(known, up - np.mean(up[known]), 0.0)
    error = fftconvolve(up, weights)[: up.size] - angles.heave_m
    return float(np.sqrt(np.mean(error[case.scored] ** 2)))


def _drifting(limits: Limits, scenario: str, setting: Setting, duration_s: float) -> Limits:
    """The limits of a record in which the bias drifts: its rate changes at the beginning of that and at its end."""
    drift = shake_of(setting.shake).drift
    assert drift is not None
    changes_s = (drift.start_s, drift.start_s + drift.duration_s)
    scored = sum(setting.scored_from_s <= change_s < duration_s for change_s in changes_s)
    rate_mps3 = drift.size_mps2 / drift.duration_s
    each = _drift_limit(scenario, setting.sensor, setting.rate_hz, setting.shake, rate_mps3)
    added_m2 = scored * each.added_m2s / (duration_s - setting.scored_from_s)
    return msgspec.structs.replace(
        limits, causal_m=hypot(limits.causal_m, sqrt(added_m2)), lies=scored * each.lies_s / duration_s
    )


@lru_cache
def _drift_limit(scenario: str, sensor: str, rate_hz: float, shake: str | Shake, rate_mps3: float) -> DriftLimit:
    f = grid(rate_hz)
    noise = accelerometer_noise(f, sensor, rate_hz, shake)
    return drift_limit(f, simulated_spectrum(scenario, f), noise, rate_mps3)


def grid(rate_hz: float) -> Array:
    """Frequencies from 0 to half the rate at which the limits are computed."""
    return np.linspace(0.0, rate_hz / 2.0, 1 + 2 * round(rate_hz / 4.0 / GRID_STEP_HZ))


def accelerometer_noise(f_hz: Array, sensor: str | ImuModel, rate_hz: float, shake: str | Shake = NONE) -> Array:
    """One-sided noise density (m/s2)2/Hz referred to the true acceleration, on a grid from 0.

    White, random walk of the bias (2 q^2 / omega^2; at 0 as in the first bin), rounding to registers, vibration as it
    folds; scale and low-pass are undone, which raises the noise as they lower the signal.
    """
    model = imu_model(sensor)
    omega = 2.0 * np.pi * np.maximum(f_hz, f_hz[1])
    noise = model.noise_mps2_rthz**2 + 2.0 * model.bias_walk_mps2_rts**2 / omega**2
    if model.sixteen_bit:
        noise = noise + REGISTER_STEPS[0] ** 2 / 12.0 / (rate_hz / 2.0)
    noise = noise + shake_of(shake).density(f_hz, rate_hz, model.bandwidth_hz)
    through = model.scale**2 / (1.0 + (f_hz / model.bandwidth_hz) ** 4)
    return np.asarray(noise / through, dtype=np.float64)


# --- real ------------------------------------------------------------------------------------------------------------


def _at_sea(path: Path, scenario: str, seeds: Seeds, setting: Setting) -> Case:
    """A real motion through a simulated sensor; limits and period from the record's own spectrum."""
    make, band = {
        "Hebrides": (recordings.hebrides, recordings.BUOY_BAND_HZ),
        "palmer": (recordings.palmer, recordings.SHIP_BAND_HZ),
    }[scenario]
    sensor = _sensor(setting)
    recording = make(
        path, rate_hz=setting.rate_hz, sensor=sensor, laser=setting.laser, shake=setting.shake, seed=seeds.noise
    )
    t, heave = recording.t_s, recording.truth.heave_m
    end_s = min(inf if setting.duration_s is None else setting.duration_s, float(t[-1]) - recordings.FADE_S)
    inside = (t >= recordings.FADE_S) & (t < end_s)
    f, density = welch(heave[inside], setting.rate_hz, nperseg=round(100.0 * setting.rate_hz))
    density = np.where((f >= band[0]) & (f <= band[1]), density, 0.0)
    return _real(
        scenario,
        seeds,
        setting,
        recording,
        period_s=1.0 / float(f[np.argmax(density)]),
        limits=limits_of(lambda at: np.interp(at, f, density), sensor, setting.rate_hz, setting.shake),
        window_s=(setting.scored_from_s, end_s),
    )


def _flume(path: Path, scenario: str, seeds: Seeds, setting: Setting) -> Case:
    """A model hull at the scale of a ship, scored while the wave maker's waves are there."""
    recording = recordings.flume(path, froude=FLUME_FROUDE)
    t, heave = recording.t_s, recording.truth.heave_m
    rate_hz = (t.size - 1) / float(t[-1] - t[0])
    strength = np.sqrt(uniform_filter1d(heave**2, round(20.0 * rate_hz)))
    strong = t[strength >= FLUME_UNDER_WAY * np.max(strength)]
    window = (float(strong[0]), float(strong[-1]))
    scored = (t >= window[0]) & (t < window[1])
    f, density = welch(heave[scored], rate_hz, nperseg=min(heave[scored].size, round(100.0 * rate_hz)))
    optical = recordings.flume_optical(path, froude=FLUME_FROUDE)
    return _real(
        scenario,
        seeds,
        setting,
        recording,
        period_s=1.0 / float(f[np.argmax(density)]),
        limits=Limits(),  # the sensor's noise is not known
        window_s=window,
        optical_std_m=float(np.std(optical[scored])),
    )


def _static(path: Path, scenario: str, seeds: Seeds, setting: Setting) -> Case:
    """A real MEMS IMU that lies still."""
    recording = recordings.microswift(path)
    window = (setting.scored_from_s, float(recording.t_s[-1]))
    return _real(scenario, seeds, setting, recording, period_s=SEAS["S6"][0].tp_s, limits=Limits(), window_s=window)


def _real(
    scenario: str,
    seeds: Seeds,
    setting: Setting,
    recording: Recording,
    *,
    period_s: float,
    limits: Limits,
    window_s: tuple[float, float],
    optical_std_m: float = nan,
) -> Case:
    start_s, end_s = window_s
    recording = _until(recording, end_s + HORIZONS_S[-1])
    scored = (recording.t_s >= start_s) & (recording.t_s < end_s)
    sigma_m = float(np.std(recording.truth.heave_m[scored])) if np.any(scored) else nan
    return Case(
        scenario=scenario,
        seeds=seeds,
        setting=setting,
        recording=recording,
        period_s=period_s,
        limits=limits,
        start_s=start_s,
        end_s=end_s,
        local_sigma_m=np.full(recording.t_s.size, sigma_m),
        optical_std_m=optical_std_m,
        from_start=False,
    )


def _until(recording: Recording, end_s: float) -> Recording:
    """Its part before ``end_s``."""
    kept = recording.t_s < end_s
    truth = {name: getattr(recording.truth, name)[kept] for name in recording.truth.__struct_fields__}
    columns = {name: getattr(recording, name) for name in recording.__struct_fields__ if name != "truth"}
    return Recording(**{name: values[kept] for name, values in columns.items()}, truth=type(recording.truth)(**truth))
