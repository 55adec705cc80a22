"""Roll and pitch beside the acceleration, live: the correction that they bring, and whether it has earned its place.

The weights come with each fit (:mod:`heaved.estimation.heave.sea.joint_design`). They are used only while the heave
with them has been nearer to the delayed heave, which no angle has a part in, than the heave without: both are held
against it all the time, and to go over takes more than to go back.
"""

from __future__ import annotations

from bisect import bisect
from collections import deque
from itertools import pairwise
from math import inf, isfinite, nan, pi, sqrt
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from heaved.estimation.heave.sea.joint_learning import CHANNELS
from heaved.estimation.heave.sea.joint_learning import TUNING as LEARNING

if TYPE_CHECKING:
    from heaved.estimation.heave.sea.joint_design import Joint
    from heaved.samples import DelayedHeave

Array = NDArray[np.float64]
Products = tuple[float, float, float]
"""Means: squared error without the angles, that error times their correction, squared correction."""


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """When the correction is used."""

    memory_s: float = 100.0
    """Of the squares of both errors."""
    told_s: float = 60.0
    """Seconds of comparisons from which they tell anything."""
    better: float = 0.95
    """RMS with the angles over that without, from which they are used,"""
    no_worse: float = 0.99
    """and from which they are not any more."""
    quick_s: float = 20.0
    """Memory of the newest errors,"""
    much_worse: float = 1.25
    """which end it at once from that ratio."""
    fades_s: float = 8.0
    """In which the correction comes and goes."""
    hole_s: float = 60.0
    """Nothing is added for so long after a hole in the angles that is longer than ..."""
    bridged_s: float = 2.0
    """... this. Over shorter ones a polynomial is drawn, once there is something on their other side: an angle of a
    wave of 7 s is off by 3 % of its amplitude then in the middle of the longest,"""
    sides: int = 4
    """through so many samples on either side,"""
    degree: int = 3
    """of that degree, at most;"""
    goes_on_s: float = 0.5
    """until then they go on as they went for so long, and stay there."""
    most_stds: float = 4.0
    """More of its standard deviations than these are not added: no wave does that, but a list, or another sea."""
    doubted_stds: float = 1.5
    """What is added beyond so many may as well be of a list that has begun: by as much the heave is not known."""
    least_m: float = 1e-5
    """Nothing is less uncertain than that."""
    reaches_s: float = 0.5
    """Before now and beyond the last node it goes on in a straight line for so long."""


TUNING: Final = Tuning()


class JointCorrection:
    """What the weights of one fit make of the last innovations and angles. Feed it what the filter's steps give.

    Attributes:
        design: the weights.
        known_s: since when what it is made of is known.
        is_too_much: more would be added now than waves explain; as of the last call of :meth:`nodes`.
        amended: how many of the last innovations may be others than they were.
    """

    def __init__(self, design: Joint) -> None:
        self.design = design
        count = 2 * len(design.nodes_s)
        fine = np.frombuffer(design.fine, dtype=np.float16).reshape(count, -1, CHANNELS)
        coarse = np.frombuffer(design.coarse, dtype=np.float16).reshape(count, -1, CHANNELS)
        self._fine_count, self._coarse_count, self._group = fine.shape[1], coarse.shape[1], design.group
        self.amended = self._fine_count
        self._fine = fine.reshape(count, -1).astype(np.float64)
        self._coarse = coarse.reshape(count, -1).astype(np.float64)
        # Each row is written twice, so that the last ones always lie in one piece.
        self._size = self._fine_count + self._group * self._coarse_count
        self._rows = np.zeros((2 * self._size, CHANNELS))
        self._means = np.zeros((2 * self._size, CHANNELS))
        self._average = np.full(self._group, 1.0 / self._group)
        self._next = 0
        self._unknown, self._known = 0, 0
        self._hole = 0
        self._told: list[tuple[float, float]] | None = None
        self._stds_m = [max(std_m, TUNING.least_m) for std_m in design.stds_m]
        self.known_s = -inf
        self.is_too_much = False
        self._midways_s = [0.5 * (before + after) for before, after in pairwise(design.nodes_s)]
        self._beyond = [0.0] * len(design.nodes_s)
        """Share of what is added at each node that may be none of the waves."""

    def fill(self, end_s: float, rows: Array) -> None:
        """Start with innovation, roll and pitch (n, 3) of the samples up to ``end_s``; nan: not known."""
        for i, (y, roll_rad, pitch_rad) in enumerate(rows[-self._size :].tolist(), 1 - min(len(rows), self._size)):
            self.push(end_s + i * self.design.dt_s, y, roll_rad, pitch_rad)

    def push(self, t_s: float, innovation: float, roll_rad: float, pitch_rad: float) -> None:
        """One sample more, one interval after the last; innovation 0 where there was none to take in, nan angles where
        they are not known.
        """
        offsets = self.design.offsets_rad
        row = self._next
        self._next = row + 1 if row + 1 < self._size else 0
        self._told = None
        is_known = isfinite(roll_rad + pitch_rad)
        if is_known:
            if self._unknown:
                self._hole, self._known, self._unknown = self._unknown, 0, 0
            self._known += 1
            angles = roll_rad - offsets[0], pitch_rad - offsets[1]
        else:
            self._unknown += 1
            angles = self._gone_on()
            if self._unknown * self.design.dt_s > TUNING.bridged_s:
                self.known_s = t_s
        self._write(0, innovation if isfinite(innovation) else 0.0, *angles)
        if is_known and 0 < self._hole * self.design.dt_s <= TUNING.bridged_s and self._known <= TUNING.sides:
            self._bridge()
        # The newest mean that is used: all that may still change is newer.
        row = (row - self._fine_count) % self._size
        self._means[row] = self._means[row + self._size] = self._average.dot(
            self._newest(self._group, self._fine_count)
        )

    def amend(self, innovations: Array) -> None:
        """The last innovations (m,), m at most :attr:`amended`, as they are known by now."""
        rows = (self._next + np.arange(-len(innovations), 0)) % self._size
        self._rows[rows, 0] = self._rows[rows + self._size, 0] = innovations
        self._told = None

    def _write(self, before: int, *values: float) -> None:
        """The last values of the row that is so many before the newest."""
        row = (self._next - 1 - before) % self._size
        self._rows[row, -len(values) :] = self._rows[row + self._size, -len(values) :] = values

    def _newest(self, count: int, before: int = 0) -> Array:
        """A view of ``count`` rows up to the one that is ``before`` the newest."""
        end = self._next + self._size - before
        return self._rows[end - count : end]

    def _gone_on(self) -> tuple[float, float]:
        """The angles at a sample that has none."""
        if self._unknown * self.design.dt_s > TUNING.goes_on_s:
            _, roll_rad, pitch_rad = self._newest(1, 1)[0].tolist()
            return roll_rad, pitch_rad
        before = self._newest(TUNING.sides, self._unknown)[:, 1:]
        slope = (before[-1] - before[0]) / (TUNING.sides - 1)
        roll_rad, pitch_rad = (before[-1] + self._unknown * slope).tolist()
        return roll_rad, pitch_rad

    def _bridge(self) -> None:
        """Draw what was missing between the last samples and those before the hole."""
        sides, hole, known = TUNING.sides, self._hole, self._known
        places = np.arange(sides + hole + known)
        is_drawn = (places >= sides) & (places < sides + hole)
        of = polynomial.polyfit(
            places[~is_drawn], self._newest(len(places))[~is_drawn, 1:], min(known + 1, TUNING.degree)
        )
        for i, angles in enumerate(polynomial.polyval(places[is_drawn], of).T.tolist(), 1):
            self._write(hole + known - i, *angles)

    def nodes(self) -> list[tuple[float, float]]:
        """Heave and its velocity to be added at each of the nodes, less of it where that is more than waves explain."""
        if self._told is None:
            end, fine = self._next + self._size, self._fine_count
            newest = self._rows[end - fine : end].ravel()
            last = end - fine
            means = self._means[last - 1 - self._group * (self._coarse_count - 1) : last : self._group].ravel()
            found = self._fine.dot(newest) + self._coarse.dot(means)
            self._told = []
            self.is_too_much = not abs(float(found[0])) <= TUNING.most_stds * self._stds_m[0]
            told = found.tolist()
            for k, (heave_m, velocity_mps, std_m) in enumerate(zip(told[::2], told[1::2], self._stds_m, strict=True)):
                stds = abs(heave_m) / std_m
                share = 1.0 if stds <= TUNING.most_stds else TUNING.most_stds / stds if isfinite(stds) else 0.0
                self._told.append((share * heave_m, share * velocity_mps) if share else (0.0, 0.0))
                self._beyond[k] = 1.0 - TUNING.doubted_stds / stds if stds > TUNING.doubted_stds else 0.0
        return self._told

    def at(self, tau_s: float) -> tuple[float, float]:
        """Heave (m) and velocity (m/s) to be added ``tau_s`` after the last sample: a cubic between the nodes."""
        nodes_s, told = self.design.nodes_s, self.nodes()
        if tau_s <= 0.0 or len(nodes_s) == 1 or tau_s >= nodes_s[-1]:
            k = 0 if tau_s <= 0.0 or len(nodes_s) == 1 else -1
            heave_m, velocity_mps = told[k]
            reach_s = min(max(tau_s - nodes_s[k], -TUNING.reaches_s), TUNING.reaches_s)
            return heave_m + reach_s * velocity_mps, velocity_mps
        k = 0
        while tau_s > nodes_s[k + 1]:
            k += 1
        (h0, v0), (h1, v1), width_s = told[k], told[k + 1], nodes_s[k + 1] - nodes_s[k]
        u = (tau_s - nodes_s[k]) / width_s
        slope0, slope1, rise = v0 * width_s, v1 * width_s, h1 - h0
        c2, c3 = 3.0 * rise - 2.0 * slope0 - slope1, slope0 + slope1 - 2.0 * rise
        return h0 + u * (slope0 + u * (c2 + u * c3)), (slope0 + u * (2.0 * c2 + 3.0 * u * c3)) / width_s

    def doubted(self, tau_s: float) -> float:
        """Share of what is added ``tau_s`` after the last sample that may be none of the waves: that of the node which
        is nearest.
        """
        self.nodes()
        return self._beyond[bisect(self._midways_s, tau_s)]

    def ratio(self, tau_s: float, shown: float) -> float:
        """Standard deviation of the heave with it over that without, ``tau_s`` after the last sample, 1 at most;
        ``shown``: what experience has that to be now.
        """
        nodes_s, ratios = self.design.nodes_s, self.design.ratios
        less = max(shown / ratios[0], 1.0)
        if tau_s <= 0.0:
            return min(ratios[0] * less, 1.0)
        for k in range(len(nodes_s) - 1):
            if tau_s <= nodes_s[k + 1]:
                share = (tau_s - nodes_s[k]) / (nodes_s[k + 1] - nodes_s[k])
                return min(((1.0 - share) * ratios[k] + share * ratios[k + 1]) * less, 1.0)
        return min(ratios[-1] * less, 1.0)

    def heads(self, yaw_rad: float) -> bool:
        """Whether that is the heading for which the weights are, or one of the two is not known: waves that come from
        elsewhere move the hull otherwise.
        """
        turned_rad = (yaw_rad - self.design.heading_rad + pi) % (2.0 * pi) - pi
        return not abs(turned_rad) > LEARNING.turned_rad

    def is_known(self, t_s: float) -> bool:
        """Whether what it is made of has no hole any more that matters."""
        return t_s - self.known_s > TUNING.hole_s


class Experience:
    """How the heave with and without the angles has fared against the delayed heave, and how much of the correction
    would have served best.

    Attributes:
        weight: of the correction, 0 to 1.
        shown: RMS error with that weight over that without; nan: not known, infinite: it is not to be used, and fades.
    """

    def __init__(self, size: int) -> None:
        """``size``: how many steps of the filter the delayed heave is late, at most."""
        self._waiting: deque[tuple[float, float, float]] = deque(maxlen=size)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.weight, self.shown = 0.0, nan
        self._left = nan
        self._best = 0.0
        self._is_better = False
        self._waiting.clear()
        self._slow = self._quick = (0.0, 0.0, 0.0)
        self._seconds = 0.0

    def say(self, t_s: float, alone_m: float, more_m: float) -> None:
        """At ``t_s`` the heave was ``alone_m`` without the angles, and by ``more_m`` another with them."""
        self._waiting.append((t_s, alone_m, more_m))

    def check(self, delayed: DelayedHeave, dt_s: float) -> None:
        """Hold both against what is known later."""
        waiting = self._waiting
        while waiting and waiting[0][0] < delayed.t_s - 0.5 * dt_s:
            waiting.popleft()
        if not waiting or waiting[0][0] > delayed.t_s + 0.5 * dt_s:
            return
        _, alone_m, more_m = waiting.popleft()
        error_m = delayed.heave_m - alone_m
        products = error_m * error_m, error_m * more_m, more_m * more_m
        self._seconds = min(self._seconds + dt_s, TUNING.memory_s)
        self._slow = _followed(self._slow, products, dt_s / self._seconds)
        self._quick = _followed(self._quick, products, dt_s / min(self._seconds, TUNING.quick_s))
        self._judge()

    def _judge(self) -> None:
        alone, both, square = self._slow
        if self._seconds < TUNING.told_s or not (alone > 0.0 and square > 0.0):
            return
        self._best = min(max(both / square, 0.0), 1.0)
        self._left = sqrt(max(_left(self._slow, self._best), 0.0) / alone)
        newest = _left(self._quick, self._best)
        is_bad = newest > TUNING.much_worse**2 * self._quick[0] and newest > alone
        limit = TUNING.no_worse if self._is_better else TUNING.better
        self._is_better = self._left < limit and not is_bad

    def step(self, dt_s: float, *, may_be_used: bool) -> float:
        """The weight of the correction, ``dt_s`` after the last time."""
        change = dt_s / TUNING.fades_s
        is_used = self._is_better and may_be_used
        wanted = self._best if is_used else 0.0
        self.shown = self._left if is_used else inf
        self.weight += min(max(wanted - self.weight, -change), change)
        return self.weight


def _followed(means: Products, products: Products, share: float) -> Products:
    """The means with that share of the newest."""
    (a, b, c), (x, y, z) = means, products
    return a + share * (x - a), b + share * (y - b), c + share * (z - c)


def _left(means: Products, weight: float) -> float:
    """Mean square of the error with that weight of the correction."""
    alone, both, square = means
    return alone - 2.0 * weight * both + weight * weight * square
