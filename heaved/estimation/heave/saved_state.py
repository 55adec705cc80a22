"""What a state of an earlier run cannot hold, so that none of it is used: pure, and before any of it is."""

from __future__ import annotations

from math import isfinite, pi
from typing import Final

from heaved.estimation.common.bounds import HEAVE_M
from heaved.estimation.heave.laser.correction import Saved
from heaved.estimation.heave.sea.model import SeaModel, heave_std

FREQUENCY_HZ: Final = (0.01, 2.0)
"""Of waves that move a vessel, and well beyond: the fits stay within 0.025..0.6 Hz."""
DAMPING: Final = (1e-3, 2.0)
"""Of a resonator; the fits stay within 0.05..1."""
LEVEL_M2PHZ: Final = (0.0, 1e6)
"""Of a heave spectrum; a sea of 15 m significant height has some 300 m2/Hz."""
SHAKEN_HZ: Final = (0.05, 100.0)
"""Of what shakes the accelerometer; the fits look above 0.7 Hz, and up to half the rate of the beats."""
SHAKEN_DAMPING: Final = (1e-3, 0.999)
SHAKEN_PSD: Final = (0.0, 1e6)
NOISE_PSD: Final = (1e-15, 1e3)
"""Of an accelerometer, (m/s2)2/Hz: from far below the best to one that is of no use."""
BIAS_WALK_PSD: Final = (0.0, 10.0)
"""Of its bias, (m/s2)2/s."""
LEAD_S: Final = 60.0
"""Far beyond what can be configured as a limit, either way."""
GAIN: Final = (0.1, 10.0)
LENGTH_M: Final = (0.0, 1e3)
"""Of a spread or a limit of the heave."""
MOST_LINES: Final = 64
"""Chains of a model, or frequencies of an observer."""


def check(
    *,
    frequencies_hz: tuple[float, ...],
    sea: SeaModel | None,
    lead_s: float | None,
    gain: float,
    correction: Saved | None,
) -> None:
    """Look at every number of a saved state.

    Raises:
        ValueError: one cannot be what an estimator has learned; says which.
    """
    _within("frequency of the observer", frequencies_hz, FREQUENCY_HZ, "Hz")
    if sea is not None:
        _check_sea(sea)
    if lead_s is not None:
        _within("learned lead", (lead_s,), (-LEAD_S, LEAD_S), "s")
    _within("learned gain", (gain,), GAIN, "")
    if correction is not None:
        _within("spacing of the correction's inputs", (correction.step_s,), (1e-3, 10.0), "s")
        _within("heave that the correction was trained on", (correction.input_std_m,), LENGTH_M, "m")
        _within("limit of the correction", (correction.limit_m,), LENGTH_M, "m")
        hz = correction.omega_radps / (2.0 * pi)
        _within("wave frequency that the correction was trained on", (hz,), (0.0, FREQUENCY_HZ[1]), "Hz")


def _check_sea(sea: SeaModel) -> None:
    components = len(sea.frequency_hz)
    if not components == len(sea.damping) == len(sea.level_m2phz):
        lengths = f"{components} frequencies, {len(sea.damping)} dampings, {len(sea.level_m2phz)} levels"
        raise ValueError(f"a sea of {lengths}")
    _within("number of resonators in a chain of the sea", (sea.stages,), (4, MOST_LINES), "")
    _within("frequency of the sea", sea.frequency_hz, FREQUENCY_HZ, "Hz")
    _within("damping of the sea", sea.damping, DAMPING, "")
    _within("level of the sea", sea.level_m2phz, LEVEL_M2PHZ, "m2/Hz")
    _within("noise of the accelerometer", (sea.noise_psd,), NOISE_PSD, "(m/s2)2/Hz")
    _within("bias walk of the accelerometer", (sea.bias_walk_psd,), BIAS_WALK_PSD, "(m/s2)2/s")
    shaken = sea.resonances
    _within("frequency of what shakes the accelerometer", tuple([one.frequency_hz for one in shaken]), SHAKEN_HZ, "Hz")
    _within("damping of what shakes the accelerometer", tuple([one.damping for one in shaken]), SHAKEN_DAMPING, "")
    _within("level of what shakes the accelerometer", tuple([one.level for one in shaken]), SHAKEN_PSD, "(m/s2)2/Hz")
    if sum(sea.level_m2phz) > 0.0 and not heave_std(sea) <= HEAVE_M:
        raise ValueError(f"a sea that heaves more than {HEAVE_M:g} m RMS")


def _within(what: str, values: tuple[float, ...], limits: tuple[float, float], unit: str) -> None:
    if len(values) > MOST_LINES:
        raise ValueError(f"{len(values)} values for the {what}")
    low, high = limits
    for value in values:
        if not (isfinite(value) and low <= value <= high):
            raise ValueError(f"{what} {value:g} {unit}".rstrip() + f" lies outside {low:g}..{high:g}")
