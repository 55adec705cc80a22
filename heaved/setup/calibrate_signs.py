"""Whether the axes of a sensor are what its profile says: the signs of accelerations, angles and body rates.

A mounting can turn a sensor but not mirror it, so its own readings must be those of one right-handed set of axes, with
the signs of :mod:`heaved.samples`. A sensor in the hand, first flat and then lifted on one side, shows each of them.
One that is bolted down shows whether they go together: angles with the direction of the specific force, and body rates
with the way in which the angles move.
"""

from __future__ import annotations

from enum import StrEnum
from itertools import product
from math import degrees, isfinite
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.samples import GRAVITY_MPS2
from heaved.setup.calibrate_latency import coherence

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.setup.calibrate_record import Record

Array = NDArray[np.float64]

LEAST_LIFT_RAD: Final = 0.17
"""10 degrees show over everything else."""
HALF: Final = 0.5
"""Of what it should be, at the least, a change is for its sign to be told."""
END_S: Final = 2.0
"""At the beginning and at the end of a lift it is held still."""
GOES_WITH: Final = 0.9
"""Share of the motion of the angles that the rates make when all signs are right, at the least: a tenth of a second of
lateness and a lean of 5 s leave more."""
GOES_NOT: Final = 0.5
"""Below this something is wrong although no sign explains it."""
APART_RAD: Final = 0.05
"""Angles and specific force 3 degrees apart are not of the same axes."""


class Lift(StrEnum):
    """Which side of the sensor was lifted, in its own axes."""

    PORT_UP = "port side up"
    BOW_UP = "bow up"


class Sign(StrEnum):
    """What is to be said of one quantity."""

    RIGHT = "right"
    WRONG = "wrong sign"
    UNCLEAR = "does not move as it should: wrong register or axis?"
    MISSING = "not in the profile"


class Verdict(msgspec.Struct, frozen=True):
    """One quantity, and its sign."""

    quantity: str
    sign: Sign

    @property
    def is_bad(self) -> bool:
        """Whether something must be done."""
        return self.sign in (Sign.WRONG, Sign.UNCLEAR)


class SignsError(Exception):
    """A lift of which nothing can be told; the message says why and what to do."""


def judge_lift(record: Record, lift: Lift) -> list[Verdict]:
    """What a record says that begins flat and ends lifted.

    Raises:
        SignsError: nothing.
    """
    start = record.t_s <= record.t_s[0] + END_S
    end = record.t_s >= record.t_s[-1] - END_S
    force = np.array([np.nanmean(record.force_mps2[part], axis=0) for part in (start, end)])
    if not np.isfinite(force).all():
        raise SignsError("the three accelerations are not all there")
    cosine = float(force[0] @ force[1] / (np.linalg.norm(force[0]) * np.linalg.norm(force[1])))
    lifted = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    if lifted < LEAST_LIFT_RAD:
        raise SignsError(
            f"the force has turned by {degrees(lifted):.0f} degrees only: lift it by 20 to 60 degrees, and hold it so "
            "until the end"
        )
    axis, angle, rate, turns = (1, 0, 0, 1.0) if lift is Lift.PORT_UP else (0, 1, 1, -1.0)
    verdicts = [
        _verdict("az_mps2", float(force[0, 2]) / GRAVITY_MPS2),
        _verdict(
            ("ax_mps2", "ay_mps2")[axis], float(force[1, axis] - force[0, axis]) / (GRAVITY_MPS2 * np.sin(lifted))
        ),
    ]
    angles = [_mean_angle(record.angles_rad[part, angle]) for part in (start, end)]
    turned = (angles[1] - angles[0] + np.pi) % (2.0 * np.pi) - np.pi if all(map(isfinite, angles)) else np.nan
    verdicts.append(_verdict(("roll_rad", "pitch_rad")[angle], turned / lifted))
    rates = record.rates_radps[:, rate]
    made = float(np.sum(np.diff(record.t_s) * 0.5 * (rates[1:] + rates[:-1]))) if len(rates) > 1 else np.nan
    verdicts.append(_verdict(("gx_radps", "gy_radps")[rate], turns * made / lifted))
    return verdicts


def judge_motion(record: Record) -> list[str]:
    """What is wrong with the axes of a sensor by its own motion, a line each; empty: nothing that this shows."""
    found = []
    if record.has_force and record.has_attitude:
        good = np.isfinite(record.force_mps2).all(axis=1) & np.isfinite(record.up).all(axis=1)
        up, force = record.up[good].mean(axis=0), record.force_mps2[good].mean(axis=0)
        apart = _apart(up, force)
        if apart > APART_RAD:
            names = _turned(("ax_mps2", "ay_mps2", "az_mps2"), lambda signs: _apart(up, force * signs) < APART_RAD)
            hint = f": they would agree with the sign of {names} turned" if names else ": axes exchanged?"
            found.append(f"angles and accelerations are {degrees(apart):.1f} degrees apart{hint}; correct the profile")
    if record.has_rates and record.has_attitude:
        share = coherence(record, np.ones(3))
        if share is not None and share < GOES_WITH:
            names = _turned(
                ("gx_radps", "gy_radps", "gz_radps"), lambda signs: (coherence(record, signs) or 0.0) > GOES_WITH
            )
            if names or share < GOES_NOT:
                hint = f": they would with the sign of {names} turned" if names else ""
                found.append(f"the angles do not move as the body rates say{hint}; correct the profile")
    return found


def _turned(names: tuple[str, ...], fits: Callable[[Array], bool]) -> str:
    """The fewest of three signs to be turned for it to fit; empty: none do."""
    choices = sorted(product((1.0, -1.0), repeat=3), key=lambda signs: -sum(signs))
    found = next((signs for signs in choices if fits(np.array(signs))), None)
    return "" if found is None else " and ".join(name for name, sign in zip(names, found, strict=True) if sign < 0.0)


def _verdict(quantity: str, share: float) -> Verdict:
    """``share``: of what it should be."""
    if not isfinite(share):
        return Verdict(quantity, Sign.MISSING)
    if abs(share) < HALF:
        return Verdict(quantity, Sign.UNCLEAR)
    return Verdict(quantity, Sign.RIGHT if share > 0.0 else Sign.WRONG)


def _mean_angle(angles: Array) -> float:
    return float(np.angle(np.mean(np.exp(1j * angles)))) if np.isfinite(angles).all() and len(angles) else np.nan


def _apart(one: Array, other: Array) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other))
