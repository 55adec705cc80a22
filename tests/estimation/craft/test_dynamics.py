"""The craft against its equations written out in scalars, root searches, the matrix exponential, and limits."""

from __future__ import annotations

from math import exp, tanh
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

from heaved.estimation.craft.dynamics import FOILLESS, Craft, Foil, Vessel
from heaved.estimation.craft.tuning import TUNING

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

Array = NDArray[np.float64]
DEFAULT = Vessel()
ASYMMETRIC = Vessel(
    fore_foil=Foil(area_m2=4.0, arm_m=8.0, depth_m=1.0, incidence_rad=0.08),
    aft_foil=Foil(area_m2=7.0, arm_m=-5.0, depth_m=1.6, incidence_rad=0.05),
    pitching_moment_nm=-3e5,
)
VESSELS = {"default": DEFAULT, "asymmetric": ASYMMETRIC, "without foils": FOILLESS}
every_vessel = pytest.mark.parametrize("vessel", VESSELS.values(), ids=VESSELS.keys())
NEUTRAL = np.zeros((2, 1))
NEUTRAL_PAIR = (0.0, 0.0)


def written_out(
    v: Vessel,
    state: Sequence[float] | Array,
    speed: float,
    flaps: Sequence[float] | Array = (0.0, 0.0),
    water: Sequence[float] | Array = (0.0, 0.0),
    elevation: Sequence[float] | Array = (0.0, 0.0),
) -> tuple[float, float]:
    """z'' and q' of one state: the equations of the module's head, one by one, in plain Python."""
    z, w, theta, q = state
    force = -v.foil_borne_weight_n - v.heave_stiffness_npm * z * (1 + min(v.heave_stiffening_per_m2 * z**2, 3.0))
    force -= v.heave_damping_nspm * w + v.heave_quadratic_damping_ns2pm2 * min(abs(w), 10.0) * w
    stiffening = min(v.pitch_stiffening_per_rad2 * theta**2, 3.0)
    moment = v.pitching_moment_nm - v.pitch_stiffness_nmprad * theta * (1 + stiffening)
    moment -= v.pitch_damping_nmsprad * q + v.pitch_quadratic_damping_nms2prad2 * min(abs(q), 2.0) * q
    for foil, flap, rise, zeta in zip((v.fore_foil, v.aft_foil), flaps, water, elevation, strict=True):
        alpha = foil.incidence_rad + theta + flap / 2 - (w + foil.arm_m * q - rise) / max(speed, TUNING.slowest_mps)
        h = foil.depth_m + zeta - z - foil.arm_m * theta
        g = 1 - v.surface_loss * exp(-max(h, 0.0) / v.surface_length_m)
        g *= (1 + tanh((h - v.ventilation_depth_m) / v.ventilation_width_m)) / 2
        coefficient = v.lift_slope_per_rad * v.stall_rad * tanh(alpha / v.stall_rad)
        lift = 0.5 * v.water_density_kgpm3 * max(speed, 0.0) ** 2 * foil.area_m2 * g * coefficient
        force += lift
        moment += foil.arm_m * lift
    return force / v.mass_kg, moment / v.pitch_inertia_kgm2


def jacobian(v: Vessel, at: Array, speed: float, flaps: tuple[float, float] = NEUTRAL_PAIR) -> Array:
    """(4, 4) of the equations written out, by central differences."""

    def rate(state: Array) -> Array:
        up, turn = written_out(v, state, speed, flaps)
        return np.array([state[1], up, state[3], turn])

    return np.array([(rate(at + e) - rate(at - e)) / 2e-6 for e in 1e-6 * np.eye(4)]).T


@every_vessel
def test_the_equations_are_those_of_the_head(vessel: Vessel) -> None:
    rng = np.random.default_rng(1)
    states = rng.normal(size=(4, 200)) * np.array([[1.5], [6.0], [0.5], [1.0]])
    flaps, water, elevation = (scale * rng.normal(size=(2, 200)) for scale in (0.2, 1.0, 0.7))
    for speed in (-3.0, 0.0, 0.2, 9.0, 18.0, 30.0):
        found = Craft(vessel).accelerations(states, speed, flaps, water, elevation)
        expected = [
            written_out(vessel, states[:, k], speed, flaps[:, k], water[:, k], elevation[:, k]) for k in range(200)
        ]
        np.testing.assert_allclose(found.T, expected, rtol=1e-10, atol=1e-10)


def zeros(f: Callable[[float], float], grid: Array) -> list[float]:
    """All zeros of f that change its sign between the points of a grid, by bisection; jumps are left out."""
    values = [f(x) for x in grid.tolist()]
    brackets = [i for i in range(len(grid) - 1) if values[i] * values[i + 1] <= 0.0]
    found = [float(brentq(f, grid[i], grid[i + 1], xtol=1e-13)) for i in brackets]
    return [x for x in found if abs(f(x)) < 1e-8]


@every_vessel
@pytest.mark.parametrize(
    ("speed", "flaps"),
    [(speed, NEUTRAL_PAIR) for speed in (0.0, 6.0, 14.0, 18.0, 30.0)] + [(9.0, (-0.1, 0.15)), (18.0, (0.05, -0.02))],
)
def test_the_trim_is_where_a_search_by_bisection_finds_it(
    vessel: Vessel, speed: float, flaps: tuple[float, float]
) -> None:
    """For each heave the pitch without moment that is nearest to level, and among those the heave without force.

    There may be others (fast and far nose down, the aft foil in the air): the one that is taken must be stable.
    """

    def level(z: float) -> float:
        def moment(theta: float) -> float:
            return written_out(vessel, (z, 0.0, theta, 0.0), speed, flaps)[1]

        return min(zeros(moment, np.linspace(-0.505, 0.505, 102)), key=abs)

    candidates = zeros(
        lambda z: written_out(vessel, (z, 0.0, level(z), 0.0), speed, flaps)[0], np.linspace(-2.0, 2.0, 40)
    )
    z, theta = Craft(vessel).trim(speed, flaps)
    nearest = min(candidates, key=lambda candidate: abs(candidate - z))
    assert (z, theta) == pytest.approx((nearest, level(nearest)), abs=1e-8)
    assert np.linalg.eigvals(jacobian(vessel, np.array([z, 0.0, theta, 0.0]), speed, flaps)).real.max() < -0.1


def test_foils_lift_the_craft_and_without_them_it_floats() -> None:
    craft = Craft(DEFAULT)
    heights = craft.trims(np.linspace(0.0, 30.0, 61))[0]
    assert np.all(np.diff(heights) > 0.0)
    assert np.max(np.diff(heights)) < 0.1, "the trim jumps"
    # Stopped, the hulls carry all of it: K z (1 + c z^2) = -W_f.
    z = heights[0]
    carried = -DEFAULT.heave_stiffness_npm * z * (1 + DEFAULT.heave_stiffening_per_m2 * z**2)
    assert carried == pytest.approx(DEFAULT.foil_borne_weight_n, rel=1e-6)
    for speed in (0.0, 5.0, 30.0):
        assert Craft(FOILLESS).trim(speed) == pytest.approx((0.0, 0.0), abs=1e-12)


def test_without_foils_speed_and_flaps_are_nothing() -> None:
    state = np.array([[-0.4], [0.7], [0.05], [-0.1]])
    craft = Craft(FOILLESS)
    at_rest = craft.accelerations(state, 0.0, NEUTRAL)
    np.testing.assert_array_equal(craft.accelerations(state, 25.0, np.full((2, 1), 0.3)), at_rest)
    assert Craft(DEFAULT).accelerations(state, 18.0, NEUTRAL)[0, 0] != pytest.approx(at_rest[0, 0], rel=0.1)


def test_a_vessel_without_trim_is_refused() -> None:
    sinking = msgspec.structs.replace(DEFAULT, pitching_moment_nm=1e12)
    with pytest.raises(ArithmeticError, match="no rest"):
        Craft(sinking).trim(0.0)


def test_lift_ends_at_the_stall_and_in_the_air() -> None:
    """The lift is what differs between a craft with foils and the same without."""
    v, craft = DEFAULT, Craft(DEFAULT)
    no_foils = msgspec.structs.replace(
        v, fore_foil=Foil(arm_m=6.0, area_m2=0.0), aft_foil=Foil(arm_m=-6.0, area_m2=0.0)
    )

    def lift(z: float, angle: float) -> float:
        """N; the angle of attack is set by the vertical speed."""
        incidence = v.fore_foil.incidence_rad
        state = np.array([[z], [(incidence - angle) * 18.0], [0.0], [0.0]])
        with_foils, without = (c.accelerations(state, 18.0, NEUTRAL)[0, 0] for c in (craft, Craft(no_foils)))
        return float((with_foils - without) * v.mass_kg)

    pressure = 0.5 * 1025.0 * 18.0**2
    deep = pressure * (v.fore_foil.area_m2 + v.aft_foil.area_m2)
    assert lift(-8.0, 0.01) == pytest.approx(deep * v.lift_slope_per_rad * 0.01, rel=1e-3)
    assert lift(-8.0, 2.0) == pytest.approx(deep * v.lift_slope_per_rad * v.stall_rad, rel=1e-3)
    assert lift(0.0, 0.05) < 0.97 * lift(-8.0, 0.05)
    assert abs(lift(1.3 + 0.5, 0.05)) < 1e-3 * lift(0.0, 0.05), "a foil in the air still lifts"


@every_vessel
@pytest.mark.parametrize("dt_s", [0.01, 0.02, 0.05])
def test_a_step_near_the_trim_is_the_matrix_exponential(vessel: Vessel, dt_s: float) -> None:
    craft, speed = Craft(vessel), 18.0
    z, theta = craft.trim(speed)
    trim = np.array([z, 0.0, theta, 0.0])
    small = 1e-5 * np.random.default_rng(2).normal(size=(4, 6))
    moved = craft.advance(trim[:, None] + small, dt_s, speed, NEUTRAL, np.zeros((3, 2, 6)))
    expected = expm(jacobian(vessel, trim, speed) * dt_s) @ small
    np.testing.assert_allclose(moved - trim[:, None], expected, rtol=0, atol=2e-4 * np.abs(small).max())


def test_a_step_is_of_fourth_order() -> None:
    """Far from the trim, driven, against a solver with an error of its own that is far smaller."""
    craft, begin = Craft(ASYMMETRIC), np.array([0.3, -0.8, 0.06, 0.2])
    flaps = (0.1, -0.05)

    def push(t: float) -> Array:
        return np.array([1.5 * np.sin(4.0 * t), 0.2 * np.cos(5.0 * t)])

    def rate(t: float, state: Array) -> Array:
        up, turn = written_out(ASYMMETRIC, state, 18.0, flaps) + push(t)
        return np.array([state[1], up, state[3], turn])

    exact = solve_ivp(rate, (0.0, 0.4), begin, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    errors = []
    for steps in (8, 16, 32):
        dt, state = 0.4 / steps, begin[:, None]
        for k in range(steps):
            forces = np.stack([push((k + part) * dt)[:, None] for part in (0.0, 0.5, 1.0)])
            state = craft.advance(state, dt, 18.0, np.array(flaps)[:, None], forces)
        errors.append(float(np.max(np.abs(state[:, 0] - exact))))
    assert errors[1] < errors[0] / 10.0
    assert errors[2] < errors[1] / 10.0


@every_vessel
@pytest.mark.parametrize(("speed", "dt_s"), [(0.0, 0.1), (18.0, 0.01), (18.0, 0.05), (30.0, 0.1)])
def test_from_anywhere_the_craft_comes_to_rest_at_its_trim(vessel: Vessel, speed: float, dt_s: float) -> None:
    craft = Craft(vessel)
    state = np.array([[2.0, -20.0, 0.5], [3.0, -30.0, 0.0], [0.3, -0.3, 0.1], [-1.0, 5.0, 0.0]])
    for _ in range(round(40.0 / dt_s)):
        state = craft.advance(state, dt_s, speed, NEUTRAL, np.zeros((3, 2, 3)))
    z, theta = craft.trim(speed)
    np.testing.assert_allclose(state.T, np.tile([z, 0.0, theta, 0.0], (3, 1)), atol=1e-3)
