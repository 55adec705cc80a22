"""The experts of the direct predictor: what they learn from, how they have fared, which of them is published.

Every 0.2 s a row is kept: what was published, and whether it may be learned from. About once a second the new rows are
completed with what each expert made of them, those whose targets have become known are scored, and the best expert is
chosen; every few seconds they are summed into normal equations, and some sets of those, in turn, are solved. In between
nothing changes but the samples, so what is published is one matrix (:attr:`Learner.weights`) on the vectors of
:mod:`heaved.estimation.rock.features`.
"""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from heaved.estimation.rock.features import Around, Indices, Regressors, SampleWindow, around, samples_per_step

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.estimation.rock.experts import Switch
    from heaved.estimation.rock.gate import Channel

Array = NDArray[np.float64]

FADING, HOLD, MEAN = 3, 4, 5
"""The experts that are not regressions."""
RATELESS: Final = 6
"""From here on, where rates are given: the regressions again, on the same equations but without them. What shakes a
gyroscope, or is wrong with it, shall not make predictions worse than they would be without one."""
SHOWN, HALF_WIDTH = -2, -1
"""After what the experts made of a row: what was published, and the half-width of its interval."""
ALL: Final = slice(None)
UNUSABLE: Final = -1
"""Age of a row that is neither scored nor learned from."""


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What this file is set to."""

    expert_spans_s: tuple[float, ...] = (2.0, 10.0, 40.0)
    """Lags of the regressions."""
    expert_memory: tuple[float, ...] = (0.4, 0.7, 1.0)
    """Their memory over that of the configuration."""
    extrapolated_s: float = 0.5
    """Up to this horizon the residual to the fading-memory extrapolation is fitted."""
    ridge: float = 0.1
    """Ridge over the noise variance of a feature: that of a sample, for which the square of the one-step error stands,
    over the samples in a mean."""
    rate_ridge: float = 0.3
    """The same of rates, over that of the others: scaled as they are, they have so much less noise."""
    least_ridge: float = 1e-12
    """Over the mean diagonal: what double precision leaves of a motion without noise."""
    overdetermined: float = 1.5
    """Equations per unknown before they are solved."""
    aimed_s: float = 0.05
    """What is learned is the motion, not the noise of single readings: the cubic through so much on either side of a
    moment (at 100 Hz a fifth of the variance of the noise)."""
    aimed_known: float = 0.3
    """Share of those samples that were measured, at least, where there are more than it takes to interpolate: at such
    rates the missing ones are filled well."""
    first_batch_s: float = 0.5
    batch_s: float = 4.0
    """Equations are summed and solved so often: at first, and in the end."""
    growth: int = 50
    """Batches' worth of rows after which a batch is made of twice as many."""
    row_s: float = 0.2
    """Errors and equations closer together than this are hardly different ones."""
    solved_per_batch: int = 3
    """Sets of equations (three spans of lags, short and long horizons) solved in a batch, in turn: each every 8 s in
    the end, a fortieth of the memory."""
    shaking_s: float = 30.0
    """Memory of what shakes a channel: that of errors."""
    smoothed_s: float = 0.6
    smoothed_degree: int = 4
    """Of the fit that tells the motion from what shakes it, on either side; odd powers make no difference."""
    on_time: float = 0.02
    """Deviation from a whole sample that makes no difference."""


TUNING: Final = Tuning()


def first_choice(horizons_s: Array) -> Indices:
    """(H,) experts before any error is known."""
    return np.where(horizons_s <= TUNING.extrapolated_s, FADING, HOLD).astype(np.intp)


def expert_count(*, rates: bool) -> int:
    """How many there are."""
    return RATELESS + len(TUNING.expert_spans_s) if rates else RATELESS


class Learner:
    """Rings of rows and the experts' equations, for one sample interval; H horizons, n channels, E experts."""

    def __init__(
        self,
        horizons_s: Array,
        interval_s: float,
        memory_s: float,
        choice_s: float,
        *,
        knots: Indices,
        window: SampleWindow,
        regressors: Regressors,
        switch: Switch,
    ) -> None:
        """``memory_s``: of the regression with the longest lags; ``choice_s``: from one choice to the next."""
        self._window, self._regressors, self._switch = window, regressors, switch
        self.every = every = max(1, round(TUNING.row_s / interval_s))
        """Samples from one row to the next."""
        spacing_s = self._spacing_s = every * interval_s
        self._most_rows = max(1, round(TUNING.batch_s / spacing_s))
        self._spans = np.array([round(s / interval_s) for s in TUNING.expert_spans_s])
        self._longest = int(self._spans[-1])
        self._rateless = switch.experts > RATELESS
        plain = np.zeros(RATELESS - FADING, dtype=np.intp)
        again = self._spans if self._rateless else self._spans[:0]
        self._floor = np.concatenate([self._spans, plain, again])[:, None]
        features = len(regressors.features)
        fronts = regressors.fronts
        lags = [int(np.searchsorted(knots, span + 0.5)) - 2 for span in self._spans]
        self._ridge = np.full(features, TUNING.ridge / samples_per_step(interval_s))
        self._ridge[regressors.rate_features] *= TUNING.rate_ridge
        self._sizes = [fronts + max(lag, 1) for lag in lags[:-1]] + [features]

        # Where the reading of each horizon lies, and the motion there, in samples and in rows.
        self._reading = around(horizons_s / interval_s, 1)
        self._whole = bool(np.all(self._reading.weights == (0.0, 1.0, 0.0, 0.0)))
        half = round(TUNING.aimed_s / interval_s)
        self._motion = around(horizons_s / interval_s, half)
        self._aimed_known = TUNING.aimed_known if half > 1 else 1.0
        self._delay = np.ceil(np.maximum(self._reading.last, self._motion.last) / every).astype(np.intp)
        self._h = np.arange(len(horizons_s))
        self.shaking_taps = shaking_taps(interval_s)
        self._shaking_share = float(self.shaking_taps @ self.shaking_taps) or 1.0
        """Of white noise, that they show."""
        half = len(self.shaking_taps) // 2
        self._shaking_places = np.arange(-half, half + 1)
        self._soon = int(np.count_nonzero(horizons_s < (1.0 - TUNING.on_time) * interval_s))

        # Horizons that share a set of equations: those whose targets are known early, and the others.
        early = int(np.count_nonzero(horizons_s <= TUNING.extrapolated_s))
        self._groups = [g for g in (slice(0, early), slice(early, len(horizons_s))) if g.stop > g.start]
        n, count = switch.best.shape[1], len(horizons_s)
        self.shaking_square, self._shaking_rows = np.zeros(n), np.zeros(n)
        """Mean square of what shakes each channel, over so many rows."""
        memory = [memory_s * share / spacing_s for share in TUNING.expert_memory]
        self._equations = [
            [NormalEquations(n, g.stop - g.start, p, m) for p, m in zip(self._sizes, memory, strict=True)]
            for g in self._groups
        ]
        self._turn = 0
        self._build_experts(early)
        self._most_choice = max(1, round(choice_s / spacing_s))
        self._build_rings(n, count)
        self._unlearned = 0
        """Rows scored since equations were summed."""
        self._schedule(max(1, round(TUNING.first_batch_s / spacing_s)))
        self._until_batch = self._rows
        self.weights = self._weights()
        """(n, H, width): what is published of a channel's vector."""

    def _build_experts(self, early: int) -> None:
        """Every one is linear: coefficients on the features, added to the extrapolation or to the newest mean."""
        regressors, (count, n), features = self._regressors, self._switch.best.shape, len(self._regressors.features)
        self._parts = np.concatenate([regressors.features, regressors.taps[:count], regressors.newest[None]])
        self._row_map = self._parts.T.copy()
        self._p = features
        experts = self._switch.experts
        regressions = np.r_[:FADING, RATELESS:experts]
        self._coefficients = np.zeros((n, count, experts, len(self._parts)))
        self._coefficients[:, :, regressions, :features] = np.nan
        self._coefficients[:, :, MEAN, 0] = 1.0
        self._base = np.full((count, experts), -1)
        """Column of what the features are added to."""
        self._base[:early, regressions] = features + self._h[:early, None]
        self._base[:, FADING] = features + self._h
        np.put_along_axis(self._coefficients, self._base[None, :, :, None] % len(self._parts), 1.0, axis=3)

    def _build_rings(self, n: int, count: int) -> None:
        """Rows that wait for their targets."""
        self._kept = int(self._delay[-1]) + self._most_rows + self._most_choice + 2
        capacity = 3 * self._kept
        self._seen = np.zeros((capacity, n, len(self._parts)))
        self._made = np.full((capacity, count, self._switch.experts + 2, n), np.nan)
        self._age = np.full((capacity, n), UNUSABLE, dtype=np.intp)
        self._row_end = self._kept  # as if there had been rows that predicted nothing
        self._rows_seen = 0

    def _schedule(self, batch: int) -> None:
        """``batch`` rows are summed at a time from now on."""
        self._batch_rows = batch
        self._rows = min(batch, self._most_choice)
        ago = np.arange(self._rows - 1, -1, -1)
        self._ends = -self.every * ago
        self._scored = -1 - ago[:, None] - self._delay
        self._due = -1 - self.every * (ago[:, None] + self._delay)

    # -- rows ------------------------------------------------------------------------------------------------------

    def keep(self, shown: Array, channels: Sequence[Channel]) -> bool:
        """A row as of the latest sample: what was published (H, n). True: a batch is due."""
        if self._row_end == len(self._age):
            start = self._row_end - self._kept
            for ring in (self._seen, self._made, self._age):
                ring[: self._kept] = ring[start:]
            self._row_end = self._kept
        row = self._row_end
        self._made[row, :, SHOWN] = shown
        ages = []
        for channel in channels:
            if channel.unsettled > 0:
                channel.unsettled -= self.every
            ages.append(channel.calm if channel.since > 0 and channel.unsettled <= 0 else UNUSABLE)
        self._age[row] = ages
        self._row_end += 1
        self._rows_seen += 1
        self._until_batch -= 1
        return self._until_batch == 0

    def forget(self, channel: int | slice) -> None:
        """What was predicted of a channel is not to be compared with what comes."""
        self._age[:, channel] = UNUSABLE
        self._made[:, :, SHOWN, channel] = np.nan

    def unlearn(self, channel: int, since: int) -> None:
        """The last so many samples of a channel are not to be learned from, and what was learned before has to show
        again what it is worth.
        """
        self._age[self._row_end - 1 - since // self.every : self._row_end, channel] = UNUSABLE
        self._switch.doubt(channel, self._floor[:, 0] > 0)

    # -- once a second, and every few ----------------------------------------------------------------------------

    def batch(self, channels: Sequence[Channel]) -> bool:
        """Score what came true and choose; learn and solve when it is time. True: the weights are new."""
        self._complete()
        self._score()
        self._unlearned += self._rows
        if is_due := self._unlearned >= self._batch_rows:
            self._widen(channels)
            self._learn(channels)
        self._until_batch = self._rows
        before = self._switch.best
        self._switch.choose(np.array([channel.calm for channel in channels]) >= self._floor)
        if not is_due and (self._switch.best is before or np.array_equal(before, self._switch.best)):
            return False
        self.weights = self._weights()
        return True

    def _widen(self, channels: Sequence[Channel]) -> None:
        """Deviations are no less than what shakes the channel: a steady vibration is predicted with the motion, and who
        asks for the motion of the ship is told how far off it is.

        Horizons shorter than an interval are not known better than the next sample is: what is measured there is
        interpolated from the very samples that were predicted from, and their noise cancels.
        """
        window, n = self._window, len(channels)
        ago = self.every * np.arange(self._unlearned)
        about = window.end - 1 - len(self.shaking_taps) // 2 - ago
        off = self.shaking_taps @ window.x[about[:, None] + self._shaking_places, :n]
        known = window.known[about, :n]
        count = known.sum(axis=0)
        square = np.where(known, off * off, 0.0).sum(axis=0) / np.maximum(count, 1) / self._shaking_share
        self._shaking_rows = np.minimum(self._shaking_rows + count, TUNING.shaking_s / self._spacing_s)
        share = np.minimum(count, self._shaking_rows) / np.maximum(self._shaking_rows, 1.0)
        self.shaking_square += share * (square - self.shaking_square)
        least = self._switch.least_square
        least[:] = self.shaking_square
        if self._soon:
            least[: self._soon] = np.maximum(self.shaking_square, [channel.step_square for channel in channels])

    def _complete(self) -> None:
        """What is seen from the new rows, and what each expert makes of it."""
        rows = slice(self._row_end - self._rows, self._row_end)
        seen = self._seen[rows] = self._regressors.at(self._window.end + self._ends) @ self._row_map
        n, count, experts, parts = self._coefficients.shape
        made = self._coefficients.reshape(n, count * experts, parts) @ seen.transpose(1, 2, 0)
        self._made[rows, :, :experts] = made.reshape(n, count, experts, -1).transpose(3, 1, 2, 0)
        self._made[rows, :, HALF_WIDTH] = self._switch.half_width

    def _score(self) -> None:
        """What came true, against readings."""
        rows, h = self._row_end + self._scored, self._h
        measured, known = self._were(self._reading, self._due)
        if not known.all():
            measured[~known.all(axis=2)] = np.nan
        made, age = self._made[rows, h], self._age[rows]
        error = measured[:, :, None] - made[:, :, :HALF_WIDTH]
        if age.min() < self._longest:
            error[:, :, :-1][age[:, :, None] < self._floor] = np.nan
        self._switch.score(self._spacing_s, error, made[:, :, HALF_WIDTH])

    def _were(self, target: Around, due: Indices, horizons: slice = ALL) -> tuple[Array, NDArray[np.bool_]]:
        """What came to be at these horizons after samples ``due`` (R, 1 or H) from the end, (R, H, n), and which of the
        samples (R, H, W, n) it is made of were measured, or make no difference.
        """
        window, n = self._window, self._age.shape[1]
        first, weights = window.end + due + target.first[horizons], target.weights[horizons]
        if target is self._reading and self._whole:
            return window.x[first + 1, :n], window.known[first + 1, :n][:, :, None]
        support = first[:, :, None] + np.arange(weights.shape[1])
        value: Array = (weights[:, None, :] @ window.x[support, :n])[:, :, 0]
        return value, window.known[support, :n] | (weights == 0.0)[:, :, None]

    def _learn(self, channels: Sequence[Channel]) -> None:
        for equations, group in zip(self._equations, self._groups, strict=True):
            self._sum(equations, group)
        self._unlearned = 0
        for _ in range(TUNING.solved_per_batch):
            self._solve(*divmod(self._turn, len(self._sizes)), channels)
            self._turn = (self._turn + 1) % (len(self._groups) * len(self._sizes))
        if self._batch_rows < self._most_rows and self._rows_seen >= TUNING.growth * self._batch_rows:
            self._schedule(min(2 * self._batch_rows, self._most_rows))

    def _sum(self, equations: Sequence[NormalEquations], group: slice) -> None:
        delay = int(self._delay[group.stop - 1])
        end = self._row_end - delay
        rows = slice(end - self._unlearned, end)
        due = -1 - self.every * (delay + np.arange(self._unlearned - 1, -1, -1))[:, None]
        moved, known = self._were(self._motion, due, group)
        if not known.all():
            moved[known.mean(axis=2) < self._aimed_known] = np.nan
        seen = self._seen[rows].transpose(1, 0, 2)
        wanted = moved.transpose(2, 0, 1) - seen[:, :, self._base[group, 0]]
        augmented = np.concatenate([wanted, seen[:, :, : self._p]], axis=2)
        targets, age = group.stop - group.start, self._age[rows]
        youngest = age.min()
        used = age >= self._spans[0]
        if not isfinite(wanted.sum()):
            used &= np.isfinite(wanted).all(axis=2).T
        moments = moments_of(augmented, used)
        for expert, span, size in zip(equations, self._spans, self._sizes, strict=True):
            if youngest < span and not ((age >= span) | ~used).all():  # fewer equations than of the shorter lags
                used &= age >= span
                moments = moments_of(augmented, used)
            expert.add(moments[:, : targets + size, : targets + size], used.sum(axis=0))

    def _solve(self, g: int, expert: int, channels: Sequence[Channel]) -> None:
        group, equations = self._groups[g], self._equations[g][expert]
        whole = np.arange(self._sizes[expert])
        kept = np.delete(whole, self._regressors.rate_features)
        for c, channel in enumerate(channels):
            ridge = channel.noise_square * self._ridge
            self._set(c, group, expert, whole, equations.solve(c, ridge))
            if self._rateless:
                self._set(c, group, RATELESS + expert, kept, equations.solve(c, ridge, kept))

    def _set(self, c: int, group: slice, expert: int, features: Indices, found: Array | None) -> None:
        """Coefficients of an expert on these features, as far as there are any."""
        if found is not None:
            of_all = self._coefficients[c, group, expert, : self._p]
            of_all[:] = 0.0
            of_all[:, features] = found

    def _weights(self) -> Array:
        best = self._switch.best
        chosen = self._coefficients[np.arange(best.shape[1]), self._h[:, None], best]  # (H, n, parts)
        weights: Array = (chosen @ self._parts).transpose(1, 0, 2)
        return weights


def shaking_taps(interval_s: float) -> Array:
    """Weights (2 L + 1,) on the samples about one of them: what of it is no wave motion, but vibration and noise.

    What is left by a polynomial fitted with weights that fall to zero: 1e-6 of a motion of 5 s period, 3 % of one of
    1 s, half at 0.5 s, and all that is faster than 2.5 Hz. Nothing, where samples come so seldom that the polynomial
    goes through all of them.
    """
    half = round(TUNING.smoothed_s / interval_s)
    place = np.arange(-half, half + 1) / (half + 1)
    powers = place[:, None] ** np.arange(0, TUNING.smoothed_degree + 1, 2)
    if half < powers.shape[1]:
        return np.zeros(len(place))
    root = np.cos(0.5 * np.pi * place)
    smooth = (np.linalg.pinv(root[:, None] * powers) * root)[0]
    return np.asarray((place == 0.0) - smooth, dtype=np.float64)


def moments_of(rows: Array, used: NDArray[np.bool_]) -> Array:
    """Sums of products (n, w, w) over those of R equations (n, R, w) that are ``used`` (R, n); others may hold nan."""
    if not used.all():
        rows = np.where(used.T[:, :, None], rows, 0.0)
    moments: Array = rows.transpose(0, 2, 1) @ rows
    return moments


class NormalEquations:
    """Exponentially weighted normal equations: every horizon of an expert from one matrix.

    Moments of [targets | features] per channel, (n, H + p, H + p): the Gram matrix and the right sides in one.
    """

    def __init__(self, channels: int, targets: int, features: int, memory: float) -> None:
        """``memory``: of how many equations the weight falls to 1/e."""
        self._targets, self._features = targets, features
        self._memory = memory
        self._moments = np.zeros((channels, targets + features, targets + features))
        self._count = np.zeros(channels)

    def add(self, moments: Array, count: Array) -> None:
        """Moments of :func:`moments_of`, or their leading part, and of how many equations, (n,).

        Nothing is forgotten where nothing is learned.
        """
        keep = np.exp(-count / self._memory)
        self._moments *= keep[:, None, None]
        self._moments += moments
        self._count *= keep
        self._count += count

    def solve(self, channel: int, ridge: Array, features: Indices | None = None) -> Array | None:
        """Coefficients (H, p) with ``ridge`` (p,) per equation added to the diagonal, on these ``features`` alone or on
        all; None: not enough, or not definite.
        """
        count = float(self._count[channel])
        if features is None:
            features = np.arange(self._features)
        if count < TUNING.overdetermined * len(features):
            return None
        h = self._targets
        moments = self._moments[channel]
        there = h + features
        gram = moments[np.ix_(there, there)]
        diagonal = gram.ravel()[:: len(features) + 1]
        diagonal += count * ridge[features] + TUNING.least_ridge * float(diagonal.sum()) / len(features) + 1e-300
        _, solution, failed = dposv(gram, moments[there, :h], lower=1)
        if failed:
            return None
        coefficients: Array = solution.T
        return coefficients
