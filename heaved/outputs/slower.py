"""What is taken of the frames by somebody who does not want each: those nearest to the times of a rate, and of what is
slower than the frames what has not been told yet. Pure.
"""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Any, Final

from heaved.outputs import wire

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    import msgspec

    from heaved.samples import MotionFrame

SLOW: Final[Mapping[str, Callable[[Any, float], msgspec.Struct]]] = {
    "sea": wire.sea_record,
    "delayed": wire.delayed_record,
    "hull": wire.hull_record,
    "attitude": wire.attitude_record,
    "quiet": wire.quiet_record,
}
"""By the attribute of a frame that many frames share, how its record is made; it has a time of its own, ``t_s``."""


class Slower:
    """Frames, and what comes with them, at a rate of its own."""

    def __init__(self, rate_hz: float) -> None:
        self._period_s = 1.0 / rate_hz
        self._due_s = self._last_s = -inf
        self._told: dict[str, object] = {}

    def wants(self, frame: MotionFrame) -> bool:
        """Whether a frame is due. Due times stand a period apart, whatever the frames' own times, so that the mean rate
        is the wanted one; the frame nearest to a due time is taken.
        """
        interval_s, self._last_s = frame.t_s - self._last_s, frame.t_s
        if frame.t_s < self._due_s - 0.5 * interval_s:
            return False
        next_s = self._due_s + self._period_s
        self._due_s = next_s if next_s > frame.t_s else frame.t_s + self._period_s
        return True

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
