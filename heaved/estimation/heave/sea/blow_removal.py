"""What rings after blows, taken out of a record: a spectrum of the sea cannot be had of it otherwise.

A slam leaves an impulse in the acceleration, which has as much power below the waves as at the hull's own frequencies:
fitted as waves it is a long swell, and four decades above the skirt that the error of the heave lives on. But the hull
rings freely. Its modes are in what all blows leave in the fourth differences of the samples, which hardly see the
waves: the subspace that stands out of the noise of the quiet parts between them turns from one sample to the next as
the modes do (ESPRIT: Roy & Kailath 1989). How much of each mode a blow has started, and how wrong the readings are that
are in part of before it, is then a linear regression on the innovations of the waves' filter, which are white beside
it.
"""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.heave.sea import batch_filter
from heaved.estimation.heave.sea.model import SeaModel, SeaSystem

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.estimation.heave.sea.record import EvenRecord

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


class Rung(msgspec.Struct, frozen=True, eq=False):
    """What blows have added to a record of n samples."""

    ringing_mps2: Array
    """(n + k,) of the hull; k samples more, until all has died away."""
    spoilt_mps2: Array
    """(n,) of the readings during a blow, beside that."""

    @property
    def a_mps2(self) -> Array:
        """(n,) both."""
        return self.ringing_mps2[: len(self.spoilt_mps2)] + self.spoilt_mps2

    def density(self, f_hz: Array, count: int, dt_s: float) -> Array:
        """One-sided density (m/s2)2/Hz at evenly spaced ``f_hz`` (m,) of the ringing in the last ``count`` samples,
        which are ``dt_s`` apart. As all of it dies away, no window is needed, which would hide what rings now.
        """
        rings = self.ringing_mps2[max(len(self.spoilt_mps2) - count, 0) :]
        f = np.fft.rfftfreq(len(rings), dt_s)
        energy = np.concatenate(([0.0], np.cumsum(np.abs(np.fft.rfft(rings)) ** 2)))
        edges = np.concatenate((f - 0.5 * f[1], [f[-1] + 0.5 * f[1]]))
        width_hz = float(f_hz[1] - f_hz[0])
        inside = np.diff(np.interp(np.append(f_hz - 0.5 * width_hz, f_hz[-1] + 0.5 * width_hz), edges, energy))
        return np.asarray(inside * f[1] / width_hz * 2.0 * dt_s / count)


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of what rings, and of the regression."""

    differences: int = 4
    """Of the samples: waves of 0.3 Hz are a ten-thousandth of what they were, at 20 samples a second."""
    order: int = 12
    """Neighbouring differences that are looked at together: twice as many as modes have poles."""
    heard_s: float = 1.6
    """After a blow its ringing is looked at for so long;"""
    quiet_s: float = 5.0
    """and after so long it is quiet again."""
    quiet_least: int = 200
    """Samples that show what is there without blows; with fewer of them it is taken for white noise,"""
    quiet_share: float = 1e-3
    """of that share of the power after blows."""
    stands_out: float = 8.0
    """Times the power that is there without blows."""
    most_poles: int = 8
    lowest_hz: float = 0.7
    """Nothing of a hull rings slower."""
    most_damping: float = 0.5
    """What dies away faster is part of the blow."""
    blow: int = 1
    """Readings that the blow itself lasts, beside those that are in part of before."""
    told_s: float = 6.0
    """The regression sees so much after each blow,"""
    rings_s: float = 20.0
    """and nothing is left of its ringing after this."""
    together: int = 8
    """Blows that follow each other so fast that their regressions overlap are told apart up to so many at once."""
    size_mps2: float = 3.0
    """Standard deviation of the amplitude of a mode, and of a reading in a blow."""


TUNING: Final = Tuning()


def ringing(record: EvenRecord, model: SeaModel, mixed: int) -> Rung:
    """What adds to the samples of ``record`` because of its blows.

    model: its waves tell what goes on beneath. mixed: samples from a blow's first on that are in part of before it.

    Raises:
        LinAlgError: no filter of the model converges, or it leaves the finite numbers.
    """
    count, dt = len(record.a_mps2), record.dt_s
    spoilt = mixed + TUNING.blow
    places = [place for place in record.blows if place + spoilt < count]
    if not places:
        return Rung(ringing_mps2=np.zeros(count + round(TUNING.rings_s / dt)), spoilt_mps2=np.zeros(count))
    system = SeaSystem(msgspec.structs.replace(model, resonances=()))
    steady = system.steady(dt)
    if steady is None:
        raise np.linalg.LinAlgError("the filter that blows are taken out with does not converge")
    done = batch_filter.run(system, steady, record, full_start=False, full_holes=False)
    if not np.isfinite(done.x).all():
        raise np.linalg.LinAlgError("the filter that blows are taken out with leaves the finite numbers")
    y = done.innovation
    is_told = np.isfinite(y) & record.is_known
    for place in places:
        is_told[place : place + spoilt] |= np.isfinite(y[place : place + spoilt])
    length, told = round(TUNING.rings_s / dt), round(TUNING.told_s / dt)
    turned = np.exp(np.outer(np.arange(length) * dt, modes(record, places, spoilt)))
    rings = np.column_stack((turned.real, turned.imag))
    seen = batch_filter.whitened(system, steady, np.column_stack((rings, np.eye(length, spoilt))))
    each = seen.shape[1]
    found = Rung(ringing_mps2=np.zeros(count + length), spoilt_mps2=np.zeros(count))
    for group in _groups(places, told):
        begin, end = group[0], min(group[-1] + told, count)
        X = np.zeros((end - begin, len(group) * each))
        for i, place in enumerate(group):
            X[place - begin : place - begin + length, i * each : (i + 1) * each] = seen[: end - place]
        shown = X[is_told[begin:end]]
        answer = shown.T @ y[begin:end][is_told[begin:end]] / steady.S
        sizes = np.linalg.solve(shown.T @ shown / steady.S + np.eye(len(answer)) / TUNING.size_mps2**2, answer)
        for i, place in enumerate(group):
            size, rest = sizes[i * each : (i + 1) * each], min(length, count - place)
            found.ringing_mps2[place : place + length] += rings @ size[:-spoilt]
            found.spoilt_mps2[place : place + spoilt] += size[-spoilt:]
            y[place : place + rest] -= seen[:rest] @ size
    return found


def modes(record: EvenRecord, places: Sequence[int], spoilt: int) -> Complex:
    """Upper poles (k,) of what rings after blows at ``places``, 1/s; ``spoilt``: samples from there on that are left
    out.
    """
    a, dt, order = record.a_mps2, record.dt_s, TUNING.order
    differences = np.diff(a, n=TUNING.differences)
    is_known = record.is_known.copy()
    is_quiet = np.ones(len(a), dtype=np.bool_)
    for place in places:
        is_known[place : place + spoilt] = False
        is_quiet[max(place - 1, 0) : place + round(TUNING.quiet_s / dt)] = False
    ends = [*places, len(a)][1:]
    heard = [
        range(place + spoilt, min(place + spoilt + round(TUNING.heard_s / dt), end))
        for place, end in zip(places, ends, strict=True)
    ]
    loud = [_windows(differences, is_known, part) for part in heard]
    after = np.concatenate(loud) if loud else np.empty((0, order))
    if len(after) < order:
        return np.empty(0, dtype=np.complex128)
    quiet = _windows(differences, is_known & is_quiet, range(len(a)))
    if len(quiet) >= TUNING.quiet_least:
        noise = quiet.T @ quiet / len(quiet)
    else:
        white = np.diff(np.eye(order + TUNING.differences), n=TUNING.differences, axis=0)
        noise = white @ white.T
        noise *= TUNING.quiet_share * float(np.mean(after**2)) / noise[0, 0]
    noise[np.diag_indices(order)] += 1e-6 * np.trace(noise) / order + 1e-24
    factor = np.linalg.cholesky(noise)
    scaled = np.linalg.solve(factor, after.T)
    power, directions = np.linalg.eigh(scaled @ scaled.T / len(after))
    count = min(int(np.sum(power > TUNING.stands_out)), TUNING.most_poles)
    if count < 2:
        return np.empty(0, dtype=np.complex128)
    subspace = factor @ directions[:, -count:]
    turns = np.linalg.eigvals(np.linalg.lstsq(subspace[:-1], subspace[1:], rcond=None)[0])
    poles = np.log(turns[turns.imag > 0.0].astype(np.complex128)) / dt
    size = np.abs(poles)
    is_one = (poles.real < 0.0) & (-poles.real < TUNING.most_damping * size) & (size > 2.0 * pi * TUNING.lowest_hz)
    return np.asarray(poles[is_one])


def _windows(differences: Array, is_known: NDArray[np.bool_], part: range) -> Array:
    """(k, order) neighbouring differences of samples within ``part`` that are all known."""
    reach = TUNING.order + TUNING.differences
    if len(part) < reach:
        return np.empty((0, TUNING.order))
    windows = np.lib.stride_tricks.sliding_window_view
    whole = windows(is_known[part.start : part.stop], reach).all(axis=1)
    return np.asarray(
        windows(differences[part.start : part.stop - TUNING.differences], TUNING.order)[whole], dtype=np.float64
    )


def _groups(places: Sequence[int], told: int) -> list[list[int]]:
    """Places in groups: those whose regressions overlap."""
    groups: list[list[int]] = []
    for place in places:
        if groups and place - groups[-1][-1] < told and len(groups[-1]) < TUNING.together:
            groups[-1].append(place)
        else:
            groups.append([place])
    return groups
