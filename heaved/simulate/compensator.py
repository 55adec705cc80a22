"""What a consumer of the stream does with it: set-points that hold a hook still. Pure: lines and times are arguments.

A winch answers late: after its dead time, and then with its lag. So it must be given now what the heave will be then,
and the inverse of the lag, v + lag a, instead of the speed v. The stream has the future in two ways, and either serves:

* ``FORECAST``: the forecasts of each line are points of one smooth curve, heave as expected from that line on. Its
  value, slope and bend are taken at the age of the line plus the winch's dead time. Nothing has to be configured, and
  a line that comes late is made up for.
* ``SHIFTED``: heave and velocity of a stream which the daemon has moved by ``[compensation] lead_s``, to be set to the
  age of a line + dead time + lag. The velocity is used as it comes: moved by the lag, it inverts it.
* ``PRESENT``: present heave and velocity as they come, no lead. How much that leaves is why there is the rest.

Whatever the source, the speed is faded out when no usable line comes (the rope then rests where it is) and in again
later; the position that is asked for follows from the speed that is asked for, so that it never jumps, and what it is
off by is worked off slowly.
"""

from __future__ import annotations

from enum import Enum
from math import exp, inf
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.samples import HeaveState
from heaved.simulate.winch import SetPoint, WinchParams

if TYPE_CHECKING:
    from collections.abc import Sequence

_NODES: Final = 6
"""Forecasts through which the curve is laid: the nearest ones."""
_FEWEST_NODES: Final = 3
"""It takes so many to have a bend."""
_CLOCK_DRIFT: Final = 1e-4
"""How far two clocks may run apart, s/s: beyond any crystal."""


class Source(Enum):
    """Where the heave at the moment of effect comes from."""

    FORECAST = "forecast"
    SHIFTED = "shifted"
    PRESENT = "present"


class Ahead(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """A heave that is forecast."""

    horizon_s: float
    heave_m: float | None = None


class Trust(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """How far the heave can be trusted."""

    heave: HeaveState


class Update(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """What is needed of a MOTION line; decoded from one, or converted from its record."""

    mono_s: float
    """The daemon's monotonic clock at validity."""
    quality: Trust
    age_s: float = 0.0
    """From validity to sending."""
    heave_m: float | None = None
    heave_velocity_mps: float | None = None
    compensation_lead_s: float | None = None
    """heave_m and heave_velocity_mps are for this long after validity; None: for the moment itself."""
    forecast: tuple[Ahead, ...] = ()


class CompensatorParams(msgspec.Struct, frozen=True, kw_only=True):
    """How it is driven, and how it gives up and begins again."""

    period_s: float = 0.01
    """Of the set-points. Each is in force until the next and is therefore made for half of this later."""
    stale_s: float = 0.5
    """The last usable line serves this long; then the rope is brought to rest. Invalid heave does so at once."""
    fade_out_s: float = 1.5
    fade_in_s: float = 3.0
    trim_time_s: float = 0.3
    """Time constant with which a wrong position is worked off. Long against this, the hook is as wrong as the forecast
    of the position; short against it, as that of the velocity, which is the worse one."""
    trim_speed_mps: float = 0.5
    """But never faster: an estimator that starts over moves the hook gently."""


class Aim(msgspec.Struct, frozen=True):
    """The heave to be cancelled at the moment at which a set-point given now has its effect."""

    heave_m: float
    velocity_mps: float
    """For the drive, its lag inverted."""


class Compensator:
    """Tell it each line, ask it for a set-point each period."""

    def __init__(
        self,
        winch: WinchParams,
        params: CompensatorParams = CompensatorParams(),  # noqa: B008  (frozen)
        source: Source = Source.FORECAST,
    ) -> None:
        """For a winch that rests at position 0."""
        self._winch, self._params, self._source = winch, params, source
        self._ahead_s = winch.dead_time_s + params.period_s / 2.0
        self._last: Update | None = None
        self._last_s = -inf
        """Validity of the last usable line on the consumer's clock."""
        self._is_usable = False
        self._clock_s = inf
        """The consumer's monotonic clock less the daemon's."""
        self._heard_s = -inf
        self._now_s: float | None = None
        self._fade = 0.0
        self._x = self._v = self._speed = 0.0
        self.aim: Aim | None = None
        """Behind the last set-point; None: there never was a usable line."""

    def connected(self) -> None:
        """A new connection: perhaps to a daemon on another clock."""
        self._clock_s, self._heard_s = inf, -inf

    def take(self, update: Update, received_s: float) -> None:
        """A line, received at ``received_s`` on the consumer's clock."""
        self._follow_clock(update, received_s)
        self._is_usable = self._can_use(update)
        valid_s = update.mono_s + self._clock_s
        if self._is_usable and valid_s > self._last_s:
            self._last, self._last_s = update, valid_s

    def _follow_clock(self, update: Update, received_s: float) -> None:
        """The least delay seen is that of the way; what is more is a line that has waited, here or on the way."""
        if update.mono_s > self._heard_s:
            if self._heard_s > -inf:
                self._clock_s += _CLOCK_DRIFT * (update.mono_s - self._heard_s)
            self._heard_s = update.mono_s
        self._clock_s = min(self._clock_s, received_s - update.age_s - update.mono_s)

    def _can_use(self, update: Update) -> bool:
        if update.quality.heave not in (HeaveState.VALID, HeaveState.DEGRADED):
            return False
        if self._source is Source.FORECAST:
            known = sum(ahead.heave_m is not None for ahead in update.forecast)
            return update.heave_m is not None and known >= _FEWEST_NODES
        return update.heave_m is not None and update.heave_velocity_mps is not None

    @property
    def authority(self) -> float:
        """1: compensates in full; 0: the rope rests. Smooth in time."""
        return self._fade**2 * (3.0 - 2.0 * self._fade)

    def set_point(self, now_s: float) -> SetPoint:
        """What the winch is to be given at ``now_s``, which increases from call to call."""
        p = self._params
        elapsed_s = 0.0 if self._now_s is None else now_s - self._now_s
        self._now_s = now_s
        self._run_rope(elapsed_s)
        is_fresh = self._is_usable and now_s - self._last_s <= p.stale_s
        if elapsed_s > self._winch.watchdog_s:
            self._fade = 0.0  # The winch has brought the rope to rest by itself.
        else:
            fade = self._fade + (elapsed_s / p.fade_in_s if is_fresh else -elapsed_s / p.fade_out_s)
            self._fade = max(0.0, min(1.0, fade))
        self._speed = 0.0
        if self._last is not None and self._fade > 0.0:
            self.aim = self._aimed(self._last, now_s - self._last_s)
            trim_mps = (-self.aim.heave_m - self._rope(self._v, p.period_s / 2.0)[0]) / p.trim_time_s
            trim_mps = max(-p.trim_speed_mps, min(p.trim_speed_mps, trim_mps))
            self._speed = self.authority * (trim_mps - self.aim.velocity_mps)
        return SetPoint(self._speed, (self._x + self._rope(self._speed, p.period_s)[0]) / 2.0)

    def _run_rope(self, elapsed_s: float) -> None:
        """Where the set-points so far will have brought the rope once they have had their effect."""
        in_force_s = min(elapsed_s, self._winch.watchdog_s)
        self._x, self._v = self._rope(self._speed, in_force_s)
        self._x, self._v = self._rope(0.0, elapsed_s - in_force_s)

    def _rope(self, speed_mps: float, dt_s: float) -> tuple[float, float]:
        """Position and speed after a set-point of that speed for ``dt_s``, through the lag."""
        lag_s, missing = self._winch.lag_s, speed_mps - self._v
        settled = 1.0 - exp(-dt_s / lag_s)
        return self._x + speed_mps * dt_s - lag_s * settled * missing, self._v + settled * missing

    def _aimed(self, update: Update, age_s: float) -> Aim:
        ahead_s, published_ahead_s = age_s + self._ahead_s, update.compensation_lead_s or 0.0
        heave, velocity = update.heave_m or 0.0, update.heave_velocity_mps or 0.0
        if self._source is Source.FORECAST:
            points = [(a.horizon_s, a.heave_m) for a in update.forecast if a.heave_m is not None]
            ahead_s = min(ahead_s, max(horizon_s for horizon_s, _ in points))
            expected, slope, bend = curve(points, ahead_s)
            # What the published heave has beyond the forecasts, such as a learned correction, is held.
            held = heave - curve(points, published_ahead_s)[0]
            return Aim(expected + held, slope + self._winch.lag_s * bend)
        if self._source is Source.SHIFTED:
            heave += velocity * (ahead_s - published_ahead_s)
        return Aim(heave, velocity)


def curve(points: Sequence[tuple[float, float]], at: float) -> tuple[float, float, float]:
    """Value, slope and bend at ``at`` of the polynomial through the nearest points (abscissa, value).

    Newton's divided differences; the abscissae must differ.
    """
    nearest = sorted(points, key=lambda point: abs(point[0] - at))[:_NODES]
    x = [point[0] for point in nearest]
    c = [point[1] for point in nearest]
    for order in range(1, len(c)):
        for i in range(len(c) - 1, order - 1, -1):
            c[i] = (c[i] - c[i - 1]) / (x[i] - x[i - order])
    value, slope, half_bend = c[-1], 0.0, 0.0
    for node, coefficient in zip(x[-2::-1], c[-2::-1], strict=True):
        half_bend = half_bend * (at - node) + slope
        slope = slope * (at - node) + value
        value = value * (at - node) + coefficient
    return value, slope, 2.0 * half_bend
