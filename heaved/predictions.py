"""Predictions of one moment for several horizons, kept as columns.

A pipeline predicts with every sample, and few of those who get a frame look at all of it. So predictions stay the
columns that they were worked out as, and are the sequences of records that a :class:`heaved.samples.MotionFrame` speaks
of for whoever asks. Frames share the columns that have not changed: nobody writes to them.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from functools import cache
from math import inf, nan, pi
from typing import Final, Self, TypeVar, overload

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.block_outlook import Moment, worked_out
from heaved.samples import HeaveForecast, RockPrediction

Array = NDArray[np.float64]

TURN: Final = 2.0 * pi
Record = TypeVar("Record", HeaveForecast, RockPrediction)
Yaw = TypeVar("Yaw", float, Array)


def turned(yaw_rad: Yaw) -> Yaw:
    """The same heading, 0 <= yaw < 2 pi."""
    return yaw_rad % TURN % TURN  # x % 2 pi may round up to 2 pi


class Limits(msgspec.Struct, frozen=True):
    """What channels that are predicted never do."""

    largest: tuple[float, ...]
    """Magnitude of each of n channels."""
    rate: float
    """Of all of them, per second."""

    def left_by(self, curves: Array, at_s: tuple[float, ...]) -> NDArray[np.bool_]:
        """Which of the values (..., H, n) at H moments lie beyond the limits, or cannot follow the one before; what is
        not known does neither."""
        largest, steps = _largest(self, at_s)
        beyond: NDArray[np.bool_] = np.abs(curves) > largest
        beyond[..., 1:, :] |= np.abs(curves[..., 1:, :] - curves[..., :-1, :]) > steps
        return beyond

    def kept(self, curves: Array, at_s: tuple[float, ...]) -> Array:
        """The same values; nan from where on the limits are left."""
        beyond = self.left_by(curves, at_s)
        return np.where(np.logical_or.accumulate(beyond, axis=-2), nan, curves) if beyond.any() else curves


@cache
def _largest(limits: Limits, at_s: tuple[float, ...]) -> tuple[Array, Array]:
    """Values, and changes from one moment to the next."""
    return np.array(limits.largest), limits.rate * np.diff(at_s)[:, None]


NO_LIMITS: Final = Limits((inf, inf, inf), inf)


class _Predictions(Sequence[Record]):
    """One record per horizon, made when it is asked for."""

    __slots__ = ("horizons_s",)
    horizons_s: tuple[float, ...]

    def __len__(self) -> int:
        return len(self.horizons_s)

    @abstractmethod
    def __iter__(self) -> Iterator[Record]: ...

    @overload
    def __getitem__(self, index: int) -> Record: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Record]: ...
    def __getitem__(self, index: int | slice) -> Record | Sequence[Record]:
        return tuple(self)[index]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    def __hash__(self) -> int:
        return hash(tuple(self))

    def __repr__(self) -> str:
        return repr(tuple(self))


class RockPredictions(_Predictions[RockPrediction]):
    """Roll, pitch and yaw, their standard deviations and half-widths of their intervals, each (H, 3), for each horizon
    (H,). Yaw is counted from ``yaw_from_rad`` without jumps, as a regression sees it; records have the heading."""

    __slots__ = ("_angles_rad", "_limits", "intervals_rad", "stds_rad", "yaw_from_rad")

    def __init__(
        self,
        horizons_s: tuple[float, ...],
        angles_rad: Array | Moment,
        yaw_from_rad: float,
        stds_rad: Array,
        intervals_rad: Array,
        limits: Limits = NO_LIMITS,
    ) -> None:
        """``limits``: of the angles; what is beyond them is not known."""
        self.horizons_s, self._angles_rad, self.yaw_from_rad = horizons_s, angles_rad, yaw_from_rad
        self.stds_rad, self.intervals_rad, self._limits = stds_rad, intervals_rad, limits

    @property
    def angles_rad(self) -> Array:
        """(H, 3)."""
        angles_rad = self._angles_rad
        if isinstance(angles_rad, tuple):
            outlook, place, off = angles_rad
            angles_rad = self._angles_rad = outlook.at(place, off)
        if self._limits is not NO_LIMITS:
            angles_rad = self._angles_rad = self._limits.kept(angles_rad, self.horizons_s)
            self._limits = NO_LIMITS
        return angles_rad

    def of_uncertain_time(self, std_s: float) -> RockPredictions:
        """The same where it is known so well only of when they are: they are off by as much of their own rates."""
        angles_rad = self.angles_rad
        off = std_s * np.abs(np.gradient(angles_rad, np.array(self.horizons_s), axis=0))
        intervals_rad = np.hypot(self.intervals_rad, 2.0 * off)
        return RockPredictions(
            self.horizons_s, angles_rad, self.yaw_from_rad, np.hypot(self.stds_rad, off), intervals_rad
        )

    @staticmethod
    def angles_of(several: Sequence[RockPredictions]) -> Array:
        """Those of N with as many horizons, (N, H, 3): see :func:`worked_out`."""
        angles_rad = worked_out([one._angles_rad for one in several])
        return several[0]._limits.kept(angles_rad, several[0].horizons_s) if several else angles_rad

    def __iter__(self) -> Iterator[RockPrediction]:
        columns = self.angles_rad.tolist(), self.stds_rad.tolist(), self.intervals_rad.tolist()
        records = [
            RockPrediction(
                horizon_s=h,
                roll_rad=roll,
                pitch_rad=pitch,
                yaw_rad=turned(yaw + self.yaw_from_rad),
                roll_std_rad=roll_std,
                pitch_std_rad=pitch_std,
                yaw_std_rad=yaw_std,
                roll_interval_rad=roll_interval,
                pitch_interval_rad=pitch_interval,
                yaw_interval_rad=yaw_interval,
            )
            for h, (roll, pitch, yaw), (roll_std, pitch_std, yaw_std), (
                roll_interval,
                pitch_interval,
                yaw_interval,
            ) in zip(self.horizons_s, *columns, strict=True)
        ]
        return iter(records)

    @classmethod
    def unknown(cls, horizons_s: tuple[float, ...]) -> Self:
        """Nothing is known for any of the horizons."""
        nothing = np.full((len(horizons_s), 3), nan)
        return cls(horizons_s, nothing, 0.0, nothing, nothing)

    @classmethod
    def of(cls, found: Sequence[RockPrediction], horizons_s: tuple[float, ...]) -> Self:
        """Those of ``found`` for these horizons, nan where there is none; mostly they are just these."""
        if isinstance(found, cls) and found.horizons_s == horizons_s:
            return found
        records = _at(found, horizons_s, RockPrediction(horizon_s=nan))
        angles = np.array([(one.roll_rad, one.pitch_rad, one.yaw_rad) for one in records])
        stds = np.array([(one.roll_std_rad, one.pitch_std_rad, one.yaw_std_rad) for one in records])
        intervals = np.array([(one.roll_interval_rad, one.pitch_interval_rad, one.yaw_interval_rad) for one in records])
        return cls(horizons_s, angles, 0.0, stds, intervals)


def _at(found: Sequence[Record], horizons_s: tuple[float, ...], unknown: Record) -> list[Record]:
    by_horizon = {one.horizon_s: one for one in found}
    return [by_horizon.get(h, unknown) for h in horizons_s]
