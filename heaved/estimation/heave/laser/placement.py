"""Where the gauge is: as configured, and as its readings show. What a reading says of the heave at the IMU.

A gauge that is some metres from where it is thought to be reads roll and pitch as heave; on a sea these go with the
heave itself, so that it would be taken for a lag, a scale or a better heave. The readings show it within minutes (see
:func:`~heaved.estimation.heave.laser.geometry.fit_geometry`): it is said, nothing is learned from readings while it is
not known where the gauge is, and then they are those of a gauge at the place that was found.
"""

from __future__ import annotations

from collections import deque
from math import hypot, inf, isfinite, isnan, nan
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common.ring import RingBuffer
from heaved.estimation.heave.laser.geometry import Geometry, GeometryFit, fit_geometry
from heaved.samples import GRAVITY_MPS2

if TYPE_CHECKING:
    from heaved.estimation.heave.laser.tilts import Tilt
    from heaved.samples import DelayedHeave

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """How the place is looked for, and what counts as found."""

    window_s: float = 600.0
    """Of readings that are looked at: gauges are not carried about."""
    every_s: float = 0.2
    """Their spacing; no wave moves within it."""
    longest_step_s: float = 0.5
    """Between delayed heaves further apart none is known."""
    look_s: tuple[float, float] = (10.0, 30.0)
    """They are looked at so often, in the first minutes and later."""
    young_s: float = 300.0
    """Those first minutes."""
    surely: float = 3.0
    """Standard errors by which the place must be another one,"""
    back: float = 1.5
    """and below which it is the configured one again."""
    least_m: float = 0.1
    """Nor is it another one that is no further off than hands measure,"""
    crooked: float = 0.8
    """nor than what an accelerometer makes of gravity that is crooked, rad, by such a share of what the scale and the
    phase of its heave are off by: in a long swell, metres (a tilt a reads as a lever arm of g a / omega^2),"""
    like_heave: tuple[float, float, float] = (0.004, 0.03, 0.05)
    """or moves the reading by no more than such a share of the heave: what the delayed heave is off by goes with roll
    and pitch as the heave does; and that share of how far its scale and its phase are off, which then differ from wave
    to wave; and more, where there is a heave in real time alone."""
    known: tuple[float, float, float] = (0.01, 0.005, 0.005)
    """It is known where the gauge is when what is not known of it moves the reading by less than such a share of the
    heave, or less than its noise: where it is configured; elsewhere, where nobody has measured it; and what comes of
    not knowing how far the attitude leans, which is as steady as the heave.
    """
    known_s: float = 30.0
    """Nor is it known from fewer seconds of readings: how long errors are alike shows in two or three of their periods.
    """
    surer: float = 0.5
    """Readings are let go that were read when roll and pitch were known less than now by that."""
    anywhere_m: float = 20.0
    """Before anything is known of the place it may be so far from the configured one."""
    gone_s: float = 60.0
    """Without roll and pitch for so long nothing will be known of it,"""
    patience_s: float = 300.0
    """nor with them, where so many seconds of readings have not shown it: in regular waves a gauge that is elsewhere
    looks like a late one for ever. Then the configuration is believed.
    """
    lever_m: float = 0.1
    """A gauge whose beam meets its target no further from under the IMU does without roll and pitch."""
    unlike: float = 1.3
    """What shows the heave with a scale that is further off, either way, is no laser on a fixed target,"""
    late_s: float = 0.4
    """nor what is later or earlier than any sensor,"""
    unexplained: float = 0.3
    """nor is it with more of the heave left over than that share."""
    moved: float = 0.5
    """Another place is taken up that moves the reading by so many times its noise."""
    remembered_s: float = 7.0 * 86400.0
    """A place that an earlier run has found is not taken when it is older than this; a younger one the readings judge.
    """
    no_distance: int = 20
    """So many readings that are not above zero are no distances."""


TUNING: Final = Tuning()
LEAST_STD_M: Final = 1e-3
"""No place is known better."""
LEAST_ALONE: Final = 1e-6
"""To divide by."""


class LaserPlace(msgspec.Struct, frozen=True, kw_only=True):
    """Where the beam meets its target, from where it would by the configuration, in metres; nan: not known."""

    is_elsewhere: bool = False
    ahead_m: float = nan
    ahead_std_m: float = nan
    port_m: float = nan
    port_std_m: float = nan


class SavedPlace(msgspec.Struct, frozen=True, kw_only=True):
    """A gauge that was found elsewhere."""

    configured: Geometry
    """Where it was configured: with another configuration nothing is known."""
    geometry: Geometry
    """Where it was taken to be; as configured: it was not known where."""
    place: LaserPlace
    unconfirmed_s: float = 0.0
    """For so long the run that saved it had not found out whether it is still there."""


class Placement:
    """Give it each reading that is believed with the heave of its time as no laser has touched it, and the delayed
    heave as it comes: that is so much better that the place shows ten times as well.

    Attributes:
        configured: where the gauge is by the configuration.
        geometry: where it is taken to be: as configured, or as found.
        fit: what the readings said of it at the last look.
        is_off: whether they show it at another place than the configured one.
        is_known: whether they say well enough where it is.
        unknown_m: RMS of what they are moved by for all that is not known of it; nan before roll and pitch are.
        unsure: twice the share of the heave that is not known of lever arms, in phase with it for as long as it lasts.
        changes: times that :attr:`geometry` has changed.
    """

    def __init__(self, configured: Geometry, noise_std_m: float) -> None:
        """``noise_std_m``: of one reading."""
        self.configured = self.geometry = self._told = configured
        self._remembered: SavedPlace | None = None
        """Where an earlier run has found it, until the readings show it anew, or at another place,"""
        self._remembered_s = 0.0
        """and for how long nobody has looked,"""
        self._first_s = nan
        """when the first reading came."""
        self.fit: GeometryFit | None = None
        self.is_off = self.is_known = False
        self.changes = 0
        self._noise_std_m = noise_std_m
        capacity = round(TUNING.window_s / TUNING.every_s)
        self._at_once, self._later = RingBuffer(capacity, 7), RingBuffer(capacity, 7)
        """Time, reading, heave and its velocity, roll, pitch, target; of the heave in real time, and of the delayed
        one.
        """
        self._waiting: deque[tuple[float, float, float, float, float]] = deque(maxlen=capacity)
        """Time, reading, roll, pitch and target that have no delayed heave yet."""
        self._target = 0.0
        self._delayed: DelayedHeave | None = None
        self._push_s = -inf
        self.unknown_m, self.unsure = nan, 0.0
        self._tilt_std_rad = (0.0, 0.0)
        self._first_std_rad = 0.0
        """As they were known when the rows begin."""
        self._not_positive = 0
        self._look_s = -inf

    # --- a reading as heave ------------------------------------------------------------------------------------------

    def heave_m(self, reading_m: float, tilt: Tilt | None) -> float:
        """What a reading says of the heave at the IMU, constant included; nan: its place cannot be taken out without
        roll and pitch.
        """
        geometry = self.geometry
        if tilt is None:
            return nan if needs_tilt(geometry) else geometry.sign * reading_m
        return float(geometry.heave_m(reading_m, tilt.roll_rad, tilt.pitch_rad))

    # --- where it is -------------------------------------------------------------------------------------------------

    def restore(self, saved: SavedPlace, age_s: float) -> None:
        """Begin where an earlier run has found the gauge ``age_s`` ago (nan: not known); call before the first reading.

        It is said, and readings are taken for those of that place, but nothing is to be learned from them until they
        show it anew. One that was configured otherwise says nothing.
        """
        unconfirmed_s = saved.unconfirmed_s + (age_s if isfinite(age_s) else 0.0)
        if saved.configured != self._told or unconfirmed_s > TUNING.remembered_s:
            return
        self._remembered, self._remembered_s, self.is_off = saved, unconfirmed_s, True
        self._set(saved.geometry)

    def saved(self) -> SavedPlace | None:
        """What a restart shall remember; None: the gauge is where it is configured, or nothing is known of it."""
        if (remembered := self._remembered) is not None:
            since_s = self._push_s - self._first_s if isfinite(self._first_s) else 0.0
            return msgspec.structs.replace(remembered, unconfirmed_s=self._remembered_s + since_s)
        place = self.shown
        is_found = isfinite(place.ahead_m + place.ahead_std_m + place.port_m + place.port_std_m)
        if not self.is_off or not is_found:
            return None
        return SavedPlace(configured=self._told, geometry=self.geometry, place=place)

    def trust(self, tilt_std_rad: tuple[float, float]) -> None:
        """How well roll and pitch are known; what was read while they were known much less is not worth keeping."""
        self._tilt_std_rad = tilt_std_rad
        if not len(self._at_once):
            self._first_std_rad = hypot(*tilt_std_rad)
        elif hypot(*tilt_std_rad) < TUNING.surer * self._first_std_rad:
            self.restart()

    def push(self, t_s: float, reading_m: float, heave_m: float, velocity_mps: float, tilt: Tilt | None) -> None:
        """A reading of the target, and the heave of its time."""
        self._not_positive = self._not_positive + 1 if reading_m <= 0.0 else 0
        if self._not_positive == TUNING.no_distance and self.configured.is_distance:
            self.configured = msgspec.structs.replace(self.configured, is_distance=False)
            self._set(msgspec.structs.replace(self.geometry, is_distance=False))
        if tilt is not None and t_s - self._push_s >= TUNING.every_s - 1e-3:
            self._push_s = t_s
            if isnan(self._first_s):
                self._first_s = t_s
            self._at_once.push((t_s, reading_m, heave_m, velocity_mps, *tilt, self._target))
            self._waiting.append((t_s, reading_m, *tilt, self._target))

    def push_delayed(self, found: DelayedHeave | None) -> None:
        """The newest delayed heave, as no laser has touched it either."""
        before = self._delayed
        if found is before:
            return
        self._delayed = found
        while found is not None and self._waiting and self._waiting[0][0] <= found.t_s:
            t_s, reading_m, *others = self._waiting.popleft()
            if before is None or not before.t_s <= t_s or found.t_s - before.t_s > TUNING.longest_step_s:
                continue
            slope_mps = (found.heave_m - before.heave_m) / (found.t_s - before.t_s)
            heave_m = before.heave_m + (t_s - before.t_s) * slope_mps
            self._later.push((t_s, reading_m, heave_m, slope_mps, *others))

    def retarget(self) -> None:
        """The target is another one, with another constant."""
        self._target += 1.0

    def restart(self) -> None:
        """The heave is another one: rows from before do not go with those that come."""
        self._at_once.clear()
        self._later.clear()
        self._waiting.clear()
        self._look_s = -inf

    def look(self, t_s: float) -> None:
        """Look at the readings if it is time to."""
        if t_s < self._look_s:
            return
        rows = self._aligned((self._at_once if self._delayed is None else self._later).since(t_s - TUNING.window_s))
        often, seldom = TUNING.look_s
        self._look_s = t_s + (often if len(rows) * TUNING.every_s < TUNING.young_s else seldom)
        found = fit_geometry(*rows.T[:6], start=self.configured) if len(rows) else None
        recent = rows if len(rows) else self._at_once.since(t_s - TUNING.window_s)
        if len(recent) < 2:
            return
        heave_m, _, roll, pitch = np.std(recent[:, 2:6], axis=0).tolist()
        if found is not None and not self._is_of_the_heave(found, heave_m):
            self.is_known, self.unknown_m = False, nan
            return
        self._take(found, rows, heave_m, roll, pitch)

    def _take(self, found: GeometryFit | None, rows: Array, heave_m: float, roll: float, pitch: float) -> None:
        """Decide what is known of the place; ``heave_m``, ``roll``, ``pitch``: standard deviations of the motion."""
        if found is not None and self._is_no_longer_there(found, rows):
            self._remembered, self.is_off = None, False
        ahead_m, across_m = (inf, inf) if found is None else (found.foot_forward_std_m, found.foot_port_std_m)
        is_elsewhere = found is not None and self._is_elsewhere(found, rows)
        at = self.configured.foot_m(0.0)
        if found is not None and is_elsewhere:
            at = found.foot_forward_m, found.foot_port_m
        placed_m = hypot(_within(ahead_m) * pitch, _within(across_m) * roll)
        leaned_m = hypot(at[0] * self._tilt_std_rad[1], at[1] * self._tilt_std_rad[0])
        as_configured, elsewhere, leaned = TUNING.known
        is_known = placed_m < max(self._noise_std_m, (elsewhere if is_elsewhere else as_configured) * heave_m)
        is_known = is_known and leaned_m < max(self._noise_std_m, leaned * heave_m)
        is_known = is_known and len(rows) * TUNING.every_s >= TUNING.known_s - 1e-3
        if self.is_known and not is_known:
            return  # There are few readings, or little sea: it was known better.
        self.unknown_m, self.is_known = hypot(placed_m, leaned_m), is_known
        self.unsure = 2.0 * hypot(leaned_m, placed_m if is_elsewhere else 0.0) / max(heave_m, self._noise_std_m)
        self.is_off = is_elsewhere or (self.is_off and not is_known)
        if found is None:
            return
        self.fit = found
        if is_known:
            self._remembered = None
        if self._remembered is not None:
            return
        taken = found.geometry if is_elsewhere and is_known else self.configured
        reading, roll_rad, pitch_rad = rows[:, 1], rows[:, 4], rows[:, 5]
        now_m = self.geometry.heave_m(reading, roll_rad, pitch_rad)
        apart_m = float(np.std(taken.heave_m(reading, roll_rad, pitch_rad) - now_m))
        if apart_m > TUNING.moved * self._noise_std_m or taken == self.configured:
            self._set(taken)

    def _is_elsewhere(self, found: GeometryFit, rows: Array) -> bool:
        """Whether the gauge is not where it is configured."""
        off = self._off(found, rows, found.off_m(self.configured), (found.foot_forward_std_m, found.foot_port_std_m))
        return off > (TUNING.back if self.is_off else TUNING.surely)

    def _is_no_longer_there(self, found: GeometryFit, rows: Array) -> bool:
        """Whether it is not where an earlier run has found it."""
        if self._remembered is None or len(rows) * TUNING.every_s < TUNING.known_s:
            return False
        place, (forward, port) = self._remembered.place, found.off_m(self.configured)
        apart_m = forward - place.ahead_m, port - place.port_m
        std_m = hypot(found.foot_forward_std_m, place.ahead_std_m), hypot(found.foot_port_std_m, place.port_std_m)
        return self._off(found, rows, apart_m, std_m) > TUNING.surely

    def _off(self, found: GeometryFit, rows: Array, apart_m: tuple[float, float], std_m: tuple[float, float]) -> float:
        """Standard errors by which it is another place that is so far off, beyond what an imperfect heave makes."""
        heave_m, velocity_mps = np.maximum(np.std(rows[:, 2:4], axis=0), LEAST_STD_M).tolist()
        of_heave, of_scale, at_once = TUNING.like_heave
        omega_radps = velocity_mps / heave_m
        imperfect = hypot(found.scale - 1.0, found.late_s * omega_radps)
        least_m = TUNING.least_m + TUNING.crooked * imperfect * GRAVITY_MPS2 / omega_radps**2
        share = of_heave + of_scale * imperfect
        share += at_once if self._delayed is None else 0.0
        return max(
            _errors(
                apart_m[0],
                std_m[0],
                max(least_m, share * heave_m / max(found.foot_forward_alone, LEAST_ALONE)),
            ),
            _errors(
                apart_m[1],
                std_m[1],
                max(least_m, share * heave_m / max(found.foot_port_alone, LEAST_ALONE)),
            ),
        )

    def _set(self, geometry: Geometry) -> None:
        if geometry != self.geometry:
            self.geometry = geometry
            self.changes += 1

    def _aligned(self, rows: Array) -> Array:
        """Rows with the readings of other targets as if they were of the newest."""
        targets = np.unique(rows[:, 6])
        if len(targets) < 2:
            return rows
        rows, off_m = rows.copy(), rows[:, 1] - self.configured.sign * rows[:, 2]
        newest_m = float(np.mean(off_m[rows[:, 6] == targets[-1]]))
        for target in targets[:-1].tolist():
            is_of_it = rows[:, 6] == target
            rows[is_of_it, 1] += newest_m - float(np.mean(off_m[is_of_it]))
        return rows

    def _is_of_the_heave(self, found: GeometryFit, heave_m: float) -> bool:
        """Whether readings are those of a gauge on a fixed target; what else they are the lead says."""
        is_alike = found.geometry.sign == self.configured.sign and 1.0 / TUNING.unlike < found.scale < TUNING.unlike
        is_in_time = abs(found.late_s) - found.late_std_s < TUNING.late_s
        return is_alike and is_in_time and found.residual_rms_m < TUNING.unexplained * heave_m

    def is_open(self, t_s: float) -> bool:
        """Whether nothing is to be learned from the readings: it is not known where the gauge is."""
        if self._remembered is not None:
            return True
        is_told = self.is_known and not (self.is_off and self.geometry == self.configured)
        is_waited_for = self.is_off or len(self._at_once) * TUNING.every_s < TUNING.patience_s
        return isfinite(self.unknown_m) and not is_told and is_waited_for and t_s - self._push_s < TUNING.gone_s

    @property
    def is_lost(self) -> bool:
        """Whether the gauge is elsewhere, and it is not known where: its readings are no reference."""
        return self.is_off and self.geometry == self.configured

    @property
    def shown(self) -> LaserPlace:
        """What the readings say, or have said."""
        if self._remembered is not None:
            return self._remembered.place
        if self.fit is None:
            return LaserPlace()
        ahead, port = self.fit.off_m(self.configured)
        return LaserPlace(
            is_elsewhere=self.is_off,
            ahead_m=ahead,
            ahead_std_m=self.fit.foot_forward_std_m,
            port_m=port,
            port_std_m=self.fit.foot_port_std_m,
        )

    @property
    def remark(self) -> str:
        """For people; or nothing."""
        if not self.is_off:
            return ""
        forward, port = self.shown.ahead_m, self.shown.port_m
        if isfinite(forward + port):
            ahead = f"{abs(forward):.1f} m {'ahead' if forward > 0.0 else 'aft'}"
            across = f"{abs(port):.1f} m to {'port' if port > 0.0 else 'starboard'}"
            return f"laser: {hypot(forward, port):.1f} m from where it is configured ({ahead}, {across})"
        return ""


def needs_tilt(geometry: Geometry) -> bool:
    """Whether a reading says nothing of the heave without roll and pitch."""
    forward, port = geometry.leans
    return hypot(geometry.forward_m, geometry.port_m) > TUNING.lever_m or hypot(forward, port) > 0.0


def heaves_m(geometry: Geometry, reading_m: Array, roll_rad: Array, pitch_rad: Array) -> Array:
    """:meth:`Placement.heave_m` of many readings (n,), with nan for angles that are not known."""
    level_m = np.full(len(reading_m), nan) if needs_tilt(geometry) else geometry.sign * reading_m
    return np.where(np.isfinite(roll_rad), geometry.heave_m(reading_m, roll_rad, pitch_rad), level_m)


def _within(std_m: float) -> float:
    """Standard deviation of a place along one axis, when it is not anywhere."""
    return 1.0 / hypot(1.0 / std_m, 1.0 / TUNING.anywhere_m) if std_m > 0.0 else 0.0


def _errors(off_m: float, std_m: float, least_m: float) -> float:
    """Standard errors by which a place is another one."""
    return max(abs(off_m) - least_m, 0.0) / max(std_m, LEAST_STD_M)
