"""The one table of what is published of the motion: which quantities of which record, in which order and unit.

The stream, the table of a replay and the status read it, so that a quantity is called, converted and rounded alike
wherever it leaves the house. The rule that makes it short: a name ends in its unit, outside as inside, and but for the
unit it is the same name. So ``roll_deg`` is the ``roll_rad`` of a record in degrees. Pure.
"""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

import msgspec

from heaved.samples import (
    CraftMotion,
    DelayedHeave,
    HeaveForecast,
    HullAngles,
    MotionFrame,
    MruAgreement,
    PointMotion,
    RockPrediction,
    RockScore,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

R = TypeVar("R")
S = TypeVar("S")

_LIMIT: Final = 1e15
"""Units of the last decimal. Nothing that is published comes near it: what is beyond is as unknown as infinity."""
_ROUND: Final = 1.5 * 2.0**52
"""Adding it to a double below 2**51 and taking it away again rounds to a whole number: a third of the time of round(),
which matters for the ninety numbers of a frame."""


class Unit(msgspec.Struct, frozen=True):
    """How a number inside becomes the one outside."""

    inside: str
    """Unit in which it is kept inside, as names end in it."""
    per_inside: float
    """Outside, per unit inside."""
    decimals: int = 6
    """That are sent."""


UNITS: Final = {
    "deg": Unit("rad", 180.0 / pi),
    "degps": Unit("radps", 180.0 / pi),
    "arcsec": Unit("rad", 3600.0 * 180.0 / pi, decimals=3),
}
"""By the ending of a name outside; all others are the same inside, SI."""


def _unit(name: str) -> Unit:
    ending = name.rpartition("_")[2]
    return UNITS.get(ending, Unit(ending, 1.0))


def _inside(name: str) -> str:
    """Name of a quantity inside, by that outside."""
    return name.removesuffix(name.rpartition("_")[2]) + _unit(name).inside


class Fields(Generic[R]):
    """Some quantities of the records of kind ``R``; all are sent with as many decimals.

    What is done with them is compiled here, once, to straight code without a loop or a look-up, which takes half the
    time: a frame has ninety of them.

    Attributes:
        names: outside, in the order in which they are sent.
        sent: a record's values in that order, rounded as they are sent; None: not known (nan, infinite, absurd).
    """

    def __init__(self, *names: str, places: Sequence[str] | None = None) -> None:
        """``places``: where a record has them, ``total_rad[0]`` say; None: attributes by their names inside."""
        self.names = names
        self._places = tuple(map(_inside, names)) if places is None else tuple(places)
        self._units = tuple(map(_unit, names))
        (decimals,) = {unit.decimals for unit in self._units}
        wholes = 10.0**decimals
        self._sent = [
            f"(x + {_ROUND} - {_ROUND}) / {wholes} "
            f"if -{_LIMIT} < (x := record.{place} * {unit.per_inside * wholes}) < {_LIMIT} else None"
            for place, unit in zip(self._places, self._units, strict=True)
        ]
        self.sent: Callable[[R], tuple[float | None, ...]] = compiled(f"({', '.join(self._sent)},)")

    def only(self, *names: str) -> Fields[R]:
        """Some of them.

        Raises:
            ValueError: one is not of the table.
        """
        return Fields(*names, places=[self._places[self.names.index(name)] for name in names])

    def known(self, record: R) -> dict[str, float]:
        """Those that are known, by name, rounded as they are sent."""
        return {name: value for name, value in zip(self.names, self.sent(record), strict=True) if value is not None}

    def outside(self, record: str) -> list[str]:
        """For :func:`compiled`: expressions of these values of ``record``, in units outside, not rounded."""
        return [
            f"{record}.{place}" + f" * {unit.per_inside}" * (unit.per_inside != 1.0)
            for place, unit in zip(self._places, self._units, strict=True)
        ]

    def into(self, kind: Callable[..., S], *same: str, given: Sequence[str] = ()) -> Callable[..., S]:
        """Function that makes the record of ``kind`` that is sent of one inside: these quantities, what is ``same`` in
        both, and what it is ``given`` beside the record.
        """
        values = [f"{name}={value}" for name, value in zip(self.names, self._sent, strict=True)]
        values += [f"{name}=record.{name}" for name in same] + [f"{name}={name}" for name in given]
        return compiled(f"kind({', '.join(values)})", ["record", *given], kind=kind)


def compiled(value: str, arguments: Sequence[str] = ("record",), **names: object) -> Callable[..., Any]:
    """Function of the ``arguments`` that gives this expression of them and of these ``names``."""
    source = f"lambda {', '.join(arguments)}: {value}"
    function: Callable[..., Any] = eval(source, names)  # noqa: S307  # All of it is written in this program.
    return function


def rounded(value: float) -> float | None:
    """A number of SI units to the sixth decimal, as those of the table; None when it is not known."""
    millionths = value * 1e6
    return (millionths + _ROUND - _ROUND) / 1e6 if -_LIMIT < millionths < _LIMIT else None


# ---- the table -------------------------------------------------------------------------------------------------------

_AXES: Final = ("roll", "pitch", "yaw")

MOTION: Final = Fields[MotionFrame](
    "heave_m",
    "heave_std_m",
    "heave_velocity_mps",
    "heave_acceleration_mps2",
    "observer_m",
    "correction_m",
    "lead_s",
    "reference_m",
    *(f"{axis}_deg" for axis in _AXES),
    *(f"{axis}_rate_degps" for axis in _AXES),
    "surge_acceleration_mps2",
    "sway_acceleration_mps2",
    *(f"crane_{axis}_deg" for axis in _AXES),
)
POINT: Final = Fields[PointMotion](
    "heave_m",
    "heave_std_m",
    "heave_velocity_mps",
    "heave_acceleration_mps2",
    "own_height_m",
    "own_velocity_mps",
)
ROCK: Final = Fields[RockPrediction](
    *(f"{axis}_deg" for axis in _AXES),
    *(f"{axis}_std_deg" for axis in _AXES),
    *(f"{axis}_interval_deg" for axis in _AXES),
)
ROCK_SCORE: Final = Fields[RockScore]("error_deg", "coverage")
FORECAST: Final = Fields[HeaveForecast]("heave_m", "std_m")
DELAYED: Final = Fields[DelayedHeave]("heave_m", "std_m")
HULL: Final = Fields[HullAngles](
    *(f"{kind}{axis}_deg" for kind in ("", "static_", "dynamic_") for axis in "xyz"),
    "delay_s",
    "delay_std_s",
    places=(
        *(f"{kind}_rad[{i}]" for kind in ("total", "static", "dynamic") for i in range(3)),
        "delay_s",
        "delay_std_s",
    ),
)
HULL_STD: Final = Fields[HullAngles](
    *(f"{axis}_{kind}arcsec" for kind in ("std_", "reachable_std_") for axis in "xyz"),
    places=[f"{kind}std_rad[{i}]" for kind in ("", "reachable_") for i in range(3)],
)
ATTITUDE: Final = Fields[CraftMotion](
    "heave_m",
    "heave_std_m",
    "heave_velocity_mps",
    "heave_velocity_std_mps",
    "pitch_deg",
    "pitch_std_deg",
    "pitch_rate_degps",
    "pitch_rate_std_degps",
)


_AGREEMENT: Final = (
    "reference",
    "own",
    "difference",
    "mean_difference",
    "std_difference",
    "rms_difference",
    "explained",
)
"""Of :class:`MruAgreement`, in the unit of the quantity."""
_LIKENESS: Final = ("correlation", "delay_s", "scale")


def _agreement(unit: str) -> Fields[MruAgreement]:
    names = tuple(f"{name}_{unit}" for name in _AGREEMENT)
    return Fields(*names, *_LIKENESS, places=(*_AGREEMENT, *_LIKENESS))


MRU_HEAVE: Final = _agreement("m")
MRU_VELOCITY: Final = _agreement("mps")
MRU_ANGLE: Final = _agreement("deg")
