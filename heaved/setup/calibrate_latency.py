"""By how much the angles of a sensor are older than its body rates, from its own motion.

The vertical in the axes of the sensor turns as its gyroscopes say, u' = u x w. A sensor that levels itself lets it
follow the specific force besides, W' = r + k (a - W): W and a, how far the vertical and the specific force are off the
mean vertical, r what the rates make of W, in the two directions across it. It shows W late by T. With the transform of
a record

    (i f + k) W = exp(-i f T) (G r + k a),                                  f = 2 pi times frequency

which has no acceleration of the vessel in it but through k, and that is found with T: sway that goes with roll, which
makes any comparison of angles with accelerations alone worthless, does no harm. G, near one, is what scales and axes of
the gyroscopes are off, unknown to some hundredths; the accelerations may be later than the rates by a low-pass. Gauss
and Newton solve it, linear in all but T, over the frequencies at which she moves; what is left over tells how well.
Windowing is exact: the transform of the derivative is taken by parts.

**Limit.** Late angles and a lean do nearly the same to a vessel whose sway goes with her roll: with both unknown, five
minutes of a sea of 1.9 m, angles of 0.02 degrees and gyroscopes of 5e-5 rad/s/sqrt(Hz) show T to 4.5 ms at 20 samples
a second, 3 at 50 and 2.3 at 100; with gyroscopes four times as noisy to 7, 6 and 5 ms. Of angles that do not lean it is
1.9 ms at 20 and 1.2 at 100, and 3 ms. More motion, or a longer record, shows more; the standard error says so.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.setup.calibrate_record import means, pieces

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.setup.calibrate_record import Record

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """How the record is looked at."""

    rate_hz: float = 20.0
    """It is put on an even grid of this rate, or of its own if that is lower."""
    band_hz: tuple[float, float] = (0.04, 1.0)
    """In which vessels move."""
    least_s: float = 60.0
    hole_s: float = 1.0
    """Longer without a sample nobody knows how it has moved: the record is taken in pieces, none shorter than that."""
    least_hz: float = 4.0
    rounds: int = 8
    neighbours: float = 1.95
    """Neighbouring frequencies under a Hann window tell by so much less than independent ones: the sum of the squares
    of their correlations, 1 + 2 (0.67^2 + 0.17^2)."""
    lean_std_per_s: float = 0.15
    """How much is held of k, of T,"""
    late_std_s: float = 0.3
    scale_std: float = 0.02
    axes_std_rad: float = 0.02
    """scales and axes of the gyroscopes before the record is looked at."""
    lag_s: float = 0.01
    """The same of how late accelerations are after the rates, if their low-pass is not known."""
    moved_rad: float = 0.001
    """RMS of a motion that shows how rates and angles go together."""
    known_s: float = 0.003
    """Standard error up to which it is written."""


TUNING: Final = Tuning()
LATE, LEAN, LAGGING = range(3)
"""Of the unknowns."""


class _Seen(msgspec.Struct, frozen=True, eq=False, kw_only=True):
    """Transforms of a record at the frequencies of the band; (n, 2) each but for the last."""

    f: Array
    """(n,) rad/s,"""
    shown: Complex
    """W,"""
    derivative: Complex
    """of it,"""
    turned: Complex
    """r,"""
    apparent: Complex
    """a,"""
    about: Complex
    """(n, 1) and the rate about the vertical."""
    count: int
    """Values that they are made of."""


class LatencyError(Exception):
    """A record that does not tell it; the message says why and what to do."""


class Latency(msgspec.Struct, frozen=True, kw_only=True):
    """How old the angles are."""

    late_s: float
    """Than the rates of the same answer."""
    late_std_s: float
    lean_per_s: float
    """k; 0 of a sensor that does not level itself by its accelerometers."""
    lean_std_per_s: float
    seconds: float
    explained: float
    """Share of the motion of the angles that the rates make."""


def latency_of(record: Record, lag_s: float = 0.0) -> Latency:
    """What a record says of it.

    Raises:
        LatencyError: nothing.
    """
    for is_there, what in (
        (record.has_attitude, "roll and pitch"),
        (record.has_rates, "body rates: without gyroscopes nothing tells a late angle from a sway that goes with it"),
        (record.has_force, "the three accelerations"),
    ):
        if not is_there:
            raise LatencyError(f"the sensor has no {what}")
    parts = pieces(_whole(record), TUNING.hole_s, TUNING.least_s)
    if not parts:
        raise LatencyError(
            f"there are no {TUNING.least_s:.0f} s without a hole in the record: make a longer one, and see that the "
            "device answers"
        )
    seen = [_seen(part) for part in parts]
    if sum(float(np.sum(np.abs(one.turned) ** 2)) for one in seen) == 0.0:
        raise LatencyError("the body rates do not move: a wrong register in the profile?")
    return _fitted(seen, sum(part.seconds for part in parts), max(lag_s, TUNING.lag_s))


def coherence(record: Record, signs: Array) -> float | None:
    """Share of the motion of the angles that the body rates make when their signs are changed so, less than 0 if they
    make it worse; None: there is too little motion, or record, to say.
    """
    parts = pieces(_whole(record), TUNING.hole_s, TUNING.least_s)
    moved = left = threshold = 0.0
    for part in parts:
        try:
            seen = _seen(msgspec.structs.replace(part, rates_radps=part.rates_radps * signs))
        except LatencyError:
            return None
        shown, made = seen.derivative / seen.f[:, None], seen.turned / seen.f[:, None]
        moved += float(np.sum(np.abs(shown) ** 2))
        left += float(np.sum(np.abs(shown - made) ** 2))
        # By Parseval, half of the power at the positive frequencies, and 3/8 of it under the window.
        threshold += TUNING.moved_rad**2 * 3.0 / 16.0 * seen.count**2
    return 1.0 - left / moved if moved > threshold else None


def _whole(record: Record) -> Record:
    """The samples that have all of it."""
    good = np.isfinite(record.up).all(axis=1) & np.isfinite(record.rates_radps).all(axis=1)
    good &= np.isfinite(record.force_mps2).all(axis=1)
    return msgspec.structs.replace(
        record, t_s=record.t_s[good], force_mps2=record.force_mps2[good], angles_rad=record.angles_rad[good],
        rates_radps=record.rates_radps[good],
    )  # fmt: skip


def _seen(record: Record) -> _Seen:
    t_s = record.t_s
    rate_hz = min(TUNING.rate_hz, (len(t_s) - 1) / record.seconds)
    if rate_hz < TUNING.least_hz:
        raise LatencyError(f"{rate_hz:.1f} samples a second are too few: set rate_hz to 10 or more")
    _, rows = means(t_s, np.column_stack((record.up, record.rates_radps, record.force_mps2)), rate_hz)
    up, rates, force = rows[:, :3], rows[:, 3:6], rows[:, 6:]
    mean = up.mean(axis=0)
    mean /= np.linalg.norm(mean)
    across = _across(mean)
    turned = np.cross(up, rates) @ across
    apparent = (force / np.linalg.norm(force, axis=1)[:, None]) @ across
    return _transforms((up @ across, turned, apparent, (rates @ mean)[:, None]), 1.0 / rate_hz)


def _across(up: Array) -> Array:
    """(3, 2) unit vectors across the vertical and each other."""
    first = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    first /= np.linalg.norm(first)
    return np.column_stack((first, np.cross(up, first)))


def _transforms(series: tuple[Array, ...], step_s: float) -> _Seen:
    """Of the four series, the derivative of the first with them."""
    count = len(series[0])
    phase = 2.0 * np.pi * np.arange(count) / count
    window, slope = 0.5 - 0.5 * np.cos(phase), np.pi / (count * step_s) * np.sin(phase)
    f_hz = np.asarray(np.fft.rfftfreq(count, step_s), dtype=np.float64)
    band = (f_hz >= TUNING.band_hz[0]) & (f_hz <= min(TUNING.band_hz[1], 0.4 / step_s))
    f = 2.0 * np.pi * f_hz[band]
    shown, turned, apparent, about = (
        np.fft.rfft(window[:, None] * (one - one.mean(axis=0)), axis=0)[band] for one in series
    )
    first = series[0] - series[0].mean(axis=0)
    derivative = 1j * f[:, None] * shown - np.fft.rfft(slope[:, None] * first, axis=0)[band]
    return _Seen(
        f=f, shown=shown, derivative=derivative, turned=turned, apparent=apparent, about=about, count=count
    )  # fmt: skip


def _fitted(parts: Sequence[_Seen], seconds: float, lag_s: float) -> Latency:
    """Unknowns: T, k, k times the lag of the accelerations after the rates, what the two rates are scaled by beyond
    one, and the rotation of the gyroscopes against the angles: about the vertical, and what of the rate about it is in
    each.
    """
    held = np.array([
        TUNING.late_std_s, TUNING.lean_std_per_s, TUNING.lean_std_per_s * lag_s, *[TUNING.scale_std] * 2,
        *[TUNING.axes_std_rad] * 3,
    ])  # fmt: skip
    x = np.zeros(8)
    information = np.zeros((8, 8))
    for turn in range(TUNING.rounds):
        information, right = np.diag(held**-2.0), -x / held**2
        for seen in parts:
            left, slopes = _residuals(x, seen)
            weight = 1.0 / (TUNING.neighbours * _smoothed(np.mean(np.abs(left) ** 2, axis=1), seen.f))
            # Each of real and imaginary part has half of the power.
            weighed = 2.0 * weight[:, None, None] * slopes.conj()
            information = information + np.einsum("fai,faj->ij", weighed, slopes).real
            right = right + np.einsum("fai,fa->i", weighed, left).real
        step = np.linalg.solve(information, right)
        x = x + step
        if turn and float(np.max(np.abs(step / held))) < 1e-6:
            break
    moved = left_over = 0.0
    for seen in parts:
        left, _ = _residuals(x, seen)
        moved += float(np.sum(np.abs(seen.derivative / seen.f[:, None]) ** 2))
        left_over += float(np.sum(np.abs(left / seen.f[:, None]) ** 2))
    covariance: Array = np.linalg.solve(information, np.eye(len(information))).astype(np.float64)
    late_s, late_std_s, lean, lean_std = _averaged(x, covariance, float(held[LEAN]))
    return Latency(
        late_s=late_s, late_std_s=late_std_s, lean_per_s=lean, lean_std_per_s=lean_std, seconds=seconds,
        explained=1.0 - left_over / moved if moved > 0.0 else 0.0,
    )  # fmt: skip


def _averaged(x: Array, covariance: Array, lean_std: float) -> tuple[float, float, float, float]:
    """T and k with their standard errors, when k may as well be nothing: the average over both cases, each weighed by
    how likely it makes the record (Bayes).
    """
    var_k = float(covariance[LEAN, LEAN])
    odds = 0.5 * float(x[LEAN]) ** 2 / var_k + 0.5 * np.log(var_k) - np.log(lean_std)
    share = 1.0 / (1.0 + np.exp(-np.clip(odds, -50.0, 50.0)))
    # Without a lean its lag is nothing, too.
    both = [LEAN, LAGGING]
    gain = np.linalg.solve(covariance[np.ix_(both, both)], covariance[both, LATE])
    without, with_it = float(x[LATE] - gain @ x[both]), float(x[LATE])
    late = share * with_it + (1.0 - share) * without
    variance = share * float(covariance[LATE, LATE]) + share * (1.0 - share) * (with_it - without) ** 2
    variance += (1.0 - share) * float(covariance[LATE, LATE] - gain @ covariance[both, LATE])
    mean_k = share * float(x[LEAN])
    var = share * (var_k + float(x[LEAN]) ** 2) - mean_k**2
    return float(late), float(np.sqrt(variance)), float(mean_k), float(np.sqrt(var))


def _smoothed(power: Array, f: Array) -> Array:
    """What is left over as noise of the rates and of the angles make it, white each: a + b f^2, by least squares of the
    logarithm in a few steps.
    """
    a = b = 0.5 * float(np.mean(power))
    b /= float(np.mean(f**2))
    for _ in range(20):
        model = a + b * f**2
        rows = np.column_stack((a / model, b * f**2 / model))
        step = np.linalg.lstsq(rows, power / model - 1.0, rcond=None)[0]
        a, b = (value * float(np.exp(np.clip(part, -1.0, 1.0))) for value, part in zip((a, b), step, strict=True))
    return np.asarray(a + b * f**2)


def _residuals(x: Array, seen: _Seen) -> tuple[Complex, Complex]:
    """(n, 2) what the derivative shows beyond the model, and (n, 2, 8) how the model changes with the unknowns."""
    f, R, A, Z = seen.f, seen.turned, seen.apparent, seen.about
    late, k, lagging, one, two, about, first, second = x
    delay = np.exp(-1j * f * late)[:, None]
    turned = np.column_stack((R[:, 1], -R[:, 0]))
    driven = R * (1.0 + np.array((one, two))) + about * turned + Z * np.array((first, second)) + k * A
    driven = driven + lagging * 1j * f[:, None] * A
    left = seen.derivative + k * seen.shown - delay * driven
    slopes = np.zeros((len(f), 2, 8), dtype=np.complex128)
    slopes[:, :, 0] = -1j * f[:, None] * delay * driven
    slopes[:, :, 1] = delay * A - seen.shown
    slopes[:, :, 2] = delay * 1j * f[:, None] * A
    slopes[:, 0, 3] = delay[:, 0] * R[:, 0]
    slopes[:, 1, 4] = delay[:, 0] * R[:, 1]
    slopes[:, :, 5] = delay * turned
    slopes[:, 0, 6] = slopes[:, 1, 7] = delay[:, 0] * Z[:, 0]
    return left, slopes
