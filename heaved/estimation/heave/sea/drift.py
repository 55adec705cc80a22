"""A bias that runs away: while a sensor warms up, its level goes on in one direction as no wave does.

The filter follows a bias that wanders as far as its model says; one that leads the same way for minutes takes the heave
with it. What it leaves in the innovations is known: the answer of the steady filter to a ramp that began then and then.
So they are held against that for some moments at which it may have begun. With v the variance of the rate that is found
so, z the rate over its root, and r the standard deviation of the rates that sensors have, a beginning is likelier than
none by

    exp(z^2 s / 2) sqrt(v / (v + r^2)),      s = r^2 / (r^2 + v),

(Bayes' factor of a normal rate), and with as many beginnings in an hour as sensors have, all of them have a
probability. Innovations in which there are waves that the model does not know make a rate less certain by as much as
those are larger than what it has (:mod:`heaved.estimation.heave.sea.long_waves`): a swell that arrives is no drift.
While it is small, what each would do to the heave is in the standard deviation, as far as it is probable. When none is
no longer likely, the filter is given the rate as one more state: with the mean and the covariance of the mixture of
them all, which it had kept no account of (the bias as a second stage: Friedland 1969; a mixture taken for one normal:
Blom & Bar-Shalom 1988).

The past with a drift in it has no spectrum: :func:`removed` takes it out of the record, as steps of its rate every
quarter of a minute, found from the innovations in the same way.
"""

from __future__ import annotations

from math import exp, inf, pi, sqrt
from typing import TYPE_CHECKING, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.heave.sea.long_waves import LongWaves

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.estimation.heave.sea.model import SeaModel, SeaSystem, Steady

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What counts as a drift."""

    drifts_s: tuple[float, float] = (60.0, 120.0)
    """The walk of the bias is looked for in sums over so many seconds."""
    highest_hz: float = 1.0
    """Of what is left of a record by weights over half a minute and more, 1e-13 is faster."""
    block_s: float = 3.2
    """Beginnings are apart by so much, about, or by whole multiples of it,"""
    began: tuple[int, ...] = (2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 20, 26)
    """so many of them ago: a bias that has led the same way for longer has been found, or is slow."""
    looked_every_s: float = 1.0
    """Between two looks at them."""
    usual_s: float = 300.0
    """Memory of how far the innovations scatter about a drift on the whole: more than they should where the walk of a
    bias is more than the model has,"""
    usual_most: float = 9.0
    """as squares of at most so many times what they should."""
    most_missed: int = 2000
    """Samples that are missing on end count no more than that."""
    bounded: float = 5.0
    """Innovations count with so many standard deviations at most."""
    rates_mps3: tuple[float, float] = (4e-4, 4e-3)
    """Standard deviations of the rates of drifts: 25 mm/s2 in a minute (warming sensors: 10 to 50 in some minutes);"""
    are_fast: float = 0.1
    """and of the share of them that are faster than that."""
    every_s: float = 1800.0
    """One begins so often, on average: twice an hour is much for any sensor, and costs nothing."""
    is_one: float = 0.8
    """Probability from which the rate is a state of the filter."""
    walk: float = 0.04
    """The rate changes by this share of itself in a second's root: by a half in two and a half minutes,"""
    walks_mps3_rts: tuple[float, float] = (1e-6, 1e-4)
    """but within these bounds, m/s3 per root second."""
    changes: float = 1.5
    """A rate that changes at once, at the end of a drift, is off by more than a walk says: the standard deviation of
    the heave is so many times larger while there is one."""
    none_within: float = 2.0
    """A rate of less than so many of its standard deviations"""
    none_for_s: float = 45.0
    """for so long is none any more."""
    knot: int = 5
    """A rate is constant over so many blocks in the record."""
    kinks: float = 2.0
    """Standard deviation of the change from one of these pieces to the next, over what the walk makes: some begin and
    end at once."""
    sooner_s: float = 20.0
    """A drift is looked for in the record from so long before its beginning on: that is not known to a second."""


TUNING: Final = Tuning()


def drift_weights(count: int) -> Array:
    """(n,) weights that leave of a record how far its level goes from its first half to its second, and hardly any
    waves.
    """
    x = (np.arange(count) + 0.5) / count
    weights = -(np.sin(pi * x) ** 4) * np.cos(pi * x)
    return np.asarray(2.0 * weights / np.sum(np.abs(weights)))


def drift_variances(weights: Array, dt_s: float, model: SeaModel) -> tuple[float, float]:
    """Variance (m/s2)2 of a sum of samples every ``dt_s``, so weighed, by ``model`` but for the walk of its bias, and
    what a walk of 1 (m/s2)2/s adds.
    """
    n = 4 * len(weights)
    f: Array = np.fft.rfftfreq(n, dt_s)[1:].astype(np.float64)
    passed = np.abs(np.fft.rfft(weights, n)[1:]) ** 2 * f[0]
    f, passed = f[f <= TUNING.highest_hz], passed[f <= TUNING.highest_hz]
    walk = 2.0 / (2.0 * pi * f) ** 2
    rest = model.acceleration_spectrum(f, dt_s) - model.bias_walk_psd * walk
    return float(passed @ rest), float(passed @ walk)


class RampResponse:
    """What the steady filter makes of a bias that goes on at a rate from some moment on, which it is not told of.

    With e an error of the bias alone, the error before sample j is dt sum_{i <= j} L^i e for a rate of 1 m/s3,
    L = F (I - K H).

    Attributes:
        block: samples in a block.
        innovation: (blocks * block,) m/s2 that it leaves, from the first sample after its beginning on.
    """

    def __init__(self, system: SeaSystem, steady: Steady, blocks: int) -> None:
        H, n = system.H, len(system.H)
        self.block = max(round(TUNING.block_s / steady.dt_s), 1)
        closed = steady.F - np.outer(steady.F @ steady.K, H)
        within = np.empty((self.block, n))
        within[0] = H
        for i in range(1, self.block):
            within[i] = within[i - 1] @ closed
        power = np.linalg.matrix_power(closed, self.block)
        self._starts = np.zeros((blocks + 1, n))
        self._starts[0, -1] = 1.0
        for m in range(blocks):
            self._starts[m + 1] = power @ self._starts[m]
        self.innovation: Array = steady.dt_s * np.cumsum(self._starts[:-1] @ within.T)
        self._closed, self._dt_s, self._K, self._H = closed, steady.dt_s, steady.K, H

    def states(self, blocks: Sequence[int]) -> Array:
        """(len(blocks), n) what the state lacks, the last sample taken in, of a drift that began so many blocks ago."""
        missing = self._starts[0] - self._starts[np.asarray(blocks, dtype=np.intp)]
        before = self._dt_s * np.linalg.solve(np.eye(len(self._H)) - self._closed, missing.T)
        return np.asarray((before - np.outer(self._K, self._H @ before)).T)


class Mixture(NamedTuple):
    """Of all that may have begun, taken for one normal: what the state lacks, and the rate, as the last element."""

    mean: Array
    """(n + 1,)"""
    covariance: Array
    """(n + 1, n + 1)"""


class DriftDetector:
    """Holds the innovations of a filter against drifts that may have begun.

    Attributes:
        probability: that there is one.
        doubt_m: standard deviation of what one that is not certain, and waves that the model does not know, make of the
            heave.
        usual: (len(began),) by how much the rates scatter more than innovations of unit variance would make them.
    """

    def __init__(self, system: SeaSystem, steady: Steady, before: DriftDetector | None = None) -> None:
        """``before``: that of an earlier model, which has seen the same sensor."""
        response = RampResponse(system, steady, TUNING.began[-1])
        self._size = len(response.innovation)
        self._patterns = np.zeros((len(TUNING.began), self._size))
        for row, blocks in zip(self._patterns, TUNING.began, strict=True):
            count = blocks * response.block
            row[-count:] = response.innovation[:count] / sqrt(steady.S)
        self._long_waves = LongWaves(system, steady)
        self._states = response.states(TUNING.began)
        self._heave_m = self._states @ system.heave
        self._alone = 1.0 / np.sum(self._patterns**2, axis=1)
        """(len(began),) variance of the rates that innovations of unit variance give."""
        self.usual: Array = np.ones(len(TUNING.began)) if before is None else before.usual
        self._patterns *= self._alone[:, None]
        self._square = np.square(TUNING.rates_mps3)[:, None]
        apart_s = np.diff(TUNING.began, prepend=0) * response.block * steady.dt_s
        self._log_prior = np.log(np.outer((1.0 - TUNING.are_fast, TUNING.are_fast), apart_s / TUNING.every_s))
        self._weights = self._rates = self._variance = np.zeros((2, len(TUNING.began)))
        """For slow ones and fast ones, (2, len(began))."""
        self._innovations = np.zeros(2 * self._size)
        """In standard deviations; each is written twice, so that the last ones always lie in one piece."""
        self._next, self._looked_s = 0, -inf
        self.probability = self.doubt_m = 0.0

    def restart(self) -> None:
        """What was seen says nothing of what comes."""
        self._innovations[:] = 0.0
        self.probability = self.doubt_m = 0.0

    def push(self, scaled: float) -> None:
        """An innovation over its standard deviation; 0 where there is none, or not of the steady filter."""
        at = self._next
        scaled = min(max(scaled, -TUNING.bounded), TUNING.bounded)
        self._innovations[at] = self._innovations[at + self._size] = scaled
        self._next = at + 1 if at + 1 < self._size else 0

    def fill(self, scaled: Array) -> None:
        """Those of the past, (k,), at once: of a filter that has not been pushed anything yet."""
        last = np.clip(scaled[-self._size :], -TUNING.bounded, TUNING.bounded)
        self._innovations[self._size - len(last) : self._size] = last
        self._innovations[self._size :] = self._innovations[: self._size]

    def look(self, t_s: float) -> bool:
        """See what may have begun, when it is time for that; whether it is likely enough to be followed."""
        if t_s - self._looked_s < TUNING.looked_every_s:
            return False
        self._looked_s = t_s
        innovations = self._innovations[self._next : self._next + self._size]
        found = self._patterns.dot(innovations)
        likeliest = int(np.argmax(found**2 / self._alone))
        count = self._long_waves.count
        ramp = self._patterns[likeliest, -count:] * (found[likeliest] / self._alone[likeliest])
        unknown_m, unknown = self._long_waves.look(innovations[-count:] - ramp)
        variance = self._alone * np.maximum(np.maximum(self.usual, unknown), 1.0)
        share = self._square / (self._square + variance)
        self._rates, self._variance = share * found, share * variance
        log_odds = self._log_prior + 0.5 * (np.log1p(-share) + self._rates**2 / self._variance)
        scatter = np.minimum(found**2 / self._alone, TUNING.usual_most * np.maximum(self.usual, 1.0))
        self.usual = self.usual + TUNING.looked_every_s / TUNING.usual_s * (scatter - self.usual)
        most = max(float(np.max(log_odds)), 0.0)
        odds = np.exp(log_odds - most)
        self._weights = odds / (exp(-most) + float(np.sum(odds)))
        self.probability = float(np.sum(self._weights))
        lacks = self._weights * (self._rates**2 + self._variance) * self._heave_m**2
        self.doubt_m = sqrt(float(np.sum(lacks)) + unknown_m**2)
        return self.probability > TUNING.is_one

    def mixture(self) -> Mixture:
        """What the last look has found."""
        rows = np.column_stack((self._states, np.ones(len(self._states))))
        weights = self._weights
        mean = np.sum(weights * self._rates, axis=0) @ rows
        second = (rows.T * np.sum(weights * (self._rates**2 + self._variance), axis=0)) @ rows
        return Mixture(mean, second - np.outer(mean, mean))

    @property
    def began_s(self) -> float:
        """How long ago the likeliest began."""
        return TUNING.block_s * TUNING.began[int(np.argmax(np.sum(self._weights, axis=0)))]


def walk_of(rate_mps3: float) -> float:
    """How a rate of that size walks, m/s3 per root second."""
    low, high = TUNING.walks_mps3_rts
    return min(max(TUNING.walk * abs(rate_mps3), low), high)
