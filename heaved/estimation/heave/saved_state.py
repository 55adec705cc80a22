"""What a pipeline remembers over a restart, and what a state of an earlier run cannot hold, so that none is used."""

from __future__ import annotations

from math import hypot, isfinite, pi
from typing import Final

import msgspec
import numpy as np

from heaved.estimation.common.bounds import HEAVE_M
from heaved.estimation.heave.laser import axes as laser_axes
from heaved.estimation.heave.laser.correction import SavedNetwork
from heaved.estimation.heave.laser.placement import SavedPlace
from heaved.estimation.heave.sea.model import SeaModel, heave_std
from heaved.estimation.hull import tuning as hull_tuning
from heaved.estimation.hull.remembered import SavedHull, square
from heaved.estimation.imu.attitude_memory import SavedAttitudeError


class Plausible(msgspec.Struct, frozen=True, kw_only=True):
    """What an estimator can have learned: ranges, both ends included."""

    frequency_hz: tuple[float, float] = (0.01, 2.0)
    """Of waves that move a vessel, and well beyond: the fits stay within 0.025..0.6 Hz."""
    damping: tuple[float, float] = (1e-3, 2.0)
    """Of a resonator; the fits stay within 0.05..1."""
    level_m2phz: tuple[float, float] = (0.0, 1e6)
    """Of a heave spectrum; a sea of 15 m significant height has some 300 m2/Hz."""
    shaken_hz: tuple[float, float] = (0.05, 100.0)
    """Of what shakes the accelerometer; the fits look above 0.7 Hz, and up to half the rate of the means."""
    shaken_damping: tuple[float, float] = (1e-3, 0.999)
    """Of such a resonance."""
    shaken_psd: tuple[float, float] = (0.0, 1e6)
    """Of such a resonance, (m/s2)2/Hz."""
    noise_psd: tuple[float, float] = (1e-15, 1e3)
    """Of an accelerometer, (m/s2)2/Hz: from far below the best to one that is of no use."""
    bias_mps2: tuple[float, float] = (-5.0, 5.0)
    """Of an accelerometer."""
    bias_std_mps2: tuple[float, float] = (0.0, 5.0)
    """Of that."""
    bias_walk_psd: tuple[float, float] = (0.0, 10.0)
    """Of its bias, (m/s2)2/s."""
    lead_s: float = 60.0
    """Far beyond what can be configured as a limit, either way."""
    gain: tuple[float, float] = (0.1, 10.0)
    """Of the accelerometer, as the laser has shown it."""
    step_s: tuple[float, float] = (1e-3, 10.0)
    """Between the inputs of a correction."""
    length_m: tuple[float, float] = (0.0, 1e3)
    """Of a spread or a limit of the heave."""
    turned_rad: tuple[float, float] = (-3.1416, 3.1416)
    """Of a rotation vector: half a turn and no more."""
    turned_std_rad: tuple[float, float] = (1e-9, 0.5)
    """Of what is known of such a turn."""
    scale: tuple[float, float] = (-0.5, 0.5)
    """Of the difference of the scales of two gyros,"""
    scale_std: tuple[float, float] = (1e-9, 0.5)
    """and of what is known of it."""
    flexure: tuple[tuple[float, float], ...] = (*hull_tuning.TUNING.fit_bounds[:3], (1e-15, 1.0))
    """Of sigma rad, mu 1/s, lambda rad/s: what the fit stays within; and of the noise, rad/s per sample."""
    lean_per_s: tuple[float, float] = (0.0, 10.0)
    """Of an attitude sensor, one over its time constant."""
    attitude_late_s: tuple[float, float] = (-5.0, 5.0)
    """Of such a sensor against the accelerometers."""
    attitude_variance: tuple[float, float] = (0.0, 25.0)
    """Of what is known of the two, (1/s)2 and s2."""
    place_m: tuple[float, float] = (-1e3, 1e3)
    """Of a gauge, from the IMU or from where it is configured."""
    beam: tuple[float, float] = (-1e3, 1e3)
    """Of the parts of its direction,"""
    least_upright: float = 0.01
    """and its upright part over the largest, at the least."""
    unconfirmed_s: tuple[float, float] = (0.0, 1e9)
    """Since something was last known to be so."""
    most_lines: int = 64
    """Chains of a model, or frequencies of an observer."""


PLAUSIBLE: Final = Plausible()


class SavedState(msgspec.Struct, frozen=True, kw_only=True):
    """What a restart remembers of a pipeline."""

    frequencies_hz: tuple[float, ...] = ()
    """Of the harmonic observer."""
    sea: SeaModel | None = None
    bias_mps2: float | None = None
    """Of the accelerometer, upwards, and"""
    bias_std_mps2: float = 1.0
    """how well it was known."""
    lead_learned_s: float | None = None
    gain_learned: float = 1.0
    correction: SavedNetwork | None = None
    hull: SavedHull | None = None
    attitude_error: SavedAttitudeError | None = None
    laser_place: SavedPlace | None = None
    axes: laser_axes.SavedAxes | None = None
    """Of the accelerometers, as a laser has shown them."""


def check(state: SavedState) -> None:
    """Whether it holds numbers such as a pipeline has learned; that they fit one is seen when it takes them.

    Raises:
        ValueError: one cannot be what an estimator has learned; says which.
    """
    _within("frequency of the observer", state.frequencies_hz, PLAUSIBLE.frequency_hz, "Hz")
    if state.sea is not None:
        _check_sea(state.sea)
    if state.bias_mps2 is not None:
        _within("bias of the accelerometer", (state.bias_mps2,), PLAUSIBLE.bias_mps2, "m/s2")
        _within("uncertainty of that bias", (state.bias_std_mps2,), PLAUSIBLE.bias_std_mps2, "m/s2")
    if state.lead_learned_s is not None:
        _within("learned lead", (state.lead_learned_s,), (-PLAUSIBLE.lead_s, PLAUSIBLE.lead_s), "s")
    _within("learned gain", (state.gain_learned,), PLAUSIBLE.gain, "")
    correction = state.correction
    if correction is not None:
        _within("spacing of the correction's inputs", (correction.step_s,), PLAUSIBLE.step_s, "s")
        _within("heave that the correction was trained on", (correction.input_std_m,), PLAUSIBLE.length_m, "m")
        _within("limit of the correction", (correction.limit_m,), PLAUSIBLE.length_m, "m")
        hz = correction.omega_radps / (2.0 * pi)
        _within("wave frequency that the correction was trained on", (hz,), (0.0, PLAUSIBLE.frequency_hz[1]), "Hz")
    if state.hull is not None:
        _check_hull(state.hull)
    if state.laser_place is not None:
        _check_place(state.laser_place)
    if state.axes is not None:
        if len(state.axes.weights) != laser_axes.COUNT:
            raise ValueError(f"{len(state.axes.weights)} leaks of the accelerometers' axes, not {laser_axes.COUNT}")
        most = laser_axes.TUNING.most
        _within("leak of the accelerometers' axes", state.axes.weights, (-most, most), "")
        _within("time since these were last confirmed", (state.axes.unconfirmed_s,), PLAUSIBLE.unconfirmed_s, "s")
    if (error := state.attitude_error) is not None:
        _within("lean of the attitude", (error.lean_per_s,), PLAUSIBLE.lean_per_s, "1/s")
        _within("lateness of the attitude", (error.late_s,), PLAUSIBLE.attitude_late_s, "s")
        of_lean, of_both, of_lateness = error.covariance
        _within("variance of the attitude's errors", (of_lean, of_lateness), PLAUSIBLE.attitude_variance, "")
        # What is added to it for the time between two runs is larger than this.
        if not of_both * of_both <= of_lean * of_lateness + 1e-12:
            raise ValueError("covariance of the attitude's errors is not positive")
        _within("time since these were last confirmed", (error.unconfirmed_s,), PLAUSIBLE.unconfirmed_s, "s")


def _check_place(saved: SavedPlace) -> None:
    for geometry in (saved.configured, saved.geometry):
        at = geometry.forward_m, geometry.port_m, geometry.up_m
        _within("place of the laser", at, PLAUSIBLE.place_m, "m")
        _within("beam of the laser", geometry.beam, PLAUSIBLE.beam, "")
        if not abs(geometry.beam[2]) > PLAUSIBLE.least_upright * max(map(abs, geometry.beam)):
            raise ValueError("beam of the laser is level")
    _within("place where the laser was found", (saved.place.ahead_m, saved.place.port_m), PLAUSIBLE.place_m, "m")
    stds = saved.place.ahead_std_m, saved.place.port_std_m
    _within("uncertainty of the place of the laser", stds, PLAUSIBLE.length_m, "m")
    _within("time since the laser was last seen there", (saved.unconfirmed_s,), PLAUSIBLE.unconfirmed_s, "s")


def _check_hull(hull: SavedHull) -> None:
    _within("deformation of the hull", hull.rotation_rad, PLAUSIBLE.turned_rad, "rad")
    _within("length of that rotation", (hypot(*hull.rotation_rad),), PLAUSIBLE.turned_rad, "rad")
    _within("scale of the gyros", hull.scale, PLAUSIBLE.scale, "")
    P = square(hull.covariance)
    _within("covariance of the hull", tuple(P.ravel().tolist()), (-1.0, 1.0), "")
    std = tuple(np.sqrt(np.maximum(np.diag(P), 0.0)).tolist())
    _within("uncertainty of the deformation of the hull", std[:3], PLAUSIBLE.turned_std_rad, "rad")
    _within("uncertainty of the scale of the gyros", std[3:], PLAUSIBLE.scale_std, "")
    # Of correlations, for rotations and scales are of different sizes.
    if not float(np.linalg.eigvalsh(P / np.outer(std, std))[0]) > -1e-9:
        raise ValueError("covariance of the hull is not positive definite")
    _within("time since the deformation was last confirmed", (hull.unconfirmed_s,), PLAUSIBLE.unconfirmed_s, "s")
    if (flexure := hull.flexure) is not None:
        parts = (flexure.std_rad, flexure.mu_radps, flexure.lambda_radps, flexure.noise_radps)
        for name, values, limits in zip(("sigma", "mu", "lambda", "noise"), parts, PLAUSIBLE.flexure, strict=True):
            _within(f"{name} of the flexure of the hull", values, (0.999 * limits[0], 1.001 * limits[1]), "")


def _check_sea(sea: SeaModel) -> None:
    components = len(sea.frequency_hz)
    if not components == len(sea.damping) == len(sea.level_m2phz):
        lengths = f"{components} frequencies, {len(sea.damping)} dampings, {len(sea.level_m2phz)} levels"
        raise ValueError(f"a sea of {lengths}")
    _within("number of resonators in a chain of the sea", (sea.stages,), (4, PLAUSIBLE.most_lines), "")
    _within("frequency of the sea", sea.frequency_hz, PLAUSIBLE.frequency_hz, "Hz")
    _within("damping of the sea", sea.damping, PLAUSIBLE.damping, "")
    _within("level of the sea", sea.level_m2phz, PLAUSIBLE.level_m2phz, "m2/Hz")
    _within("noise of the accelerometer", (sea.noise_psd,), PLAUSIBLE.noise_psd, "(m/s2)2/Hz")
    _within("bias walk of the accelerometer", (sea.bias_walk_psd,), PLAUSIBLE.bias_walk_psd, "(m/s2)2/s")
    shaken = sea.resonances
    _within(
        "frequency of what shakes the accelerometer",
        tuple([one.frequency_hz for one in shaken]),
        PLAUSIBLE.shaken_hz,
        "Hz",
    )
    _within(
        "damping of what shakes the accelerometer", tuple([one.damping for one in shaken]), PLAUSIBLE.shaken_damping, ""
    )
    _within(
        "level of what shakes the accelerometer",
        tuple([one.level for one in shaken]),
        PLAUSIBLE.shaken_psd,
        "(m/s2)2/Hz",
    )
    if sum(sea.level_m2phz) > 0.0 and not heave_std(sea) <= HEAVE_M:
        raise ValueError(f"a sea that heaves more than {HEAVE_M:g} m RMS")


def _within(what: str, values: tuple[float, ...], limits: tuple[float, float], unit: str) -> None:
    if len(values) > PLAUSIBLE.most_lines:
        raise ValueError(f"{len(values)} values for the {what}")
    low, high = limits
    for value in values:
        if not (isfinite(value) and low <= value <= high):
            raise ValueError(f"{what} {value:g} {unit}".rstrip() + f" lies outside {low:g}..{high:g}")
