"""What the estimators have to say, to the stream: every frame, and each slower record once."""

from __future__ import annotations

from heaved.daemon.utc_clock import UtcClock
from heaved.outputs import wire
from heaved.outputs.stream import Publisher
from heaved.samples import CraftMotion, DelayedHeave, HullAngles, MotionFrame, SeaState


class Feed:
    """Remembers which record of each class was the last to go out."""

    def __init__(self, publisher: Publisher, utc: UtcClock) -> None:
        """``utc``: dates the records."""
        self._publisher = publisher
        self._utc = utc
        self._sea: SeaState | None = None
        self._delayed: DelayedHeave | None = None
        self._hull: HullAngles | None = None
        self._attitude: CraftMotion | None = None

    def motion(self, frame: MotionFrame) -> None:
        """MOTION, and DELAYED when there is a new one."""
        self._publisher.publish(frame, utc_s=self._utc.utc_s(frame.t_s))
        delayed = frame.delayed
        if delayed is not None and delayed is not self._delayed:
            self._delayed = delayed
            if self._publisher.is_watched("DELAYED"):
                self._publisher.publish_record(wire.delayed_record(delayed, self._utc.utc_s(delayed.t_s)))

    def stages(self, hull: HullAngles | None, attitude: CraftMotion | None) -> None:
        """HULL and ATTITUDE, as they come."""
        if hull is not None and hull is not self._hull:
            self._hull = hull
            if self._publisher.is_watched("HULL"):
                self._publisher.publish_record(wire.hull_record(hull, self._utc.utc_s(hull.t_s)))
        if attitude is not None and attitude is not self._attitude:
            self._attitude = attitude
            if self._publisher.is_watched("ATTITUDE"):
                self._publisher.publish_record(wire.attitude_record(attitude, self._utc.utc_s(attitude.t_s)))

    def outlook(self, frame: MotionFrame) -> None:
        """SEA when it has been fitted again, and QUIET; to be called once a second."""
        if frame.sea is not None and frame.sea is not self._sea:
            self._sea = frame.sea
            self._publisher.publish_record(wire.sea_record(frame.sea, self._utc.utc_s(frame.sea.t_s)))
        if frame.quiet is not None:
            self._publisher.publish_record(wire.quiet_record(frame.quiet, self._utc.utc_s(frame.quiet.t_s)))
