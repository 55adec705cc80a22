"""The experts of the direct predictor: what they learn from, how they have fared, which of them is published.

Every 0.2 s a row is kept: what was published, and whether it may be learned from. About once a second the new rows are
completed with what each expert made of them, those whose targets have become known are scored, and the best expert is
chosen; every few seconds they are summed into normal equations, and some sets of those, in turn, are solved. In between
nothing changes but the samples, so what is published is one matrix (:attr:`Learner.weights`) on the vectors of
:mod:`heaved.estimation.rock.features`.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Final

import numpy as np
from numpy.typing import NDArray

from heaved.estimation.rock.experts import Switch
from heaved.estimation.rock.features import Regressors
from heaved.estimation.rock.gate import Channel
from heaved.estimation.rock.lags import Indices, SampleWindow, between, shaking_taps
from heaved.estimation.rock.normal_equations import NormalEquations, moments_of

Array = NDArray[np.float64]

EXPERT_SPANS_S: Final = (2.0, 10.0, 40.0)
"""Lags of the regressions, s."""
EXPERT_MEMORY: Final = (0.4, 0.7, 1.0)
"""Their memory over that of the configuration."""
FADING, HOLD, MEAN = 3, 4, 5
"""The experts that are not regressions."""
RATELESS: Final = 6
"""From here on, where rates are given: the regressions again, on the same equations but without them. What shakes a
gyroscope, or is wrong with it, shall not make predictions worse than they would be without one."""
FILTER_LIKE: Final = 1
"""The one that sees as much of the past as the filter for holes."""
SHOWN, HALF_WIDTH = -2, -1
"""After what the experts made of a row: what was published, and the half-width of its interval."""
EXTRAPOLATED_S: Final = 0.5
"""Up to this horizon the residual to the fading-memory extrapolation is fitted."""
RIDGE: Final = 0.1
"""Ridge over the noise variance, for which the square of the one-step error stands."""
FIRST_BATCH_S, BATCH_S = 0.5, 4.0
"""Equations are summed and solved so often: at first, and in the end."""
GROWTH: Final = 50
"""Batches' worth of rows after which a batch is made of twice as many."""
ROW_S: Final = 0.2
"""Errors and equations closer together than this are hardly different ones."""
SOLVED_PER_BATCH: Final = 3
"""Sets of equations (three spans of lags, short and long horizons) solved in a batch, in turn: each every 8 s in the
end, a fortieth of the memory."""
SHAKING_S: Final = 30.0
"""Memory of what shakes a channel: that of errors."""
ON_TIME: Final = 0.02
"""Deviation from a whole sample that makes no difference."""
UNUSABLE: Final = -1
"""Age of a row that is neither scored nor learned from."""


def first_choice(horizons_s: Array) -> Indices:
    """(H,) experts before any error is known."""
    return np.where(horizons_s <= EXTRAPOLATED_S, FADING, HOLD).astype(np.intp)


def expert_count(*, rates: bool) -> int:
    """How many there are."""
    return RATELESS + len(EXPERT_SPANS_S) if rates else RATELESS


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
        self.every = every = max(1, round(ROW_S / interval_s))
        """Samples from one row to the next."""
        spacing_s = self._spacing_s = every * interval_s
        self._most_rows = max(1, round(BATCH_S / spacing_s))
        self._spans = np.array([round(s / interval_s) for s in EXPERT_SPANS_S])
        self._longest = int(self._spans[-1])
        self._rateless = switch.experts > RATELESS
        plain = np.zeros(RATELESS - FADING, dtype=np.intp)
        again = self._spans if self._rateless else self._spans[:0]
        self._floor = np.concatenate([self._spans, plain, again])[:, None]
        features = len(regressors.features)
        fronts = features - (len(knots) - 2)
        lags = [int(np.searchsorted(knots, span + 0.5)) - 2 for span in self._spans]
        self._sizes = [fronts + max(lag, 1) for lag in lags[:-1]] + [features]

        # Where the measured value of each horizon lies, in samples and in rows.
        self._target = between(horizons_s / interval_s)
        self._whole = bool(np.all(self._target.weights == (0.0, 1.0, 0.0, 0.0)))
        self._delay = np.ceil((self._target.first + 3) / every).astype(np.intp)
        self._h = np.arange(len(horizons_s))
        self.shaking_taps = shaking_taps(interval_s)
        half = len(self.shaking_taps) // 2
        self._shaking_places = np.arange(-half, half + 1)
        self._soon = int(np.count_nonzero(horizons_s < (1.0 - ON_TIME) * interval_s))

        # Horizons that share a set of equations: those whose targets are known early, and the others.
        early = int(np.count_nonzero(horizons_s <= EXTRAPOLATED_S))
        self._groups = [g for g in (slice(0, early), slice(early, len(horizons_s))) if g.stop > g.start]
        n, count = switch.best.shape[1], len(horizons_s)
        self.shaking_square, self._shaking_rows = np.zeros(n), np.zeros(n)
        """Mean square of what shakes each channel, over so many rows."""
        memory = [memory_s * share / spacing_s for share in EXPERT_MEMORY]
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
        self._schedule(max(1, round(FIRST_BATCH_S / spacing_s)))
        self._until_batch = self._rows
        self.weights = self._weights()
        """(n, H, width): what is published of a channel's vector."""

    def _build_experts(self, early: int) -> None:
        """Every one is linear: coefficients on the features, added to the extrapolation or to the latest block."""
        regressors, (count, n), features = self._regressors, self._switch.best.shape, len(self._regressors.features)
        self._parts = np.concatenate([regressors.features, regressors.taps[:count], regressors.block[None]])
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
        self._aims = np.full((capacity, count, n), np.nan)
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
        self._aimed = -1 - self.every * (ago[:, None] + self._delay) + self._target.first

    # -- rows ------------------------------------------------------------------------------------------------------

    def keep(self, shown: Array, channels: Sequence[Channel]) -> bool:
        """A row as of the latest sample: what was published (H, n). True: a batch is due."""
        if self._row_end == len(self._age):
            start = self._row_end - self._kept
            for ring in (self._seen, self._made, self._aims, self._age):
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
        square = np.where(known, off * off, 0.0).sum(axis=0) / np.maximum(count, 1)
        self._shaking_rows = np.minimum(self._shaking_rows + count, SHAKING_S / self._spacing_s)
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
        rows, h = self._row_end + self._scored, self._h
        window, weights, n = self._window, self._target.weights, self._age.shape[1]
        first = window.end + self._aimed
        if self._whole:
            measured: Array = window.x[first + 1, :n]
            known = window.known[first + 1, :n]
        else:
            support = first[:, :, None] + np.arange(4)
            measured = (weights[:, None, :] @ window.x[support, :n])[:, :, 0]
            known = (window.known[support, :n] | (weights == 0.0)[:, :, None]).all(axis=2)
        if not known.all():
            measured[~known] = np.nan
        self._aims[rows, h] = measured
        made, age = self._made[rows, h], self._age[rows]
        error = measured[:, :, None] - made[:, :, :HALF_WIDTH]
        if age.min() < self._longest:
            error[:, :, :-1][age[:, :, None] < self._floor] = np.nan
        self._switch.score(self._spacing_s, error, made[:, :, HALF_WIDTH])

    def _learn(self, channels: Sequence[Channel]) -> None:
        for equations, group in zip(self._equations, self._groups, strict=True):
            self._sum(equations, group)
        self._unlearned = 0
        for _ in range(SOLVED_PER_BATCH):
            self._solve(*divmod(self._turn, len(self._sizes)), channels)
            self._turn = (self._turn + 1) % (len(self._groups) * len(self._sizes))
        if self._batch_rows < self._most_rows and self._rows_seen >= GROWTH * self._batch_rows:
            self._schedule(min(2 * self._batch_rows, self._most_rows))

    def _sum(self, equations: Sequence[NormalEquations], group: slice) -> None:
        end = self._row_end - int(self._delay[group.stop - 1])
        rows = slice(end - self._unlearned, end)
        seen = self._seen[rows].transpose(1, 0, 2)
        wanted = self._aims[rows, group].transpose(2, 0, 1) - seen[:, :, self._base[group, 0]]
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
            ridge = RIDGE * channel.noise_square
            self._take(c, group, expert, whole, equations.solve(c, ridge))
            if self._rateless:
                self._take(c, group, RATELESS + expert, kept, equations.solve(c, ridge, kept))

    def _take(self, c: int, group: slice, expert: int, features: Indices, found: Array | None) -> None:
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
