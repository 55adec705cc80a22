"""An IMU that is not what its profile says: triads askew, axes that leak into each other, a scale that bends. Pure.

None of it shows in a sensor at rest on a level deck, where such things are configured: a bias hides them. On a vessel
that moves, each puts something into the vertical acceleration that is no heave, and of which a laser knows.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from heaved.samples import GRAVITY_MPS2

if TYPE_CHECKING:
    from heaved.simulate.sensors import Recording
    from heaved.simulate.vessel import Array


class Wrong(msgspec.Struct, frozen=True, kw_only=True):
    """What nobody has configured of the accelerometers, in the order in which it arises."""

    askew_roll_rad: float = 0.0
    """The accelerometers stand rolled by this against the frame in which the attitude is given,"""
    askew_pitch_rad: float = 0.0
    """and pitched."""
    cross_axis: float = 0.0
    """Each axis shows that share of either other one,"""
    bent_per_g: float = 0.0
    """and is larger by that share for every g that it shows."""


RIGHT = Wrong()
"""As configured."""


def crooked(recording: Recording, wrong: Wrong) -> Recording:
    """The recording of such an IMU, on the same motion and with the same noise."""
    if wrong == RIGHT:
        return recording
    force = np.array((recording.ax_mps2, recording.ay_mps2, recording.az_mps2))
    leak = np.full((3, 3), wrong.cross_axis)
    np.fill_diagonal(leak, 1.0)
    shown = leak @ _askew(wrong) @ force
    shown = shown * (1.0 + wrong.bent_per_g / GRAVITY_MPS2 * np.abs(shown))
    return msgspec.structs.replace(recording, ax_mps2=shown[0], ay_mps2=shown[1], az_mps2=shown[2])


def _askew(wrong: Wrong) -> Array:
    """(3, 3) from the frame of the attitude to that of the triad: pitch, bow up, about y, after roll about x."""
    sr, cr = math.sin(wrong.askew_roll_rad), math.cos(wrong.askew_roll_rad)
    sp, cp = math.sin(wrong.askew_pitch_rad), math.cos(wrong.askew_pitch_rad)
    rolled = np.array(((1.0, 0.0, 0.0), (0.0, cr, sr), (0.0, -sr, cr)))
    pitched = np.array(((cp, 0.0, sp), (0.0, 1.0, 0.0), (-sp, 0.0, cp)))
    return np.asarray(rolled @ pitched)
