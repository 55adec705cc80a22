"""One linear-Gaussian problem after the other, through every filter of the house that takes it: all are Kalman's."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from point_sets import SETS
from scipy.linalg import expm
from seas import model, simulated

from heaved.estimation.common import sigma
from heaved.estimation.craft import filter_bank as bank
from heaved.estimation.craft.filter_bank import Bank
from heaved.estimation.heave.harmonic.observer import HarmonicObserver
from heaved.estimation.heave.params import Params
from heaved.estimation.heave.sea.filter import SeaFilter
from heaved.estimation.heave.sea.model import SeaSystem, measurement_variance

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.estimation.common.sigma import PointSet

Array = NDArray[np.float64]


class Problem(msgspec.Struct, frozen=True, eq=False, kw_only=True):
    """x' = F x + w, z = H x + v; the steps may be of unlike length. nan: the reading is missing."""

    F: Array
    """(steps, n, n)"""
    Q: Array
    """(steps, n, n)"""
    H: Array
    """(m, n)"""
    R: Array
    """(steps, m, m)"""
    x: Array
    P: Array
    z: Array
    """(steps, m)"""
    shown: Array
    """(k, n) what is compared."""
    exact: float = 1e-11
    """Share of the largest value, and of the largest variance, to which filters agree."""


class Found(msgspec.Struct, frozen=True, eq=False):
    """What is shown of the state after each step, (steps, k), and its covariance (steps, k, k)."""

    mean: Array
    covariance: Array


def shown(problem: Problem, states: list[tuple[Array, Array]]) -> Found:
    L = problem.shown
    return Found(np.array([L @ x for x, _ in states]), np.array([L @ P @ L.T for _, P in states]))


def kalman(problem: Problem) -> Found:
    """Kalman 1960 in the Joseph form, with explicit inverses: slow, plain, sharing nothing with the filters."""
    x, P, H, states = problem.x, problem.P, problem.H, []
    for F, Q, R, z in zip(problem.F, problem.Q, problem.R, problem.z, strict=True):
        x, P = F @ x, F @ P @ F.T + Q
        if np.isfinite(z).all():
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            A = np.eye(len(x)) - K @ H
            x, P = x + K @ (z - H @ x), A @ P @ A.T + K @ R @ K.T
        states.append((x, P))
    return shown(problem, states)


def agrees(found: Found, problem: Problem) -> None:
    expected = kalman(problem)
    for ours, theirs in ((found.mean, expected.mean), (found.covariance, expected.covariance)):
        assert np.abs(ours - theirs).max() <= problem.exact * np.abs(theirs).max()


# --- the problems ----------------------------------------------------------------------------------------------------


def random(n: int, *, states_are_measured: bool = False) -> Problem:
    """A stable model with correlated noises; a tenth of the readings is missing.

    ``states_are_measured``: readings are states, with independent noises.
    """
    rng, m, steps = np.random.default_rng(n), min(n, 1 + n % 4), 200

    def covariance(size: int, scale: float) -> Array:
        root = rng.normal(size=(size, size))
        return scale * (root @ root.T / size + 0.2 * np.eye(size))

    rotation, _ = np.linalg.qr(rng.normal(size=(n, n)))
    Q, R = covariance(n, 0.05), covariance(m, 0.2)
    return Problem(
        F=np.array([rotation @ np.diag(rng.uniform(0.7, 0.99, n)) for _ in range(steps)]),
        Q=np.array([0.5 * (Q + Q.T)] * steps),
        H=np.eye(n)[:m] if states_are_measured else rng.normal(size=(m, n)),
        R=np.array([np.diag(R.diagonal()) if states_are_measured else 0.5 * (R + R.T)] * steps),
        x=rng.normal(size=n),
        P=np.eye(n),
        z=np.where(rng.random((steps, 1)) < 0.1, np.nan, rng.normal(size=(steps, m))),
        shown=np.eye(n),
    )


SEA = SeaSystem(model(4, 2))
SEA_STEP_S, SEA_STEPS = 0.05, 100


def sea() -> Problem:
    """The sea's own model from a true state and the steady covariance.

    Of the stationary one a factor has no digits to spare, and readings far off would pass no gate.
    """
    steady = SEA.steady(SEA_STEP_S)
    assert steady is not None
    F, Q = SEA.transition(SEA_STEP_S)
    states, a = simulated(SEA, SEA_STEP_S, 1 + SEA_STEPS, seed=11)
    return Problem(
        F=np.array([F] * SEA_STEPS),
        Q=np.array([Q] * SEA_STEPS),
        H=SEA.H[None, :],
        R=np.full((SEA_STEPS, 1, 1), measurement_variance(1e-6, SEA_STEP_S)),
        x=states[0],
        P=steady.P,
        z=a[1:, None],
        shown=SEA.heave[None, :],
        exact=1e-9,
    )


def harmonic(components: int) -> tuple[Problem, Found]:
    """The paper's model on irregular times, and what its observer makes of it.

    The readings are what the observer's integrator makes of an acceleration; the first search for frequencies, which
    changes the model, comes later. What is shown is heave and its velocity.
    """
    params = Params(components=components, initial_period_s=7.0)
    observer, rng, n = HarmonicObserver(params), np.random.default_rng(4), 2 * components + 1
    dt_s = rng.uniform(0.01, 0.14, 180)
    dt_s[0] = 0.0
    omega = 2.0 * np.pi / 7.0 * (1.0 + 0.25 * np.arange(components))
    generator = np.zeros((n, n))
    for i, w in enumerate(omega):
        generator[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[0.0, 1.0], [-(w**2), 0.0]]
    readings, motions = [], []
    for t in (1e6 + np.cumsum(dt_s)).tolist():
        observer.step(t, 0.4 * np.sin(0.9 * t) + 0.1 + 0.05 * rng.standard_normal())
        motion = observer.unshifted()
        readings.append([observer.inertial_m])
        motions.append((motion.heave_m, motion.velocity_mps))
    per_s = np.diag([params.process_noise] * (n - 1) + [params.drift_process_noise_m2]) / 0.05
    problem = Problem(
        F=np.array([expm(generator * dt) for dt in dt_s]),
        Q=np.array([per_s * dt for dt in dt_s]),
        H=np.array([[1.0, 0.0] * components + [1.0]]),
        R=(params.measurement_variance_m2 * 0.05 / np.maximum(dt_s, 1e-3))[:, None, None],
        x=np.zeros(n),
        P=params.initial_variance * np.eye(n),
        z=np.array(readings),
        shown=np.array([[1.0, 0.0] * components + [0.0], [0.0, 1.0] * components + [0.0]]),
        exact=1e-8,
    )
    return problem, Found(np.array(motions), kalman(problem).covariance)


# --- the filters -----------------------------------------------------------------------------------------------------


def by_points(points: PointSet, problem: Problem) -> Found:
    """The sigma-point core."""
    x, P, states = problem.x, problem.P, []
    for F, Q, R, z in zip(problem.F, problem.Q, problem.R, problem.z, strict=True):
        predicted = sigma.predict(points, x, P, F, Q)
        assert predicted is not None
        x, P = predicted.x, predicted.P
        if np.isfinite(z).all():
            updated = sigma.update(points, x, P, z, problem.H, R)
            assert updated is not None
            y, S = z - problem.H @ x, problem.H @ P @ problem.H.T + R
            assert updated.y == pytest.approx(y, rel=1e-9, abs=1e-12)
            assert updated.nis == pytest.approx(y @ np.linalg.inv(S) @ y, rel=1e-6)
            x, P = updated.x, updated.P
            assert np.array_equal(P, P.T)
        states.append((x, P))
    return shown(problem, states)


def by_bank(problem: Problem) -> list[Found]:
    """The craft's bank, one filter per point set, reading by reading."""
    n = len(problem.x)
    points = bank.stack([make(n) for make in SETS.values()])
    count = len(SETS)
    filters = Bank(np.array([problem.x] * count), np.array([problem.P] * count))
    found: list[list[tuple[Array, Array]]] = [[] for _ in SETS]
    for F, Q, R, z in zip(problem.F, problem.Q, problem.R, problem.z, strict=True):
        moved = bank.predict(points, filters, F.dot, np.array([Q] * count))
        assert moved is not None
        filters = moved
        for state, reading in enumerate(z.tolist()):
            if np.isfinite(reading):
                variance = filters.P[:, state, state] + R[state, state]
                filters = bank.update(filters, state, reading - filters.x[:, state], variance)
        for i in range(count):
            found[i].append((filters.x[i], filters.P[i]))
    return [shown(problem, states) for states in found]


def by_sea_filter(problem: Problem) -> Found:
    """The live filter of the sea observer."""
    steady = SEA.steady(SEA_STEP_S)
    assert steady is not None
    live = SeaFilter(SEA, steady, 0.0, problem.x, problem.P.copy())
    states = []
    for i, (a,) in enumerate(problem.z.tolist(), 1):
        live.step(i * SEA_STEP_S, a)
        states.append((live.x.copy(), live.covariance.copy()))
    assert live.rejected == 0
    return shown(problem, states)


# --- all are Kalman's ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", SETS.values(), ids=SETS.keys())
@pytest.mark.parametrize(
    "problem",
    [*(random(n) for n in (1, 2, 3, 4, 7, 12, 17, 25)), sea(), harmonic(1)[0], harmonic(3)[0]],
    ids=[*(f"random {n}" for n in (1, 2, 3, 4, 7, 12, 17, 25)), "sea", "harmonic 1", "harmonic 3"],
)
def test_every_set_of_sigma_points(make: Callable[[int], PointSet], problem: Problem) -> None:
    agrees(by_points(make(len(problem.x)), problem), problem)


@pytest.mark.parametrize("n", [1, 3, 5, 8])
def test_a_bank_of_them(n: int) -> None:
    problem = random(n, states_are_measured=True)
    for found in by_bank(problem):
        agrees(found, problem)


def test_the_live_filter_of_the_sea() -> None:
    problem = sea()
    agrees(by_sea_filter(problem), problem)


@pytest.mark.parametrize("components", [1, 3])
def test_the_harmonic_observer(components: int) -> None:
    problem, found = harmonic(components)
    agrees(found, problem)
    assert np.abs(found.mean).max() > 0.01
