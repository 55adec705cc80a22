"""Delayed heave: the fixed-lag smoother of the sea model, as weights on the innovations that came after.

Real-time heave can only use the past. What is known some time later is ten times better (a few thousandths of the
heave), and it is a check on the real-time value that needs no laser.

Rauch, Tung & Striebel 1965 in the form of Bryson & Frazier: with the steady gain, L = F (I - K H), y the innovations,

    h(k | k + J) = h(k | k - 1) + sum_j g_j y(k + j),   g_j = c P (L')^j H' / S,   variance  c P c' - S sum_j g_j^2.

These weights are those of a filter that misses nothing; a hole is felt in them for a minute. What was measured around
it says as much of the heave as ever, if each sample is weighed as the filter weighed it: the fixed-interval smoother in
its adjoint form (Bryson & Frazier 1963; Bierman 1977, section X). With the gain K, the innovation y and its variance S
of each sample, and F from there to the next one,

    x(k | N) = x(k | k-1) + P l_k,      l_k = H' y_k / S_k + (I - K_k H)' F' l_{k+1},
    P(k | N) = P - P L_k P,             L_k = H' H / S_k + (I - K_k H)' F' L_{k+1} F (I - K_k H).
"""

from __future__ import annotations

from collections import deque
from math import isfinite, isnan, sqrt
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.heave.sea.model import SeaSystem, Steady, measurement_variance
from heaved.samples import DelayedHeave

if TYPE_CHECKING:
    from heaved.estimation.heave.sea.filter import SeaFilter
    from heaved.estimation.heave.sea.record import EvenRecord

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What may be missing of the past. Without a source: held by the tests against the exact smoother."""

    short_s: float = 0.25
    """A hole that is no longer is felt less than the noise of the samples around it: the weights serve,"""
    most: float = 0.03
    """as long as no more than this share is missing."""


TUNING: Final = Tuning()
WEIGHTS_BLOCK: Final = 64


class FixedLagSmoother:
    """Feed it what the filter said at each sample; it gives the heave of ``delay_s`` ago."""

    def __init__(self, system: SeaSystem, steady: Steady, delay_s: float) -> None:
        self._dt_s = steady.dt_s
        count = max(1, round(delay_s / steady.dt_s))
        self._weights = _weights(system, steady, count)
        variance = float(system.heave @ steady.P @ system.heave) - steady.S * float(self._weights @ self._weights)
        self.std_m = sqrt(max(variance, 0.0))
        self._predicted: deque[tuple[float, float]] = deque(maxlen=count + 1)
        """Time, and heave before the sample was taken in."""
        self._innovations = np.zeros(2 * (count + 1))
        """Each is written twice, so that the last count + 1 always lie in one piece."""
        self._next = 0
        self._short = max(2, round(TUNING.short_s / steady.dt_s))
        self._missing = self._missing_on_end = 0
        """Samples of those that are kept, and of these up to the last one."""
        self._whole = 0
        """Samples since more were missing on end than in a short hole."""

    def fill(self, end_s: float, predicted_m: Array, innovation: Array) -> None:
        """Start with what the filter of this model would have said at samples up to ``end_s``."""
        size, count = len(self._weights), min(len(predicted_m), len(self._weights))
        times = end_s - self._dt_s * np.arange(count - 1, -1, -1)
        self._innovations[:count] = self._innovations[size : size + count] = innovation[-count:]
        self._next = count % size
        for t_s, heave_m in zip(times.tolist(), predicted_m[-count:].tolist(), strict=True):
            self._keep(t_s, heave_m)

    def push(self, t_s: float, predicted_m: float, innovation: float) -> None:
        """One sample more, one interval after the last; innovation 0 where there was none to take in.

        predicted_m: nan where there was none, or where it was predicted with another gain than the steady one.
        """
        at, size = self._next, len(self._weights)
        self._innovations[at] = self._innovations[at + size] = innovation
        self._next = at + 1 if at + 1 < size else 0
        self._keep(t_s, predicted_m)

    def _keep(self, t_s: float, predicted_m: float) -> None:
        kept = self._predicted
        if len(kept) == kept.maxlen:
            self._missing -= isnan(kept[0][1])
        kept.append((t_s, predicted_m))
        is_missing = isnan(predicted_m)
        self._missing += is_missing
        self._missing_on_end = self._missing_on_end + 1 if is_missing else 0
        self._whole = self._whole + 1 if self._missing_on_end <= self._short else 0

    def value(self) -> DelayedHeave | None:
        """The newest delayed heave; None while the past is too short, or too much of it is missing."""
        if self._whole < len(self._weights) or self._missing > TUNING.most * len(self._weights):
            return None
        t_s, predicted_m = self._predicted[0]
        after = self._innovations[self._next : self._next + len(self._weights)]
        heave_m = predicted_m + float(self._weights.dot(after))
        return DelayedHeave(t_s=t_s, heave_m=heave_m, std_m=self.std_m) if isfinite(heave_m) else None


def _weights(system: SeaSystem, steady: Steady, count: int) -> Array:
    """g_j of the module's formula, j = 0 .. count."""
    # WEIGHTS_BLOCK of them from one row: H' of as many samples on, in columns.
    step = (steady.F @ (np.eye(len(system.H)) - np.outer(steady.K, system.H))).T
    ahead = np.empty((len(system.H), WEIGHTS_BLOCK))
    ahead[:, 0] = system.H / steady.S
    for j in range(1, WEIGHTS_BLOCK):
        ahead[:, j] = step @ ahead[:, j - 1]
    block = np.linalg.matrix_power(step, WEIGHTS_BLOCK)
    row, found = system.heave @ steady.P, []
    for _ in range(0, count + 1, WEIGHTS_BLOCK):
        found.append(row @ ahead)
        row = row @ block
    return np.concatenate(found)[: count + 1]


def smoothed(f: SeaFilter, record: EvenRecord, count: int) -> Array:
    """(k, 3) time, heave (m) and its standard deviation for those of the first ``count`` samples that were measured.

    f: the filter one sample before the first; it is left as it is.
    """
    H, heave, identity = f.system.H, f.system.heave, np.eye(len(f.system.H))
    R = measurement_variance(f.system.model.noise_psd, record.dt_s)
    x, P, before = f.x, f.covariance, -1
    passed = []
    changes = sorted({*record.cuts, *record.blows})
    for place in np.flatnonzero(record.is_known).tolist():
        F, Q = f.moves(place - before)
        x, P = F.dot(x), F.dot(P).dot(F.T) + Q
        while changes and changes[0] <= place:
            P = record.opened(f.system, P, changes.pop(0))
        PH = P.dot(H)
        S, y = float(H.dot(PH)) + R, float(record.a_mps2[place]) - float(H.dot(x))
        row = heave.dot(P)
        passed.append((place, F, PH / S, S, y, float(heave.dot(x)), row, float(row.dot(heave))))
        x, P, before = x + PH * (y / S), P - np.outer(PH, PH) / S, place
        P = 0.5 * (P + P.T)
    adjoint, information = np.zeros(len(H)), np.zeros_like(identity)
    found = []
    for place, F, K, S, y, predicted_m, row, variance_m2 in reversed(passed):
        kept = identity - np.outer(K, H)
        adjoint = kept.T.dot(adjoint) + H * (y / S)
        information = kept.T.dot(information).dot(kept) + np.outer(H, H) / S
        if place < count:
            left_m2 = variance_m2 - float(row.dot(information).dot(row))
            t_s = record.end_s - (len(record.a_mps2) - 1 - place) * record.dt_s
            found.append((t_s, predicted_m + float(row.dot(adjoint)), sqrt(max(left_m2, 0.0))))
        adjoint, information = F.T.dot(adjoint), F.T.dot(information).dot(F)
    return np.array(found[::-1]).reshape(-1, 3)
