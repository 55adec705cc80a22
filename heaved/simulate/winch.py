"""An actively heave-compensated winch, as the controller on its other end sees it. Pure: time is an argument.

A set-point takes effect after a dead time (field bus, drive cycle, valves); then the rope's speed follows it as a
first-order lag, within limits of speed and acceleration. The drive knows its own rope exactly and adds to the speed
that is asked for what brings it to the position that is asked for:

    x' = v        lag v' + v = u        u = v_set + gain (x_set - x),  |u| <= max speed,  |v'| <= max acceleration

x is how far the hook has been raised against the vessel, so the hook itself moves as heave + x.
"""

from __future__ import annotations

from cmath import exp as complex_exp
from cmath import sqrt as complex_sqrt
from collections import deque
from math import exp, inf, isnan, nan
from typing import Final

import msgspec

_LONGEST_STEP_S: Final = 0.05
"""Limits are looked for at both ends of a step: a step as short against the lag as this has no more between them."""
_LIMITED_STEP_S: Final = 1e-3
"""While a limit acts there is no closed form."""


class WinchParams(msgspec.Struct, frozen=True, kw_only=True):
    """What the winch can do. The limits suit sea state 6, whose heave moves at 1.3 m/s (standard deviation)."""

    dead_time_s: float = 0.15
    """From the giving of a set-point to the first effect."""
    lag_s: float = 0.10
    """Time constant of the speed."""
    max_speed_mps: float = 5.0
    max_acceleration_mps2: float = 5.0
    position_gain_1ps: float = 1.0
    """Speed per distance from the position that is asked for; overdamped below 1 / (4 lag)."""
    watchdog_s: float = 0.5
    """A set-point stays in force no longer than this: whoever has stopped giving them gets a rope at rest."""


class SetPoint(msgspec.Struct, frozen=True):
    """What the winch is asked for: a speed, and a position towards which to work off what is missing."""

    velocity_mps: float = 0.0
    position_m: float = nan
    """nan: none; the speed alone counts."""


class WinchState(msgspec.Struct, frozen=True):
    """The rope at one moment."""

    t_s: float
    position_m: float
    """Hook raised against the vessel."""
    velocity_mps: float
    acceleration_mps2: float


class Winch:
    """Give it set-points and let it run, in order of time. Exact at any step while no limit acts."""

    def __init__(self, params: WinchParams, *, t_s: float, position_m: float = 0.0) -> None:
        """At rest at ``position_m``, and told to stay there.

        Raises:
            ValueError: a parameter that is no such quantity.
        """
        p = params
        above_0 = (p.lag_s, p.max_speed_mps, p.max_acceleration_mps2, p.watchdog_s)
        if not (all(value > 0.0 for value in above_0) and p.dead_time_s >= 0.0 and p.position_gain_1ps >= 0.0):
            raise ValueError(f"lag, limits and watchdog must be above 0, dead time and gain not below: {params}")
        self._params = params
        self._t_s, self._x, self._v = t_s, position_m, 0.0
        self._active = SetPoint(0.0, position_m)
        self._expires_s = inf
        self._coming: deque[tuple[float, SetPoint]] = deque()

    def command(self, t_s: float, set_point: SetPoint) -> None:
        """Give a set-point at ``t_s``, not before the last one; it is in force until the effect of the next."""
        self._coming.append((t_s + self._params.dead_time_s, set_point))

    def advance(self, t_s: float) -> WinchState:
        """Run until ``t_s`` (nothing happens if that is in the past)."""
        while self._coming and self._coming[0][0] <= t_s:
            effect_s, set_point = self._coming.popleft()
            self._run_guarded(effect_s)
            self._active, self._expires_s = set_point, effect_s + self._params.watchdog_s
        self._run_guarded(t_s)
        return WinchState(self._t_s, self._x, self._v, self._limited_acceleration())

    def _run_guarded(self, end_s: float) -> None:
        if end_s > self._expires_s:
            self._run(self._expires_s)
            self._active, self._expires_s = SetPoint(), inf
        self._run(end_s)

    def _run(self, end_s: float) -> None:
        while (left_s := end_s - self._t_s) > 0.0:
            step_s = min(left_s, _LONGEST_STEP_S)
            if not self._try_exact(step_s):
                step_s = min(left_s, _LIMITED_STEP_S)
                self._step_limited(step_s)
            self._t_s = end_s if step_s == left_s else self._t_s + step_s

    def _asked_mps(self, x: float) -> float:
        """u before its limit."""
        target = self._active.position_m
        return self._active.velocity_mps + (0.0 if isnan(target) else self._params.position_gain_1ps * (target - x))

    def _is_free(self, x: float, v: float) -> bool:
        u = self._asked_mps(x)
        within_speed = abs(u) <= self._params.max_speed_mps
        return within_speed and abs(u - v) <= self._params.max_acceleration_mps2 * self._params.lag_s

    def _try_exact(self, dt_s: float) -> bool:
        """The linear solution, if no limit acts at either end of it."""
        if not self._is_free(self._x, self._v):
            return False
        x, v = self._solution(dt_s)
        if not self._is_free(x, v):
            return False
        self._x, self._v = x, v
        return True

    def _solution(self, dt_s: float) -> tuple[float, float]:
        """Position and speed after ``dt_s`` under a constant set-point."""
        p, s = self._params, self._active
        if isnan(s.position_m) or p.position_gain_1ps == 0.0:
            decay = exp(-dt_s / p.lag_s)
            missing = s.velocity_mps - self._v
            return self._x + s.velocity_mps * dt_s - p.lag_s * missing * (1.0 - decay), s.velocity_mps - missing * decay
        # e = x - rest obeys lag e'' + e' + gain e = 0: e = c1 exp(r1 t) + c2 (exp(r1 t) - exp(r2 t)) / (r1 - r2).
        rest = s.position_m + s.velocity_mps / p.position_gain_1ps
        root = complex_sqrt(1.0 - 4.0 * p.position_gain_1ps * p.lag_s)
        fast, slow = (-1.0 - root) / (2.0 * p.lag_s), (-1.0 + root) / (2.0 * p.lag_s)
        at_fast = complex_exp(fast * dt_s)
        apart = slow - fast
        mixed = dt_s * at_fast if abs(apart * dt_s) < 1e-6 else (complex_exp(slow * dt_s) - at_fast) / apart
        c1 = self._x - rest
        c2 = self._v - slow * c1
        at_slow = at_fast + apart * mixed
        x = rest + (c1 * at_slow + c2 * mixed).real
        return x, (c1 * slow * at_slow + c2 * (fast * mixed + at_slow)).real

    def _limited_acceleration(self) -> float:
        p = self._params
        u = max(-p.max_speed_mps, min(p.max_speed_mps, self._asked_mps(self._x)))
        return max(-p.max_acceleration_mps2, min(p.max_acceleration_mps2, (u - self._v) / p.lag_s))

    def _step_limited(self, dt_s: float) -> None:
        a = self._limited_acceleration()
        self._x += self._v * dt_s + a * dt_s**2 / 2.0
        self._v += a * dt_s
