"""Roll, pitch and heave of ships in random seas, with the spectrum that each was made from.

Gaussian motion from a one-sided spectrum, but for the nonlinear roll, which is integrated, and the record of a real
ship.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

if TYPE_CHECKING:
    from pathlib import Path

Array = NDArray[np.float64]

RATE_HZ = 20.0
F_HZ = np.arange(0.0, 4.0, 1 / 400)


class Sea(msgspec.Struct, frozen=True):
    """A JONSWAP system: peak period and share of the wave energy."""

    period_s: float
    share: float = 1.0


class Ship(msgspec.Struct, frozen=True, kw_only=True):
    """One axis of a ship in a sea."""

    name: str
    seas: tuple[Sea, ...]
    std: float
    """Of the motion, in rad (m for heave)."""
    noise: float
    """White, per sample, the same unit."""
    period_s: float
    damping: float
    cubic: float = 0.0
    """Restoring moment w0^2 (x + cubic x^3), and quadratic damping besides: not a Gaussian process then."""


DEGREE = np.pi / 180
ARCSEC = DEGREE / 3600
SHIPS = (
    Ship(name="under way, roll", seas=(Sea(8.2),), std=3 * DEGREE, noise=2 * ARCSEC, period_s=12, damping=0.07),
    Ship(name="under way, pitch", seas=(Sea(8.2),), std=1 * DEGREE, noise=2 * ARCSEC, period_s=6.5, damping=0.35),
    Ship(name="under way, roll, MEMS", seas=(Sea(8.2),), std=3 * DEGREE, noise=72 * ARCSEC, period_s=12, damping=0.07),
    Ship(
        name="confused sea, roll",
        seas=(Sea(7.0, 0.6), Sea(14.0, 0.4)),
        std=2 * DEGREE,
        noise=20 * ARCSEC,
        period_s=12,
        damping=0.1,
    ),
    Ship(name="moored, roll", seas=(Sea(6.0),), std=0.05 * DEGREE, noise=0.3 * ARCSEC, period_s=12, damping=0.07),
    Ship(name="stabilised, roll", seas=(Sea(8.2),), std=1 * DEGREE, noise=20 * ARCSEC, period_s=12, damping=0.4),
    Ship(
        name="nonlinear roll",
        seas=(Sea(9.0),),
        std=8 * DEGREE,
        noise=20 * ARCSEC,
        period_s=12,
        damping=0.03,
        cubic=-1.5,
    ),
)


def jonswap(f_hz: Array, period_s: float) -> Array:
    """Shape of a JONSWAP spectrum (gamma 2) with the variance of 1."""
    f = np.maximum(f_hz, 1e-6)
    peak = 1.0 / period_s
    width = np.where(f <= peak, 0.07, 0.09)
    shape = f**-5 * np.exp(-1.25 * (peak / f) ** 4) * 2.0 ** np.exp(-0.5 * ((f / peak - 1) / width) ** 2)
    return np.asarray(shape / np.trapezoid(shape, f_hz), dtype=np.float64)


def spectrum(ship: Ship, f_hz: Array) -> Array:
    """One-sided spectrum of the motion, of variance std^2; for the nonlinear ship of its linear part."""
    waves = sum(sea.share * jonswap(f_hz, sea.period_s) for sea in ship.seas)
    ratio = f_hz * ship.period_s
    shape = waves / ((1 - ratio**2) ** 2 + (2 * ship.damping * ratio) ** 2)
    return np.asarray(shape * ship.std**2 / np.trapezoid(shape, f_hz), dtype=np.float64)


def gaussian(f_hz: Array, density: Array, duration_s: float, rng: np.random.Generator) -> Array:
    """(n,) at 20 Hz: random phases and amplitudes on a grid of twice the duration, half of it used."""
    count = 2 * round(duration_s * RATE_HZ)
    f = np.fft.rfftfreq(count, 1 / RATE_HZ)
    amplitude = np.sqrt(np.interp(f, f_hz, density, right=0.0) * f[1] / 4) * count
    waves = rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f))
    return np.asarray(np.fft.irfft(waves * amplitude, count)[: count // 2], dtype=np.float64)


def motion(ship: Ship, duration_s: float, rng: np.random.Generator) -> Array:
    """True motion (n,) at 20 Hz."""
    if ship.cubic == 0.0:
        return gaussian(F_HZ, spectrum(ship, F_HZ), duration_s, rng)
    return _nonlinear(ship, duration_s, rng)


def _nonlinear(ship: Ship, duration_s: float, rng: np.random.Generator) -> Array:
    """x'' + 2 zeta w x' + 0.5 |x'| x' + w^2 (x + cubic x^3) = w^2 e(t), in two steps of the midpoint rule a sample."""
    warm_s = 120.0
    waves = np.asarray(sum(sea.share * jonswap(F_HZ, sea.period_s) for sea in ship.seas))
    # The excitation that would give the stated deviation to the linear ship at twice its damping.
    ratio = F_HZ * ship.period_s
    gain = np.trapezoid(waves / ((1 - ratio**2) ** 2 + (4 * ship.damping * ratio) ** 2), F_HZ)
    force = gaussian(F_HZ, waves * ship.std**2 / gain, duration_s + warm_s, rng).tolist()
    w2, drag = (2 * np.pi / ship.period_s) ** 2, 2 * ship.damping * 2 * np.pi / ship.period_s

    def rate(x: float, v: float, e: float) -> float:
        return w2 * (e - x - ship.cubic * x**3) - drag * v - 0.5 * abs(v) * v

    x, v, h = 0.0, 0.0, 0.5 / RATE_HZ
    out = []
    for e, after in zip(force, force[1:] + force[-1:], strict=True):
        for part in (0.25, 0.75):
            now = e + part * (after - e)
            mid_x, mid_v = x + 0.5 * h * v, v + 0.5 * h * rate(x, v, now)
            x, v = x + h * mid_v, v + h * rate(mid_x, mid_v, now)
        out.append(x)
    return np.array(out[round(warm_s * RATE_HZ) :])


def known_spectrum(ship: Ship) -> Array:
    """The spectrum on ``F_HZ``: exact, or for the nonlinear ship that of ten hours of its motion."""
    if ship.cubic == 0.0:
        return spectrum(ship, F_HZ)
    long = motion(ship, 36_000.0, np.random.default_rng(99))
    f, density = welch(long, RATE_HZ, nperseg=8000, detrend=False)
    return np.asarray(np.interp(F_HZ, f, density))


def palmer(path: Path) -> tuple[Array, Array]:
    """Times (n,) in s at 1 Hz, and roll, pitch (n, 2) in rad of a real ship.

    Raises:
        OSError: the file cannot be read.
    """
    table = np.loadtxt(path, delimiter=",", skiprows=1, usecols=(0, 1, 2))
    return table[:, 0] - table[0, 0], np.radians(table[:, 1:])
