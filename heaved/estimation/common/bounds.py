"""What no vessel that lifts loads does: bounds of every value that is published, whatever the state of an estimator.

An estimator whose output leaves them has lost its way: nothing of it is published, and it starts again.
"""

from __future__ import annotations

from math import radians
from typing import Final

HEAVE_M: Final = 20.0
"""Half of the highest wave ever measured by a buoy or a platform (19 m) and as much again."""
HEAVE_VELOCITY_MPS: Final = 15.0
HEAVE_ACCELERATION_MPS2: Final = 8.0
"""For however long; free fall is what a register left at zero reads."""
ANGLE_RAD: Final = radians(60.0)
"""Of roll and pitch, either way: beyond it nobody lifts, and few vessels come back."""
ANGLE_RATE_RADPS: Final = radians(60.0)
"""A small craft that rolls 30 degrees in three seconds."""
POINT_HEAVE_M: Final = 50.0
"""At the end of a long boom, heave of the vessel included."""
