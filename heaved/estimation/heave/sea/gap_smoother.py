"""Delayed heave where samples are missing: the fixed-interval smoother of a record with holes.

The weights of the fixed-lag smoother (:mod:`smoother`) are those of a filter that misses nothing; a hole is felt in
them for a minute. What was measured around it says as much of the heave as ever, if each sample is weighed as the
filter weighed it: the adjoint form of Rauch, Tung & Striebel's smoother (Bryson & Frazier 1963; Bierman 1977, section
X). With the gain K, the innovation y and its variance S of each sample, and F from there to the next one,

    x(k | N) = x(k | k-1) + P l_k,      l_k = H' y_k / S_k + (I - K_k H)' F' l_{k+1},
    P(k | N) = P - P L_k P,             L_k = H' H / S_k + (I - K_k H)' F' L_{k+1} F (I - K_k H).
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from heaved.estimation.heave.sea.batch_filter import Record
from heaved.estimation.heave.sea.filter import SeaFilter
from heaved.estimation.heave.sea.model import measurement_variance

Array = NDArray[np.float64]


def smoothed(f: SeaFilter, record: Record, count: int) -> Array:
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
