"""The geometry of a crane: from the angles of its joints to where its tip is. Pure trigonometry.

Axes are those of the IMU (or of the second IMU at the crane base): x forward, y to port, z up; the slew ring lies level
in them. On the turntable "outward" is where the boom points and "left" is what lies to the left of that, seen from
above. With slew s clockwise from forward, outward is (cos s, -sin s) and left is (sin s, cos s).

        tip o--. sheave, along the last of boom and jib, and above it
           / jib, its elevation against the deck or against the boom
          o
         / boom, its elevation against the deck
    heel o
    -----+----- slew ring, pedestal_m from the IMU
"""

from __future__ import annotations

from math import cos, sin
from typing import TYPE_CHECKING, Annotated, Final, Literal

import msgspec

if TYPE_CHECKING:
    from collections.abc import Sequence

Vector = tuple[float, float, float]
Length = Annotated[float, msgspec.Meta(ge=-1000, le=1000)]
Angle = Annotated[float, msgspec.Meta(ge=-360, le=360)]

JOINTS: Final = ("slew", "boom", "jib", "line")
"""In the order of everything that there is one of per joint."""


class Params(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[crane]``: how the crane is built, how well its encoders say how it stands, how fast it moves."""

    frame: Literal["hull", "crane"] = "hull"
    """From where and along which axes ``pedestal_m`` is: as ``frame`` of a point."""
    pedestal_m: Annotated[tuple[Length, Length, Length], msgspec.Meta()] = (0.0, 0.0, 0.0)
    """Centre of the slew ring: forward, port, up."""
    heel_outward_m: Length = 0.0
    """Boom foot pin, from there."""
    heel_up_m: Length = 0.0
    boom_length_m: Annotated[float, msgspec.Meta(ge=0, le=1000)] = 0.0
    """From the foot pin to its tip, or to the hinge of the jib; 0: there is no crane."""
    jib_length_m: Annotated[float, msgspec.Meta(ge=0, le=1000)] = 0.0
    """0: no jib."""
    jib_angle: Literal["deck", "boom"] = "deck"
    """Against what the jib's encoder measures."""
    sheave_outward_m: Length = 0.0
    """Where the rope leaves the tip: along the last of boom and jib beyond its end,"""
    sheave_up_m: Length = 0.0
    """and above it, at right angles."""
    slew_zero_deg: Angle = 0.0
    """What the encoder says with the boom pointing forward,"""
    boom_zero_deg: Angle = 0.0
    """with the boom level,"""
    jib_zero_deg: Angle = 0.0
    """and with the jib level, or in line with the boom."""
    slew_fixed_deg: Angle | None = None
    """For a joint that does not move, or has no encoder: its angle, which then is not read."""
    boom_fixed_deg: Angle | None = None
    jib_fixed_deg: Angle | None = None
    falls: Annotated[int, msgspec.Meta(ge=1, le=100)] = 1
    """Parts of line that the hook hangs on."""
    hook_below_m: Length = 0.0
    """The hook below the sheave with no line out."""
    angle_std_deg: Annotated[float, msgspec.Meta(gt=0, le=45)] = 0.1
    """Standard deviation of one reading,"""
    line_std_m: Annotated[float, msgspec.Meta(gt=0, le=100)] = 0.1
    """of the line likewise."""
    max_slew_degps: Annotated[float, msgspec.Meta(gt=0, le=180)] = 6.0
    """1 turn a minute: what a crane can do, by which it is judged how soon an old reading says nothing more."""
    max_luff_degps: Annotated[float, msgspec.Meta(gt=0, le=180)] = 2.0
    """Of boom and jib."""
    max_hoist_mps: Annotated[float, msgspec.Meta(gt=0, le=100)] = 2.0
    """Of the hook."""
    max_age_s: Annotated[float, msgspec.Meta(gt=0, le=3600)] = 5.0
    """From older readings nothing is published of the points."""

    @property
    def is_there(self) -> bool:
        """Whether there is a crane."""
        return self.boom_length_m > 0.0

    @property
    def fixed_deg(self) -> tuple[float | None, float | None, float | None]:
        """Of slew, boom and jib."""
        return self.slew_fixed_deg, self.boom_fixed_deg, self.jib_fixed_deg


class Tip(msgspec.Struct, frozen=True, gc=False):
    """Where the tip is and how it moves with its joints, metres in the axes of ``[crane] frame``."""

    at_m: Vector
    by_slew: Vector
    """Derivatives, m/rad."""
    by_boom: Vector
    by_jib: Vector


def tip(params: Params, slew_rad: float, boom_rad: float, jib_rad: float, offset_m: Vector = (0.0, 0.0, 0.0)) -> Tip:
    """``slew_rad, boom_rad, jib_rad``: true angles, the jib's as ``jib_angle`` has it. ``offset_m``: of a point beside
    the tip, outward, left and up: it turns with the turntable alone.
    """
    p = params
    out, left, up = offset_m
    last = boom_rad
    outward = p.heel_outward_m + out
    height = p.heel_up_m + up
    sb, cb = p.boom_length_m * sin(boom_rad), p.boom_length_m * cos(boom_rad)
    sj = cj = 0.0
    has_jib = p.jib_length_m > 0.0
    if has_jib:
        last = jib_rad + boom_rad if p.jib_angle == "boom" else jib_rad
        sj, cj = p.jib_length_m * sin(last), p.jib_length_m * cos(last)
    if p.sheave_outward_m or p.sheave_up_m:
        s, c = sin(last), cos(last)
        along, above = p.sheave_outward_m * c - p.sheave_up_m * s, p.sheave_outward_m * s + p.sheave_up_m * c
        if has_jib:
            cj, sj = cj + along, sj + above
        else:
            cb, sb = cb + along, sb + above
    outward += cb + cj
    height += sb + sj
    s, c = sin(slew_rad), cos(slew_rad)
    x, y, z = p.pedestal_m
    # What turns about a pin moves by minus its height over the pin outward, and by its distance from it upward.
    over_boom, from_boom = (sb + sj, cb + cj) if p.jib_angle == "boom" else (sb, cb)
    return Tip(
        at_m=(x + outward * c + left * s, y - outward * s + left * c, z + height),
        by_slew=(-outward * s + left * c, -outward * c - left * s, 0.0),
        by_boom=(-over_boom * c, over_boom * s, from_boom),
        by_jib=(-sj * c, sj * s, cj),
    )


def needed(params: Params, *, hook: bool) -> Sequence[int]:
    """Indices in :data:`JOINTS` of those that have to be read to know where the tip, or the hook, is."""
    is_read = [fixed is None for fixed in params.fixed_deg]
    is_read[2] &= params.jib_length_m > 0.0
    return [i for i, read in enumerate((*is_read, hook)) if read]
