"""A channel whose readings are full of holes: an autoregression in a Kalman filter, fed with those that are there.

Regressions on lags want every lag. Filled with their own predictions, a quiet sensor's lags make them see slopes that
are nobody's, and predict the next hole from those. A Kalman filter needs no filling: readings are taken at their own
times, what lies between them is known as well as it is known, and that well is what is published as the deviation.

Its state is the motion at the last 56 of nodes 0.2 s apart, its model the autoregression between them
(:mod:`heaved.estimation.rock.autoregression`), and the level that this motion is about, for the vessel may list. The
model is learned from stretches without a hole, and in holes from the filter's own state.
"""

from __future__ import annotations

from collections import deque
from math import comb, inf, nan, radians
from typing import Final, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.rock.autoregression import NEWEST, NODES, Autoregression
from heaved.estimation.rock.autoregression import TUNING as MODEL

Array = NDArray[np.float64]
Place = TypeVar("Place", float, NDArray[np.float64])

ALL, LEVEL = slice(0, NODES), NODES
"""All nodes, and the place behind them of the level that they are about."""


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What the filter is set to."""

    solved_rows: int = 40
    """Nodes from one solution to the next while there are holes."""
    level: float = 0.1
    """Standard deviation of what the slow mean is off by, over that of the motion,"""
    level_walk: float = 0.003
    """and of what list and trim add to that, per root of a second. Waves have nothing at the lowest frequencies, so the
    level shows well; a model that knows of none makes an error of 7 degrees within a second of a list of 3."""
    listed: float = 1.0
    """So many standard deviations of the motion may it have listed by unseen,"""
    listed_rad: float = radians(2.0)
    """and by so much."""
    noise_memory: float = 100.0
    """Readings by which the variance of their noise is followed, if that is all that is not known of them."""
    adjacent: int = 4
    """Readings of so many rows on end show their noise by how far they are from a parabola: the motion is one,"""
    adjacent_s: float = 0.1
    """in rows no further apart than this;"""
    shown: int = 8
    """so often before it counts."""
    doubt_memory: float = 20.0
    """Readings by which it is judged whether innovations are as large as they should be."""
    noise_range: float = 4.0
    """Most of it, over what would make all innovations from node to node: of those, an estimate that knows what came
    later leaves a part only."""
    doubled: float = 2.0
    """What one that is held back does to that: either it is wrong, or what was expected of it."""
    gate: float = 6.0
    """Deviations of an innovation beyond which a reading is held back."""
    refused: int = 5
    """Readings held back in a row, over at least..."""
    refused_s: float = 0.5
    """...by which the filter has lost the motion: what it is fed is not what it follows."""
    odd: float = 3.0
    """Mean square of what a state is made of, over the usual, from which it is no motion that the model knows. (A list,
    taken for one, is 4 to 60; waves are less than 1.3.) What was predicted from it would be anything."""
    growth_memory: float = 300.0
    """Nodes, a minute, in which the motion may become larger; a list comes in seconds."""
    astray_nodes: int = 10
    """So often, 2 s, it is tried anew with the readings of the last 11 s."""
    odd_nodes: int = 100
    """20 s of it: it lasts longer than the 11 s that the nodes look back."""
    position_noise: float = 1e-2
    """Least noise of a reading over the innovation from node to node: what cubic interpolation between nodes leaves."""


TUNING: Final = Tuning()
POINTS: Final = np.arange(4)
BEND: Final = [(-1) ** k * comb(TUNING.adjacent - 1, k) for k in range(TUNING.adjacent)]
"""Weights on so many readings of what a parabola has none of,"""
BEND_SQUARE: Final = sum(weight * weight for weight in BEND)
"""and what noise has: that of each, times this."""


def cubic(place: Array) -> Array:
    """(..., 4) weights on four nodes 0, 1, 2, 3 of the value at a place between 1 and 3 (Lagrange)."""
    weights = np.empty((*place.shape, len(POINTS)))
    weights[..., 0], weights[..., 1], weights[..., 2], weights[..., 3] = _four(place)
    return weights


def _four(a: Place) -> tuple[Place, Place, Place, Place]:
    b, c, d = a - 1.0, a - 2.0, a - 3.0
    return -b * c * d / 6.0, a * c * d / 2.0, -a * b * d / 2.0, a * b * c / 6.0


def _first_of_four(place: Array, count: int) -> NDArray[np.intp]:
    """The nodes, of so many, between which places are interpolated."""
    return np.minimum(np.maximum(np.floor(place).astype(np.intp) - 1, 0), count - 4)


class HoleFilter:
    """Kalman filter of one channel on its autoregression; places and times are counted in rows of the sample grid."""

    def __init__(self, every: int, interval_s: float, reach_s: float) -> None:
        """``every``: rows from node to node; ``interval_s``: of rows."""
        self._every = every
        self._interval_s = interval_s
        self.model = Autoregression(every * interval_s, reach_s)
        self.noise_square = nan
        """Of a reading."""
        self._ridge_square = 0.0
        """The same, as it was when the filter began: what follows the model shall not lead it."""
        self.mean = 0.0
        """What the state is counted from."""
        self._x = np.zeros(NODES + 1)
        self._P = np.zeros((NODES + 1, NODES + 1))
        self._level_walk = 0.0
        """Variance that the level gains from node to node."""
        self._node = 0
        """Row of the newest node."""
        self._until_solved = 0
        self._doubt = 1.0
        self._latest: deque[tuple[float, float]] = deque(maxlen=TUNING.adjacent)
        """Row and value of the latest readings,"""
        self._shown, self._shown_square = 0.0, 0.0
        """and the mean square of the noise that they have shown, so many times."""
        self._told = 0.0
        """What readings have told of their noise so far (the Fisher information, twice)."""
        self._refused = 0
        self._refused_row = 0.0
        self._odd_nodes = 0
        """So many nodes long its state has been of no motion that the model knows."""
        self._larger = 1.0
        """Mean square of the motion of late, over the model's."""
        self._assumed = False

    @property
    def known(self) -> bool:
        """Whether what it says may be published."""
        return self.model.rows >= MODEL.learned_rows and not self._odd_nodes

    def begin(self, row: int, nodes: Array, measured: NDArray[np.bool_], mean: float, noise_square: float) -> bool:
        """Start from the values (56,) of the row and those ``every`` rows apart before it, where they were measured.

        False: there is no model to start from.
        """
        model = self.model
        # Where it was left is the best guess of where it is.
        level = self.mean + float(self._x[LEVEL]) - mean if self._P[LEVEL, LEVEL] > 0.0 else 0.0
        self.mean = mean
        y = nodes - mean - level
        if model.rows < (MODEL.learned_rows if self._assumed else MODEL.prior_rows):
            self._assumed = True
            spread = float(np.mean(y[measured] ** 2)) if measured.any() else 0.0
            model.assume(max(spread, noise_square, 1e-12))
        noise_square = max(noise_square, self._seen_noise)
        if not model.solve(noise_square):
            return False
        self.noise_square = noise_square or inf
        self._bound_noise(self._largest_noise)
        self._ridge_square = self.noise_square
        self._told = TUNING.noise_memory * self.noise_square**-2.0
        self._latest.clear()
        P = np.zeros((NODES + 1, NODES + 1))
        P[ALL, ALL] = model.covariance
        # The slow mean follows a list in minutes; that of 11 s shows it at once, and waves besides.
        listed = float(np.mean(y[measured])) if measured.any() else level
        P[LEVEL, LEVEL] = TUNING.level**2 * model.variance + listed**2
        self._level_walk = TUNING.level_walk**2 * model.variance * self._every * self._interval_s
        here = np.flatnonzero(measured)
        if len(here):
            seen = P[here] + P[LEVEL]
            S = seen[:, here] + seen[:, [LEVEL]]
            S[np.diag_indices(len(here))] += self.noise_square
            gain = np.linalg.solve(S, seen).T
            self._x = gain @ y[here]
            P = P - gain @ seen
        else:
            self._x = np.zeros(NODES + 1)
        self._x[LEVEL] += level
        self._P = 0.5 * (P + P.T)
        self._node = row
        self._doubt = 1.0
        self._refused = 0
        self._larger = 1.0
        self._until_solved = TUNING.solved_rows
        return True

    @property
    def _largest_noise(self) -> float:
        """What alone would make the innovations of readings that were taken for nodes."""
        model = self.model
        return model.square / (1.0 + float(model.step @ model.step))

    def _bound_noise(self, most: float) -> None:
        least = max(TUNING.position_noise * self.model.square, self._seen_noise)
        self.noise_square = max(min(self.noise_square, most), least)

    @property
    def _seen_noise(self) -> float:
        """Mean square of what readings on end have shown of it, whatever the model; 0: not enough."""
        return self._shown_square if self._shown >= TUNING.shown else 0.0

    def _see_noise(self, row: float, value: float) -> None:
        latest = self._latest
        if latest and not 0.5 < row - latest[-1][0] < 1.5:
            latest.clear()
        latest.append((row, value))
        if len(latest) == TUNING.adjacent and self._interval_s <= TUNING.adjacent_s:
            bend = sum(weight * x for weight, (_, x) in zip(BEND, latest, strict=True))
            self._shown = min(self._shown + 1.0, TUNING.noise_memory)
            self._shown_square += (bend * bend / BEND_SQUARE - self._shown_square) / self._shown

    def move_mean(self, mean: float) -> None:
        """Count from another slow mean."""
        self._x[LEVEL] += self.mean - mean
        self.mean = mean

    def to(self, row: float) -> None:
        """Move on until no row up to this lies after the newest node."""
        while self._node < row - 1e-6:
            self._step()

    def _step(self) -> None:
        model, x, P = self.model, self._x, self._P
        is_odd = model.rows >= MODEL.learned_rows and model.oddness(x[NEWEST]) > TUNING.odd * max(self._larger, 1.0)
        self._odd_nodes = self._odd_nodes + 1 if is_odd else 0
        self._larger += (float(x[0]) ** 2 / max(model.variance, 1e-300) - self._larger) / TUNING.growth_memory
        if not is_odd:
            model.learn(np.multiply.outer(x[ALL], x[ALL]) + P[ALL, ALL], 1)
        self._until_solved -= 1
        if self._until_solved <= 0:
            self._until_solved = TUNING.solved_rows
            if model.solve(max(self._ridge_square, self._seen_noise)) and model.rows < MODEL.learned_rows:
                self._bound_noise(self._largest_noise)
        ahead = P[:, NEWEST] @ model.step
        newest = float(model.step @ ahead[NEWEST]) + model.square
        P[1:NODES, 1:NODES] = P[: NODES - 1, : NODES - 1].copy()
        P[1:NODES, LEVEL] = P[LEVEL, 1:NODES] = P[LEVEL, : NODES - 1].copy()
        P[0, 0] = newest
        P[0, 1:NODES] = P[1:NODES, 0] = ahead[: NODES - 1]
        P[0, LEVEL] = P[LEVEL, 0] = ahead[LEVEL]
        P[LEVEL, LEVEL] += self._level_walk
        first = float(model.step @ x[NEWEST])
        x[1:NODES] = x[: NODES - 1].copy()
        x[0] = first
        self._node += self._every

    def _weights(self, row: float) -> Array:
        """On the four newest nodes, newest first, of a row between the newest two."""
        place = min(max(3.0 + (row - self._node) / self._every, 1.0), 3.0)
        return np.array(_four(place)[::-1])

    def value(self, row: float) -> tuple[float, float]:
        """What is expected of a row up to the newest node, and its variance without noise."""
        w = self._weights(row)
        K = self._P[:, :4] @ w + self._P[:, LEVEL]
        return float(w @ self._x[:4] + self._x[LEVEL]), float(w @ K[:4] + K[LEVEL])

    def read(self, row: float, value: float) -> bool:
        """Take a reading, about the mean; False: it is held back."""
        self.to(row)
        w = self._weights(row)
        K = self._P[:, :4] @ w + self._P[:, LEVEL]
        known = float(w @ K[:4] + K[LEVEL])
        e = value - float(w @ self._x[:4] + self._x[LEVEL])
        S = known + self.noise_square
        is_armed = self.model.rows >= MODEL.learned_rows
        if not S > 0.0 or (is_armed and e * e > TUNING.gate**2 * S * max(self._doubt, 1.0)):
            if not self._refused:
                self._refused_row = row
            self._refused += 1
            self._doubt = max(self._doubt, 1.0) * TUNING.doubled
            if e * e <= max(TUNING.listed**2 * self.model.variance, TUNING.listed_rad**2):
                # Either it is wrong, or the vessel lists: the next one will tell.
                self._P[LEVEL, LEVEL] += e * e
            return False
        self._refused = 0
        self._see_noise(row, value)
        self._doubt += (e * e / S - self._doubt) / TUNING.doubt_memory
        if is_armed:
            # Most is told by readings of what is known already: after a hole an innovation is that of the motion, and
            # where that is less than it may be it would leave no noise at all.
            tells = S**-2.0
            self._told += tells - self._told / TUNING.noise_memory
            self.noise_square += (e * e - S) * tells / self._told
            self._bound_noise(TUNING.noise_range * self._largest_noise)
        K /= S
        self._x += e * K
        self._P -= S * np.multiply.outer(K, K)
        return True

    def is_lost(self, row: float) -> bool:
        """Whether readings have been held back for too long, or what it follows is nothing it knows for too long."""
        is_refused = (
            self._refused >= TUNING.refused and (row - self._refused_row) * self._interval_s >= TUNING.refused_s
        )
        return is_refused or self._odd_nodes >= TUNING.odd_nodes

    @property
    def is_astray(self) -> bool:
        """Whether to begin it again from the readings themselves: what made it odd may be past."""
        return self._odd_nodes > 0 and self._odd_nodes % TUNING.astray_nodes == 0

    def _places(self, row: float, ahead_s: Array) -> Array:
        """Of times so long after a row, among the nodes that the model looks ahead to."""
        place = (row - self._node + ahead_s / self._interval_s) / self._every + 2.0
        return np.minimum(place, len(self.model.ahead) - 1.0)

    def curve(self, row: float, ahead_s: Array) -> Array:
        """Values, without the mean, so long after a row."""
        place = self._places(row, ahead_s)
        first = _first_of_four(place, len(self.model.ahead))
        nodes = self.model.ahead @ self._x[NEWEST] + self._x[LEVEL]
        values: Array = (cubic(place - first) * nodes[first[:, None] + POINTS]).sum(axis=1)
        return values

    def variance(self, row: float, ahead_s: Array) -> Array:
        """Of the errors of :meth:`curve` against readings: what is not known of the nodes, what is to come, noise; by
        as much more as innovations are larger than they should be, and as the model predicts worse than it fits.
        """
        model = self.model
        place = self._places(row, ahead_s)
        first = _first_of_four(place, len(model.ahead))
        B = (cubic(place - first)[:, None, :] @ model.ahead[first[:, None] + POINTS])[:, 0]
        grown = np.interp(place, np.arange(len(model.grown)), model.grown)
        level = self._P[LEVEL]
        unknown = ((B @ self._P[NEWEST, NEWEST]) * B).sum(axis=1) + 2.0 * B @ level[NEWEST] + level[LEVEL]
        unknown = np.maximum(unknown, 0.0)
        found = unknown + model.square * grown + self.noise_square
        variance: Array = max(self._doubt, 1.0) * model.few * found
        return variance

    def past(self, rows: Array) -> Array:
        """The motion, about the mean, at rows that lie within the nodes."""
        place = (self._node - rows) / self._every
        first = _first_of_four(place, NODES)
        weights = cubic(place - first)
        values: Array = (weights * self._x[first[:, None] + POINTS]).sum(axis=1) + self._x[LEVEL]
        return values
