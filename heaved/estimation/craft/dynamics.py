"""Heave and pitch of a foil-assisted catamaran: the nonlinear model that attitude fusion predicts with.

Source: CN 104787260 A (two fused filters, hydrofoil catamaran), whose equations of motion are lost in print; these are
ours, of the same kind. With z heave (m, up) and theta pitch (rad, bow up), z = theta = 0 the design attitude:

    m z'' = L_f + L_a - W_f - K z (1 + c z^2)         - D1 z' - D2 |z'| z' + F_w
    I q'  = x_f L_f + x_a L_a + M_t - K' theta (1 + c' theta^2) - D1' q - D2' |q| q  + M_w
    L     = 1/2 rho U^2 S g(h) C_L(alpha)
    alpha = alpha_0 + theta + delta / 2 - (z' + x q - w) / U
    C_L   = a alpha_s tanh(alpha / alpha_s)
    g(h)  = (1 - s exp(-h / l)) (1 + tanh((h - h_v) / b)) / 2,   h = h_0 + zeta - z - x theta

W_f is the weight that the foils carry by design, the hulls carry the rest. h is the depth of a foil below the surface:
it loses lift near it (the image of the bound vortex) and all of it where air comes in. Past the stall the lift stays,
it does not drop. w and zeta are the water's own vertical speed and elevation at a foil; a filter does not know them and
puts them, with F_w and M_w, into its wave force. Downwash and surge are left out.

A vessel without foils is the case of foils without area.
"""

from __future__ import annotations

from typing import Annotated, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.craft.tuning import TUNING

Array = NDArray[np.float64]
Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]


class Foil(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One foil with its flap."""

    area_m2: NotNegative = 6.0
    arm_m: float
    """Forward of the centre of gravity; negative aft of it."""
    depth_m: float = 1.3
    """Below the still surface at the design attitude."""
    incidence_rad: Annotated[float, msgspec.Meta(ge=-0.5, le=0.5)] = 0.066
    """Angle to the flow at the design attitude with the flap neutral, from zero lift."""


class Vessel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[attitude.vessel]``: by default a catamaran of 90 t and 30 m at 18 m/s, 55 % of it on its foils."""

    mass_kg: Positive = 90_000.0
    """Added mass included."""
    pitch_inertia_kgm2: Positive = 4.4e6
    """About the centre of gravity, added inertia included."""
    heave_stiffness_npm: Positive = 3.0e5
    """rho g times the waterplane area."""
    heave_stiffening_per_m2: NotNegative = 0.6
    pitch_stiffness_nmprad: Positive = 1.8e7
    pitch_stiffening_per_rad2: NotNegative = 2.0
    heave_damping_nspm: NotNegative = 6.0e4
    heave_quadratic_damping_ns2pm2: NotNegative = 4.0e4
    pitch_damping_nmsprad: NotNegative = 4.0e6
    pitch_quadratic_damping_nms2prad2: NotNegative = 8.0e6
    foil_borne_weight_n: NotNegative = 4.85e5
    """Weight that the hulls do not carry at the design attitude."""
    pitching_moment_nm: float = 1.0e5
    """Of thrust and drag, bow up."""
    fore_foil: Foil = Foil(arm_m=6.0)
    aft_foil: Foil = Foil(arm_m=-6.0)
    lift_slope_per_rad: Positive = 4.0
    """Of the finite span."""
    stall_rad: Positive = 0.22
    surface_loss: Annotated[float, msgspec.Meta(ge=0, lt=1)] = 0.5
    """Share of the lift that is lost at the surface."""
    surface_length_m: Positive = 0.6
    """Depth over which that falls to 1/e: about half a chord."""
    ventilation_depth_m: float = 0.15
    """Depth at which half of the lift is left to ventilation."""
    ventilation_width_m: Positive = 0.1
    water_density_kgpm3: Positive = 1025.0
    service_speed_mps: NotNegative = 18.0
    """Assumed while the speed is not known."""
    max_speed_mps: Positive = 30.0
    """A greater speed is not believed."""
    max_flap_rad: Positive = 0.35
    """Stop of the flaps; a greater angle is not believed."""


FOILLESS: Final = Vessel(
    foil_borne_weight_n=0.0,
    pitching_moment_nm=0.0,
    fore_foil=Foil(arm_m=6.0, area_m2=0.0),
    aft_foil=Foil(arm_m=-6.0, area_m2=0.0),
    service_speed_mps=0.0,
)
"""The default hulls, on no foils: afloat at the design attitude at any speed."""


class Craft:
    """The equations of motion of one vessel. States are (4, ...): z, z', theta, q; forces (2, ...): heave, pitch."""

    def __init__(self, vessel: Vessel) -> None:
        foils = (vessel.fore_foil, vessel.aft_foil)
        inertia = np.array([[vessel.mass_kg], [vessel.pitch_inertia_kgm2]])
        self.vessel = vessel
        self._stall, self._loss = vessel.stall_rad, vessel.surface_loss
        self._length, self._width = vessel.surface_length_m, vessel.ventilation_width_m
        self._ventilation = vessel.ventilation_depth_m
        self._incidence = np.array([[foil.incidence_rad] for foil in foils])
        self._depth = np.array([[foil.depth_m] for foil in foils])
        self._at_foils = np.array([[1.0, foil.arm_m] for foil in foils])
        """(2, 2): rise of either foil from (z, theta)."""
        lift = [0.25 * vessel.water_density_kgpm3 * foil.area_m2 * vessel.lift_slope_per_rad for foil in foils]
        self._lift = self._at_foils.T * np.array(lift) * vessel.stall_rad / inertia
        """(2, 2): accelerations from U^2 times twice g(h) (the half of the tanh) times tanh(alpha / alpha_s)."""
        self._constant = np.array([[-vessel.foil_borne_weight_n], [vessel.pitching_moment_nm]]) / inertia
        self._stiffness = np.array([[vessel.heave_stiffness_npm], [vessel.pitch_stiffness_nmprad]]) / inertia
        self._stiffening = np.array([[vessel.heave_stiffening_per_m2], [vessel.pitch_stiffening_per_rad2]])
        self._damping = np.array([[vessel.heave_damping_nspm], [vessel.pitch_damping_nmsprad]]) / inertia
        quadratic = (vessel.heave_quadratic_damping_ns2pm2, vessel.pitch_quadratic_damping_nms2prad2)
        self._quadratic = np.array([[quadratic[0]], [quadratic[1]]]) / inertia
        self._fastest = np.array(TUNING.fastest)[:, None]

    def accelerations(
        self,
        state: Array,
        speed_mps: float | Array,
        flaps_rad: Array,
        water_mps: Array | float = 0.0,
        elevation_m: Array | float = 0.0,
    ) -> Array:
        """z'' and q' (2, k), m/s2 and rad/s2, but for F_w and M_w, of states (4, k).

        ``flaps_rad`` (2, 1) or (2, k): fore and aft, trailing edge down. ``water_mps``, ``elevation_m`` (2, k): of the
        water at either foil, up.
        """
        position, velocity = state[0::2], state[1::2]
        speed = np.maximum(speed_mps, TUNING.slowest_mps)
        alpha = self._incidence + TUNING.flap_effect * flaps_rad + position[1]
        alpha -= (self._at_foils.dot(velocity) - water_mps) / speed
        depth = self._depth + elevation_m - self._at_foils.dot(position)
        share = 1.0 - self._loss * np.exp(-np.maximum(depth, 0.0) / self._length)
        share *= 1.0 + np.tanh((depth - self._ventilation) / self._width)
        share *= np.tanh(alpha / self._stall)
        result: Array = self._lift.dot(share * np.maximum(speed_mps, 0.0) ** 2) + self._constant
        stiffening = np.minimum(self._stiffening * position * position, TUNING.most_stiffening)
        result -= self._stiffness * position * (1.0 + stiffening)
        result -= velocity * (self._damping + self._quadratic * np.minimum(np.abs(velocity), self._fastest))
        return result

    def advance(self, state: Array, dt_s: float, speed_mps: float | Array, flaps_rad: Array, forces: Array) -> Array:
        """States (4, k) a step later, by the classic Runge-Kutta method.

        forces (3, 2, k): wave accelerations at its begin, middle and end. Stable while the fastest mode (12 /s on the
        default vessel at 30 m/s) times dt_s is below 2.78, so up to 0.2 s.
        """
        half = 0.5 * dt_s

        def rate(at: Array, force: Array) -> Array:
            slope = np.empty_like(at)
            slope[0::2] = at[1::2]
            slope[1::2] = self.accelerations(at, speed_mps, flaps_rad)
            slope[1::2] += force
            return slope

        first = rate(state, forces[0])
        second = rate(state + half * first, forces[1])
        third = rate(state + half * second, forces[1])
        fourth = rate(state + dt_s * third, forces[2])
        second += third
        first += fourth
        first += 2.0 * second
        result: Array = state + (dt_s / 6.0) * first
        return result

    def trim(self, speed_mps: float, flaps_rad: tuple[float, float] = (0.0, 0.0)) -> tuple[float, float]:
        """Heave (m) and pitch (rad) at which the craft stays, on flat water.

        Raises:
            ArithmeticError: as :meth:`trims`.
        """
        z, theta = self.trims(np.array([speed_mps]), flaps_rad)[:, 0].tolist()
        return z, theta

    def trims(self, speeds_mps: Array, flaps_rad: tuple[float, float] = (0.0, 0.0)) -> Array:
        """Heave and pitch (2, k) at each of the speeds (k,).

        The craft is let go at the design attitude, and where it has nearly come to rest Newton's method takes over: of
        all solutions that finds the stable one.

        Raises:
            ArithmeticError: it does not come to rest at less than a radian: the parameters are those of no vessel, or
                of one that moves too fast to be integrated in steps of 0.1 s.
        """
        flaps, still = np.array(flaps_rad)[:, None], np.zeros((3, 2, speeds_mps.size))
        state = np.zeros((4, speeds_mps.size))

        def excess(position: Array) -> Array:
            at = np.zeros_like(state)
            at[0::2] = position
            return self.accelerations(at, speeds_mps, flaps)

        with np.errstate(all="ignore"):
            for _ in range(200):
                state = self.advance(state, 0.1, speeds_mps, flaps, still)
            position = state[0::2]
            for _ in range(6):
                nudges = 1e-6 * np.eye(2)[:, :, None]
                slopes = [(excess(position + nudge) - excess(position - nudge)) / 2e-6 for nudge in nudges]
                (a, c), (b, d) = slopes
                up, turn = excess(position)
                position = position - np.array([d * up - b * turn, a * turn - c * up]) / (a * d - b * c)
            settled = (np.abs(excess(position)).max(axis=0) < 1e-9) & (np.abs(position[1]) < 1.0)
        if not settled.all():
            raise ArithmeticError(f"the vessel comes to no rest at {speeds_mps[~settled][0]:g} m/s")
        return position
