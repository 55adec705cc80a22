"""Health of each column of a recording: how often it comes, what is missing, what stands still. Pure."""

from __future__ import annotations

from math import nan, sqrt
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.report.statistics import Moments

Array = NDArray[np.float64]

FIRST: Final = 64
"""Values from which the usual interval is known: their median."""
GAP: Final = 2.5
"""Usual intervals between two values are a gap."""


class ColumnHealth(msgspec.Struct, frozen=True, kw_only=True):
    """What one column of the recording was like; nan: not known."""

    device: str
    column: str
    values: int
    """Cells that hold a number."""
    rate_hz: float
    """Of the values, the gaps between them left out."""
    jitter_s: float
    """Standard deviation of their intervals, likewise."""
    gaps: int
    """Intervals of more than two and a half usual ones,"""
    missing_s: float
    """all of them together,"""
    longest_gap_s: float
    """and the longest."""
    unchanged_s: float
    """Longest time without another value."""
    least: float
    mean: float
    most: float
    std: float


class Column:
    """Takes down one column."""

    def __init__(self, device: str, name: str) -> None:
        self.device, self.name = device, name
        self._moments = Moments()
        self._usual_s = nan
        self._intervals, self._sum_s, self._squares = 0, 0.0, 0.0
        self._gaps, self._missing_s, self._longest_s = 0, 0.0, 0.0
        self._first: list[Array] = []
        self._last_s = self._last = nan
        self._changed_s, self._unchanged_s = nan, 0.0

    def push(self, t_s: Array, values: Array) -> None:
        """Values (n,) at increasing times; nan: the cell is blank."""
        known = np.isfinite(values)
        t_s, values = t_s[known], values[known]
        if len(t_s) == 0:
            return
        self._moments.push(values)
        # nan is unlike any value: the first one has changed.
        changed = t_s[values != np.concatenate(([self._last], values[:-1]))]
        since_s = np.concatenate(([self._changed_s], changed))
        until_s = np.concatenate((changed, t_s[-1:]))
        self._unchanged_s = float(np.fmax(self._unchanged_s, np.nanmax(until_s - since_s, initial=0.0)))
        self._changed_s = float(since_s[-1])
        steps = np.diff(t_s) if np.isnan(self._last_s) else np.diff(t_s, prepend=self._last_s)
        self._last_s, self._last = float(t_s[-1]), float(values[-1])
        self._first.append(steps)
        if sum(map(len, self._first)) >= FIRST:
            self._judge()

    def _judge(self) -> None:
        """Count the intervals that have come."""
        steps = np.concatenate([np.empty(0), *self._first])
        self._first = []
        if len(steps) == 0:
            return
        if np.isnan(self._usual_s):
            self._usual_s = float(np.median(steps))
        is_gap = steps > GAP * self._usual_s
        near, gaps = steps[~is_gap], steps[is_gap]
        self._intervals += len(near)
        self._sum_s += float(near.sum())
        self._squares += float(np.square(near - self._usual_s).sum())
        if len(gaps):
            self._gaps += len(gaps)
            self._missing_s += float(gaps.sum())
            self._longest_s = max(self._longest_s, float(gaps.max()))

    def health(self) -> ColumnHealth:
        """What it was like so far."""
        self._judge()
        n, moments = self._intervals, self._moments
        off_s = self._sum_s / n - self._usual_s if n else nan
        return ColumnHealth(
            device=self.device,
            column=self.name,
            values=moments.count,
            rate_hz=n / self._sum_s if self._sum_s > 0.0 else nan,
            jitter_s=sqrt(max(self._squares / n - off_s * off_s, 0.0)) if n else nan,
            gaps=self._gaps,
            missing_s=self._missing_s,
            longest_gap_s=self._longest_s if self._gaps else nan,
            unchanged_s=self._unchanged_s,
            least=moments.least,
            mean=moments.mean,
            most=moments.most,
            std=moments.std,
        )
