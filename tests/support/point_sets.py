"""Every point set of the sigma-point core, by name."""

from __future__ import annotations

from typing import TYPE_CHECKING

from heaved.estimation.common import sigma

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.estimation.common.sigma import PointSet

SETS: dict[str, Callable[[int], PointSet]] = {
    "symmetric": sigma.symmetric,
    "symmetric kappa = 3 - n": lambda n: sigma.symmetric(n, beta=0.0, kappa=3.0 - n),
    "cubature": sigma.cubature,
    "spherical simplex": sigma.spherical_simplex,
    "spherical simplex, no centre": lambda n: sigma.spherical_simplex(n, centre_weight=0.0),
    "minimal skew": sigma.minimal_skew_simplex,
}
