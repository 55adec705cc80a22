"""Angles that cannot be true: beyond what ships do, or not where the motion has been leading.

A ship's roll and pitch are as smooth as anything gets: what comes next is known to a few hundredths of a degree. Bytes
from another register, a wrapped angle or bits turned over are tens of degrees off. A reading alone proves nothing, not
even the first: after whatever has been refused, and after a gap, several that agree with each other must come in a row.
"""

from __future__ import annotations

from math import exp, inf, nan, pi, radians
from typing import Final

from heaved.estimation.common.bounds import ANGLE_RAD

TURN: Final = 2.0 * pi
WIDTH: Final = 8.0
"""Readings further off than so many times the usual are refused."""
FLOOR_RAD: Final = radians(0.5)
"""Readings less far off never are: coarse registers, knocks at the quay."""
UNKNOWN_RAD: Final = radians(2.0)
"""The same while nothing is known of the motion, and between readings that are to agree with each other,"""
UNKNOWN_RATE_RADPS: Final = radians(20.0)
"""and so much more for each second between them: a tug that rolls 15 degrees in four seconds."""
AGREEING: Final = 4
"""So many readings in a row, and"""
AGREEING_S: Final = 0.1
"""so long a row of them prove what they show;"""
ELSEWHERE_S: Final = 0.5
"""so long a one where the motion was known to be elsewhere."""
SLOPE_S: Final = 0.1
"""Time constant of the rate: long against the noise of readings, short against the motion."""
STALE_S: Final = 2.0
"""After a gap this long the motion is unknown."""
FIRST: Final = 20
"""Readings by which the usual one is first known; until then it is their mean."""
ADJUSTED: Final = 0.01
"""By so much of itself the usual one goes up with a reading that is further off and down with one that is not: it is
the median of a hundred or so, and a quarter of wrong readings, none so far off that it is refused, moves it little."""
RMS_OF_MEDIAN: Final = 1.483
"""Of normal deviations."""
LEAST_RAD: Final = 1e-6


def wrapped(angle_rad: float) -> float:
    """The same angle, -pi < angle <= pi."""
    return angle_rad if -pi < angle_rad <= pi else pi - (pi - angle_rad) % TURN


class AngleGate:
    """Judges one angle, whose differences are taken the short way round.

    Attributes:
        rejected: readings refused so far.
    """

    def __init__(self, most_rad: float = ANGLE_RAD) -> None:
        """``most_rad``: beyond it, either way, nothing is believed."""
        self.rejected = 0
        self._most = most_rad
        self._t_s = -inf
        self._angle, self._rate = nan, 0.0
        self._usual_s = self._usual_off = 0.0
        self._count = 0
        self._row: list[tuple[float, float]] = []
        """Of readings that agree with each other while they are not believed yet."""

    @property
    def rate_radps(self) -> float:
        """As the last readings that were believed have shown it."""
        return self._rate

    @property
    def std_rad(self) -> float:
        """RMS of how far a usual reading is off where the ones before have led; nan: not known yet."""
        return RMS_OF_MEDIAN * self._usual_off if self._count >= FIRST else nan

    def __call__(self, t_s: float, angle_rad: float, *, is_confirmed: bool = False) -> bool:
        """Whether the reading at ``t_s``, later than the last one, may be believed; one that is nan never.

        ``is_confirmed``: something else shows the same, roughly, which will do where the motion is not known.
        """
        if not abs(angle_rad) <= self._most:
            self._row.clear()
            self.rejected += angle_rad == angle_rad
            return False
        elapsed_s = t_s - self._t_s
        if elapsed_s > STALE_S:
            if is_confirmed:
                self._begin(t_s, angle_rad, 0.0)
                return True
            return self._is_proven(t_s, angle_rad, AGREEING_S)
        off = wrapped(angle_rad - self._angle - self._rate * elapsed_s)
        # The motion is not straight: over several intervals it leads astray by as many times more.
        longer = elapsed_s / self._usual_s if elapsed_s > self._usual_s > 0.0 else 1.0
        if self._count >= FIRST:
            limit = FLOOR_RAD + WIDTH * RMS_OF_MEDIAN * self._usual_off * longer
        else:
            limit = UNKNOWN_RAD + UNKNOWN_RATE_RADPS * elapsed_s
        if abs(off) > limit:
            self.rejected += 1
            return self._is_proven(t_s, angle_rad, ELSEWHERE_S)
        self._count += 1
        far = abs(off) / longer
        if self._count <= FIRST:
            self._usual_off += (far - self._usual_off) / self._count
            self._usual_s += (elapsed_s - self._usual_s) / self._count
        else:
            self._usual_off *= 1.0 + ADJUSTED if far > self._usual_off else 1.0 - ADJUSTED
            if self._usual_off < LEAST_RAD:
                self._usual_off = LEAST_RAD
            self._usual_s += ADJUSTED * (elapsed_s - self._usual_s)
        self._rate += off * (1.0 - exp(-elapsed_s / SLOPE_S)) / elapsed_s
        self._t_s, self._angle = t_s, angle_rad
        if self._row:
            self._row.clear()
        return True

    def _is_proven(self, t_s: float, angle_rad: float, lasting_s: float) -> bool:
        """Whether this reading is the last of a row that proves itself."""
        row = self._row
        if row:
            since_s, step = t_s - row[-1][0], wrapped(angle_rad - row[-1][1])
            if since_s > STALE_S or abs(step) > UNKNOWN_RAD + UNKNOWN_RATE_RADPS * since_s:
                row.clear()
        row.append((t_s, angle_rad))
        elapsed_s = t_s - row[0][0]
        if len(row) < AGREEING or elapsed_s < lasting_s:
            return False
        self._begin(t_s, angle_rad, wrapped(angle_rad - row[0][1]) / elapsed_s)
        return True

    def _begin(self, t_s: float, angle_rad: float, rate_radps: float) -> None:
        self._t_s, self._angle, self._rate = t_s, angle_rad, rate_radps
        self._count = 0
        self._row.clear()
