"""The transition of one axis over one step, from the last M points: Wei et al. 2019 (ship rock prediction), eq. (6)."""

from __future__ import annotations

from collections.abc import Sequence

STILL_RAD = 1e-9
"""Motion below this is arithmetic noise."""
COLLINEAR = 1e-9
"""Least determinant, relative to that of uncorrelated regressors."""


def regression(moments: Sequence[Sequence[float]], mean: float, mean_doubt: float) -> tuple[float, float, float]:
    """Least squares x' = phi_x x + phi_v v + c: (phi_x, phi_v, c). Plain floats: a dozen 2 x 2 systems are no array.

    ``moments`` 4 x 4: sums of products of (x, v, 1, x'), x' the measured angle one step after x and v, in rad; v in
    rad per step. ``mean``: of the angle. ``mean_doubt``: its standard deviation over that of the motion.

    For an oscillator c = (1 - phi_x) mean. That is exact when the mean is known and costs nothing; a free c would
    waste information, a wrong mean would bend phi. So c is free within what the doubt allows: 1 - phi_x is near
    w^2/2 (w^2 = vv/xx, per step), so c has the prior deviation doubt * sqrt(xx/n) * w^2/2, against the residuals.
    Where the motion cannot tell (a still ship), x' = x.
    """
    (sum_xx, sum_xv, x, sum_xy), (_, vv, v, sum_vy), (_, _, count, y), (_, _, _, sum_yy) = moments
    n = max(count, 1.0)
    # About the mean.
    xx = sum_xx - mean * (2.0 * x - n * mean)
    xv = sum_xv - mean * v
    xy = sum_xy - mean * (x + y - n * mean)
    vy = sum_vy - mean * v
    yy = sum_yy - mean * (2.0 * y - n * mean)
    x, y = x - n * mean, y - n * mean

    def slopes(share: float) -> tuple[float, float]:
        """Slopes when that share of each product of sums is explained by the constant (0: none, 1/n: it is free)."""
        a, b, c = xx - share * x * x, xv - share * x * v, vv - share * v * v
        p, q = xy - share * x * y, vy - share * v * y
        determinant = a * c - b * b
        if min(a, c) <= n * STILL_RAD**2 or determinant <= COLLINEAR * a * c:
            return 1.0, 0.0
        return (p * c - q * b) / determinant, (q * a - p * b) / determinant

    phi_x, phi_v = slopes(1.0 / n)
    explained = phi_x * (xy - x * y / n) + phi_v * (vy - v * y / n)
    residual = max(yy - y * y / n - explained, 0.0) / n
    prior = (mean_doubt * vv / 2.0) ** 2 / (xx * n) if xx > 0.0 else 0.0
    share = prior / (residual + n * prior) if prior > 0.0 else 0.0

    phi_x, phi_v = slopes(share)
    return phi_x, phi_v, mean * (1.0 - phi_x) + share * (y - phi_x * x - phi_v * v)
