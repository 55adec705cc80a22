"""What the fitted spectrum says of the sea: significant height and periods of the heave, swell and wind sea apart.

These are figures of the *vessel's heave*, which is what is measured, not of the waves: a vessel follows long waves and
hardly notices short ones. The noise of the sensor is not in them: they come from the fitted model.
"""

from __future__ import annotations

import itertools
from math import pi, sqrt
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.heave.sea.noise import HALF_POWER
from heaved.samples import GRAVITY_MPS2, SeaState, Vibration, WaveSystem

if TYPE_CHECKING:
    from heaved.estimation.heave.sea.model import SeaModel

Array = NDArray[np.float64]

GRID_HZ: Final = np.geomspace(0.025, 1.0, 240)
"""0.6 times to 24 times the usual peak; what lies outside is no wave."""


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of what is said of the sea."""

    trough: float = 0.5
    """Two peaks are two systems when the spectrum between them falls below this share of the lower one."""
    least_share: float = 0.01
    """A system with less of the variance than this is not worth a name."""
    swell_steepness: float = 0.010
    """2 pi Hs / (g Tp^2): a sea under wind is steeper, a swell that has left its wind flatter (a wind sea that is just
    raised has 0.03 to 0.06; swell of 1 m at 12 s has 0.004)."""
    least_mps2: float = 0.02
    """Of vibration that people are told of: what is left of a clean sea above 0.8 Hz may look like half as much."""
    published_points: int = 40
    """Of the spectrum, for people."""


TUNING: Final = Tuning()


def sea_state(model: SeaModel, share: float = 1.0) -> SeaState:
    """Heights (m), periods (s) and spectrum of the heave of ``model``, ``share`` of whose variance was measured."""
    f, S = GRID_HZ, share * model.heave_spectrum(GRID_HZ)
    m0, m1 = (float(np.trapezoid(S * f**i, f)) for i in (0, 1))
    step = len(f) // TUNING.published_points
    return SeaState(
        significant_height_m=4.0 * sqrt(m0),
        peak_period_s=1.0 / float(f[np.argmax(S)]),
        mean_period_s=m0 / m1,
        systems=tuple(_system(f[part], S[part]) for part in _parts(f, S, m0)),
        frequencies_hz=tuple(f[::step].tolist()),
        spectrum_m2phz=tuple(S[::step].tolist()),
        vibration=vibration(model),
        noise_mps2_rthz=sqrt(model.noise_psd),
        bias_walk_mps2_rts=sqrt(model.bias_walk_psd),
    )


def vibration(model: SeaModel) -> tuple[Vibration, ...]:
    """What shakes the sensor and is no waves, strongest first, as far as it is worth a name."""
    found = [
        Vibration(frequency_hz=one.frequency_hz, width_hz=HALF_POWER * one.damping * one.frequency_hz, rms_mps2=rms)
        for one in model.resonances
        if not one.is_heave and (rms := sqrt(one.variance)) > TUNING.least_mps2
    ]
    return tuple(sorted(found, key=lambda one: -one.rms_mps2))


def longest_period_s(model: SeaModel) -> float:
    """Period (s) of the longest waves that matter: a tenth of the variance of the heave is in longer ones."""
    f, S = GRID_HZ, model.heave_spectrum(GRID_HZ)
    up_to = np.concatenate(([0.0], np.cumsum(0.5 * (S[1:] + S[:-1]) * np.diff(f))))
    return 1.0 / float(np.interp(0.1 * up_to[-1], up_to, f))


def _system(f: Array, S: Array) -> WaveSystem:
    height, period = 4.0 * sqrt(float(np.trapezoid(S, f))), 1.0 / float(f[np.argmax(S)])
    steepness = 2.0 * pi * height / (GRAVITY_MPS2 * period**2)
    return WaveSystem(
        kind="swell" if steepness < TUNING.swell_steepness else "wind sea",
        significant_height_m=height,
        peak_period_s=period,
    )


def _parts(f: Array, S: Array, m0: float) -> list[slice]:
    """The band cut at the troughs between peaks, longest waves first."""
    peaks = [i for i in range(1, len(S) - 1) if S[i - 1] < S[i] >= S[i + 1]]
    cuts: list[int] = []
    last = 0
    for peak in peaks[1:]:
        trough = peaks[last] + int(np.argmin(S[peaks[last] : peak]))
        if S[trough] < TUNING.trough * min(S[peaks[last]], S[peak]):
            cuts.append(trough)
            last = peaks.index(peak)
        elif S[peak] > S[peaks[last]]:
            last = peaks.index(peak)
    bounds = [0, *cuts, len(f) - 1]
    parts = [slice(a, b + 1) for a, b in itertools.pairwise(bounds)]
    return [part for part in parts if float(np.trapezoid(S[part], f[part])) >= TUNING.least_share * m0] or [
        slice(0, len(f))
    ]
