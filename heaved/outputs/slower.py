"""What is taken of the frames by somebody who does not want each: those nearest to the times of a rate, and of what is
slower than the frames what has not been told yet. Pure.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from heaved.outputs import wire
from heaved.outputs.due_times import DueTimes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    import msgspec

    from heaved.samples import MotionFrame

SLOW: Final[Mapping[str, Callable[[Any, float], msgspec.Struct]]] = {
    "sea": wire.sea_record,
    "delayed": wire.delayed_record,
    "hull": wire.hull_record,
    "attitude": wire.attitude_record,
    "reference_mru": wire.reference_record,
    "quiet": wire.quiet_record,
}
"""By the attribute of a frame that many frames share, how its record is made; it has a time of its own, ``t_s``."""


class Slower:
    """Frames, and what comes with them, at a rate of its own."""

    def __init__(self, rate_hz: float) -> None:
        self._due = DueTimes(rate_hz)
        self._told: dict[str, object] = {}

    def wants(self, frame: MotionFrame) -> bool:
        """Whether a frame is due."""
        return self._due.is_due(frame.t_s)

    def news(self, frame: MotionFrame) -> Iterator[tuple[str, Any]]:
        """What comes with the frame and has not been told yet, by its name in :data:`SLOW`."""
        for name in SLOW:
            found = getattr(frame, name)
            if found is not None and found is not self._told.get(name):
                self._told[name] = found
                yield name, found

    def tell_again(self) -> None:
        """Whoever listens now has been told nothing."""
        self._told.clear()
