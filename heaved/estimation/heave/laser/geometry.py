"""Where a gauge is and where its beam points: a reading from the heave of the IMU, the heave from a reading, and what
readings say of either.

With the vertical in vessel axes u = (sin p, sin r cos p, cos r cos p), the place q of the gauge from the IMU, its beam
b and the level target H below or above it on the level ship, a reading D of a gauge that the vessel carries has

    D (-s u . b) = H + s (h + u . q - e_z . q)         s = +1: it looks down, s = -1: up

(the lever arm is that of :mod:`heaved.estimation.lever_arm`). A gauge that stands on something fixed has a beam that
does not tilt: q is where it meets the vessel, and -s u . b is 1.

What can be found of it: a vessel that pitches shows how far the *foot* of the beam, where it meets the target, lies
ahead of the IMU, foot = forward + H tan(lean), since both terms are proportional to the pitch; likewise roll and port.
Its parts are told apart only by products of small numbers, heave times angle above all: lean times pitch times a metre
is 0.3 mm for one degree each. How high the gauge is over the IMU shows in the squares of the angles, beside the
distance itself, which the reading tells.
"""

from __future__ import annotations

from math import atan, hypot, inf, radians, sqrt
from typing import Final, Literal, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Real = TypeVar("Real", float, Array)
Vector = tuple[float, float, float]

DOWN: Final[Vector] = (0.0, 0.0, -1.0)
LEAST_ALONG: Final = 0.1
"""Cosine between beam and vertical below which a beam does not meet a level target anywhere near."""


class Geometry(msgspec.Struct, frozen=True, kw_only=True):
    """A gauge: metres from the IMU along the axes of the vessel."""

    forward_m: float = 0.0
    port_m: float = 0.0
    up_m: float = 0.0
    beam: Vector = DOWN
    """From the gauge to its target, in vessel axes; of any length, and not level."""
    sign: Literal[1, -1] = 1
    """+1: the reading grows as the vessel heaves up."""
    is_distance: bool = True
    """Whether readings are distances along the beam; else they are a heave with some constant, and no tilt of the beam
    is in them.
    """

    @property
    def beam_tilts(self) -> bool:
        """Whether the beam tilts with the vessel: a gauge on board that looks down reads more as she rises, one that
        looks up less; one of which the opposite is true stands on something fixed and looks at her.
        """
        return self.is_distance and self.sign * self.beam[2] < 0.0

    @property
    def leans(self) -> tuple[float, float]:
        """Tangents of the beam's lean from the vertical of the vessel, forward and to port; 0 for one that stands on
        something fixed.
        """
        x, y, z = self.beam
        return (x / abs(z), y / abs(z)) if self.beam_tilts else (0.0, 0.0)

    def foot_m(self, height_m: float) -> tuple[float, float]:
        """Where the beam meets its target on the level ship, forward and to port of the IMU; ``height_m`` between
        gauge and target.
        """
        forward, port = self.leans
        return self.forward_m + height_m * forward, self.port_m + height_m * port

    def reading_m(self, heave_m: Real, roll_rad: Real, pitch_rad: Real, height_m: float) -> Real:
        """What the gauge reads with the IMU at ``heave_m``; ``height_m`` between gauge and target (for readings that
        are no distances: their constant) on the level ship at heave zero. nan: the beam does not meet the target.
        """
        x, y, z = _vertical(roll_rad, pitch_rad)
        rise: Real = heave_m + self._lever_m(x, y, z)
        found: Real = (height_m + self.sign * rise) / self._along(x, y, z)
        return found

    def heave_m(self, reading_m: Real, roll_rad: Real, pitch_rad: Real) -> Real:
        """The heave of the IMU that a reading shows, and ``sign * height_m`` of :meth:`reading_m` with it; nan: no
        beam at that tilt meets the target.
        """
        x, y, z = _vertical(roll_rad, pitch_rad)
        found: Real = self.sign * reading_m * self._along(x, y, z) - self._lever_m(x, y, z)
        return found

    def _lever_m(self, x: Real, y: Real, z: Real) -> Real:
        found: Real = x * self.forward_m + y * self.port_m + (z - 1.0) * self.up_m
        return found

    def _along(self, x: Real, y: Real, z: Real) -> Real:
        """Height per distance along the beam."""
        if not self.beam_tilts:
            return x * 0.0 + 1.0
        bx, by, bz = self.beam
        along: Real = (x * bx + y * by + z * bz) * (-self.sign / sqrt(bx * bx + by * by + bz * bz))
        if isinstance(along, np.ndarray):
            return np.where(along > LEAST_ALONG, along, np.nan)
        return along if along > LEAST_ALONG else along * float("nan")


def _vertical(roll_rad: Real, pitch_rad: Real) -> tuple[Real, Real, Real]:
    """The vertical in the axes of the vessel: third row of the rotation from body to level axes."""
    level = np.cos(pitch_rad)
    return np.sin(pitch_rad), np.sin(roll_rad) * level, np.cos(roll_rad) * level


# --- what readings say of it ------------------------------------------------------------------------------------------


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """How a geometry is fitted, and what counts as found."""

    every_s: float = 0.25
    """Readings are averaged over so long: no wave moves within it, and noise cancels."""
    least_s: float = 20.0
    """Of readings, below which nothing is said."""
    memory_s: float = 120.0
    """The errors of a heave grow and fade over so long: what lies further apart is independent."""
    share: float = 0.2
    """And at most that share of the record is looked at for how long they are alike."""
    steps: int = 4
    """Of Gauss and Newton at most,"""
    still: float = 1e-5
    """which end with one that moves the heave by less, in metres: the model is nearly linear."""
    least_left: float = 3.0
    """Independent readings beyond the number of unknowns, below which nothing is said."""
    gate: float = 8.0
    """Readings further off than so many standard deviations, as the median has them, are not of this target."""
    weighings: int = 12
    """Until those of another target have lost their weight: a third of it each time that they are far off."""
    least_off_m: float = 1e-4
    """No laser repeats better."""
    surely: float = 3.0
    """Standard errors by which the heave must move the reading for its sign to be known."""
    up_std_m: float = 1.0
    """The height of the gauge over the IMU is taken as found when it is known that well,"""
    lean_std_rad: float = radians(0.5)
    """and the lean of its beam likewise: hands measure them as well."""


TUNING: Final = Tuning()
HEIGHT, DRIFT, SCALE, LATE, FORWARD, PORT, UP, LEAN_FORWARD, LEAN_PORT = range(9)
"""Unknowns: metres, metres over the record, the heave that was given over that of the readings, s, foot of the beam (m,
m), m, tangents."""
LINEAR: Final = (HEIGHT, DRIFT, SCALE, LATE, FORWARD, PORT)
"""Which of them are always found."""


class GeometryFit(msgspec.Struct, frozen=True, kw_only=True):
    """What readings say of their gauge. Standard errors are of all unknowns found together; inf: nothing is said of it.

    The place of the gauge and the lean of its beam by themselves are mostly hardly known, the foot of the beam well.
    """

    geometry: Geometry
    """As found; up and beam as they were at the start where they are not: then the foot is right, and forward and port
    are those that go with this beam."""
    foot_forward_m: float
    """Where the beam meets the target, or the vessel, on the level ship."""
    foot_port_m: float
    foot_forward_std_m: float
    foot_port_std_m: float
    foot_forward_alone: float
    """RMS, in metres of heave per metre, of what moving the foot does that scale, lag and the others do not: in regular
    waves next to nothing. Errors that go with the waves are off by their RMS over this."""
    foot_port_alone: float
    forward_std_m: float
    """Of the gauge, with nothing known of its beam."""
    port_std_m: float
    up_std_m: float
    lean_forward_rad: float
    """Of the beam of ``geometry``."""
    lean_port_rad: float
    lean_forward_std_rad: float
    lean_port_std_rad: float
    is_up_found: bool
    is_lean_found: bool
    is_sign_found: bool
    height_m: float
    """Between gauge and target; of readings that are no distances their constant."""
    height_std_m: float
    scale: float
    """Heave that the reading shows over the heave that was given."""
    scale_std: float
    late_s: float
    """How long after the heave that was given the reading shows it."""
    late_std_s: float
    residual_rms_m: float
    independent: float
    """Readings that the residual is worth."""
    left_out: int
    """Averages of :attr:`Tuning.every_s` that were not of this target."""

    def off_m(self, configured: Geometry) -> tuple[float, float]:
        """How far the foot of the beam is from where it would be with another geometry, forward and to port."""
        forward, port = configured.foot_m(self.height_m)
        return self.foot_forward_m - forward, self.foot_port_m - port


class _Rows(msgspec.Struct, frozen=True, eq=False):
    """Averages at even times, (n,) each; zeros and a weight of 0 where there was no reading."""

    weight: Array
    reading_m: Array
    heave_m: Array
    velocity_mps: Array
    x: Array
    y: Array
    z: Array
    ramp: Array
    """Time, from -0.5 to 0.5."""

    def without(self, is_out: NDArray[np.bool_]) -> _Rows:
        return msgspec.structs.replace(self, weight=np.where(is_out, 0.0, self.weight))


def fit_geometry(
    t_s: Array,
    reading_m: Array,
    heave_m: Array,
    velocity_mps: Array,
    roll_rad: Array,
    pitch_rad: Array,
    *,
    start: Geometry,
) -> GeometryFit | None:
    """Regress readings (n,) at increasing ``t_s`` (n,) on heave and its velocity at the IMU, roll and pitch of the same
    moments (n,); rows with a nan are left out. None: too few, or too little motion, for anything to be said.

    The heave must owe nothing to the laser. Scale, lag, roll and pitch are regressed on together, since on a sea each
    goes with the others: a scale or a lag of the heave does not look like a lever arm, nor the other way round. It is
    the heave that is regressed on the readings, for it has the errors: millimetres of them in a regressor that goes
    with three others would make a lever arm. They are coloured, so the standard errors are those of least squares under
    the autocovariance that the residual shows (tapered as by Parzen; Newey and West 1987 for regressors that are
    independent of it), and count what the fit itself has taken out of it.

    start: where the gauge is thought to be. Its sign is turned round, with the beam, if the readings say so.
    """
    rows = _averages(t_s, reading_m, heave_m, velocity_mps, _vertical(roll_rad, pitch_rad))
    if rows is None:
        return None
    if np.any(rows.reading_m[rows.weight > 0.0] <= 0.0):
        start = msgspec.structs.replace(start, is_distance=False)
    is_out = _is_of_another_target(rows)
    rows = rows.without(is_out)
    first = _found(rows, start, _at_start(rows, start), LINEAR)
    if first is None:
        return None
    is_sign_found = bool(abs(first.value[SCALE]) > TUNING.surely * first.std(SCALE))
    if is_sign_found and first.value[SCALE] < 0.0:
        start = _turned(start)
        first = _found(rows, start, _at_start(rows, start), LINEAR)
        if first is None:
            return None
    is_up_found = first.std(UP) < TUNING.up_std_m
    is_lean_found = max(first.std(LEAN_FORWARD), first.std(LEAN_PORT)) < TUNING.lean_std_rad
    more = (UP,) * is_up_found + (LEAN_FORWARD, LEAN_PORT) * is_lean_found
    last = _found(rows, start, first.value, LINEAR + more) if more else first
    if last is None:
        return None
    return _of(
        last, start, is_up_found=is_up_found, is_lean_found=is_lean_found, is_sign_found=is_sign_found,
        left_out=int(np.count_nonzero(is_out)),
    )  # fmt: skip


def _of(
    found: _Found, start: Geometry, *, is_up_found: bool, is_lean_found: bool, is_sign_found: bool, left_out: int
) -> GeometryFit:
    value = found.value.tolist()
    height, ahead, across = value[HEIGHT], value[LEAN_FORWARD], value[LEAN_PORT]
    geometry = msgspec.structs.replace(
        start,
        forward_m=value[FORWARD] - height * ahead,
        port_m=value[PORT] - height * across,
        up_m=value[UP],
        beam=_beam(start, ahead, across) if is_lean_found else start.beam,
    )
    forward, port = np.zeros((2, 9))
    forward[[FORWARD, LEAN_FORWARD, HEIGHT]] = 1.0, -height, -ahead
    port[[PORT, LEAN_PORT, HEIGHT]] = 1.0, -height, -across
    scale = 1.0 / value[SCALE] if value[SCALE] != 0.0 else inf
    return GeometryFit(
        geometry=geometry,
        foot_forward_m=value[FORWARD],
        foot_port_m=value[PORT],
        foot_forward_std_m=found.std(FORWARD),
        foot_port_std_m=found.std(PORT),
        foot_forward_alone=float(found.alone[FORWARD]),
        foot_port_alone=float(found.alone[PORT]),
        forward_std_m=found.std_of(forward),
        port_std_m=found.std_of(port),
        up_std_m=found.std(UP),
        lean_forward_rad=atan(ahead),
        lean_port_rad=atan(across),
        lean_forward_std_rad=found.std(LEAN_FORWARD),
        lean_port_std_rad=found.std(LEAN_PORT),
        is_up_found=is_up_found,
        is_lean_found=is_lean_found,
        is_sign_found=is_sign_found,
        height_m=height,
        height_std_m=found.std(HEIGHT),
        scale=scale,
        scale_std=found.std(SCALE) * scale * scale,
        late_s=value[LATE],
        late_std_s=found.std(LATE),
        residual_rms_m=found.residual_rms_m,
        independent=found.independent,
        left_out=left_out,
    )


def _beam(like: Geometry, ahead: float, across: float) -> Vector:
    """Unit vector with these tangents, up or down like another."""
    long = sqrt(1.0 + ahead * ahead + across * across)
    return ahead / long, across / long, (1.0 if like.beam[2] > 0.0 else -1.0) / long


def _turned(geometry: Geometry) -> Geometry:
    """The same gauge with the other sign: what looked down looks up."""
    x, y, z = geometry.beam
    return msgspec.structs.replace(geometry, sign=-geometry.sign, beam=(x, y, -z))


def _averages(
    t_s: Array, reading_m: Array, heave_m: Array, velocity_mps: Array, vertical: tuple[Array, Array, Array]
) -> _Rows | None:
    """Averages over :attr:`Tuning.every_s`; None: too few."""
    columns = np.array([reading_m, heave_m, velocity_mps, *vertical])
    is_whole = np.isfinite(t_s) & np.isfinite(columns).all(axis=0)
    t_s, columns = t_s[is_whole], columns[:, is_whole]
    if not len(t_s):
        return None
    place = np.floor((t_s - t_s[0]) / TUNING.every_s + 1e-6).astype(np.int64)
    n = int(place[-1]) + 1
    counts = np.bincount(place, minlength=n)
    if np.count_nonzero(counts) * TUNING.every_s < TUNING.least_s:
        return None
    means = [np.bincount(place, column, n) / np.maximum(counts, 1) for column in columns]
    reading, heave, velocity, x, y, z = means
    return _Rows((counts > 0).astype(np.float64), reading, heave, velocity, x, y, z, np.linspace(-0.5, 0.5, n))


def _is_of_another_target(rows: _Rows) -> NDArray[np.bool_]:
    """Which of the readings (n,) are far off what most of them have in common with heave and angles: the line of least
    absolute deviations, by least squares that are weighed again and again.
    """
    seen = rows.weight > 0.0
    one = np.ones(len(seen))
    columns = np.array([one, rows.ramp, rows.heave_m, rows.velocity_mps, rows.x, rows.y, rows.z - 1.0]).T[seen]
    sizes = np.linalg.norm(columns, axis=0)
    columns /= np.where(sizes > 0.0, sizes, 1.0)
    reading = rows.reading_m[seen]
    weight = np.ones(len(reading))
    off = weight
    for _ in range(TUNING.weighings):
        found = np.linalg.lstsq(columns * weight[:, None], reading * weight, rcond=None)[0]
        off = np.abs(reading - columns @ found)
        usual_m = max(float(np.median(off)), TUNING.least_off_m)
        weight = np.sqrt(usual_m / np.maximum(off, usual_m))
    far_m = TUNING.gate / 0.6745 * max(float(np.median(off)), TUNING.least_off_m)
    is_out = np.zeros(len(seen), dtype=bool)
    is_out[seen] = off > far_m
    return is_out


def _at_start(rows: _Rows, start: Geometry) -> Array:
    """The unknowns of a geometry."""
    _, _, bz = start.beam
    seen = rows.weight > 0.0
    height = float(np.mean(rows.reading_m[seen]))
    if start.beam_tilts:
        height *= abs(bz) / sqrt(sum(part * part for part in start.beam))
    value = np.zeros(9)
    value[[HEIGHT, SCALE, UP]] = height, 1.0, start.up_m
    value[[LEAN_FORWARD, LEAN_PORT]] = start.leans
    value[[FORWARD, PORT]] = start.foot_m(height)
    return value


def _heaves(rows: _Rows, start: Geometry, value: Array) -> tuple[Array, Array]:
    """What the heave that was given would be by the readings and the unknowns ``value``, (n,), and its derivatives by
    these, (n, 9); rows without a reading are zero in both.
    """
    height, drift, scale, late, forward, port, up, ahead, across = value.tolist()
    sign, x, y, raised = start.sign, rows.x, rows.y, rows.z - 1.0
    slopes = np.zeros((len(x), len(value)))
    over, leaning = rows.reading_m, np.zeros(len(x))
    if start.beam_tilts:
        long, leaning = hypot(1.0, hypot(ahead, across)), x * ahead + y * across
        along = (rows.z - sign * leaning) / long
        for column, tangent, axis in ((LEAN_FORWARD, ahead, x), (LEAN_PORT, across, y)):
            turned = -(sign * axis / long + along * tangent / long**2)
            slopes[:, column] = scale * (sign * rows.reading_m * turned + height * axis)
        over = over * along
    rise = sign * (over - height - drift * rows.ramp) - (x * forward + y * port + raised * up - height * leaning)
    slopes[:, HEIGHT] = scale * (leaning - sign)
    slopes[:, DRIFT] = -scale * sign * rows.ramp
    slopes[:, SCALE] = rise
    slopes[:, LATE] = rows.velocity_mps
    slopes[:, FORWARD], slopes[:, PORT], slopes[:, UP] = -scale * x, -scale * y, -scale * raised
    return (scale * rise + late * rows.velocity_mps) * rows.weight, slopes * rows.weight[:, None]


class _Found(msgspec.Struct, frozen=True, eq=False):
    """A solution, and how well it is known when all unknowns are."""

    value: Array
    covariance: Array
    """(9, 9); inf on the diagonal: nothing is known of it."""
    alone: Array
    """(9,) RMS of the derivative of the heave by each of them that is not like the others."""
    residual_m: Array
    residual_rms_m: float
    independent: float

    def std(self, i: int) -> float:
        """Of one unknown."""
        return sqrt(self.covariance[i, i])

    def std_of(self, of: Array) -> float:
        """Of a sum of unknowns times ``of`` (9,)."""
        used = of != 0.0
        found = self.covariance[np.ix_(used, used)]
        return sqrt(max(float(of[used] @ found @ of[used]), 0.0)) if np.all(np.isfinite(found)) else inf


def _found(rows: _Rows, start: Geometry, value: Array, unknowns: tuple[int, ...]) -> _Found | None:
    """Gauss-Newton over ``unknowns`` from ``value`` (9,), the others held; None: they cannot be told apart."""
    solved = list(unknowns)
    given = rows.heave_m * rows.weight
    for _ in range(TUNING.steps):
        found, slopes = _heaves(rows, start, value)
        slopes = slopes[:, solved]
        sizes = np.linalg.norm(slopes, axis=0)
        if not np.all(sizes > 0.0):
            return None
        step, _, rank, _ = np.linalg.lstsq(slopes / sizes, given - found, rcond=1e-9)
        if rank < len(solved):
            return None
        value = value.copy()
        value[solved] += step / sizes
        if not np.all(np.isfinite(value)):
            return None
        if float(step @ step) < TUNING.still**2 * len(given):
            break
    found, slopes = _heaves(rows, start, value)
    residual = given - found
    gamma = _autocovariance(residual, rows.weight)
    n = float(rows.weight.sum())
    alike = float(gamma[0] ** 2 + 2.0 * (gamma[1:] @ gamma[1:]))
    independent = n * float(gamma[0]) ** 2 / alike if alike > 0.0 else n
    if independent < len(solved) + TUNING.least_left:
        return None
    unseen = independent / (independent - len(solved))
    covariance, alone = _covariance(slopes, gamma)
    return _Found(
        value,
        unseen * covariance,
        alone / sqrt(n),
        residual,
        sqrt(float(gamma[0]) * unseen),
        independent,
    )


def _autocovariance(residual: Array, weight: Array) -> Array:
    """Tapered autocovariance of a residual by lag, from 0 to as long as it is alike."""
    n = len(residual)
    lags = max(1, min(int(TUNING.memory_s / TUNING.every_s), int(TUNING.share * n)))
    pairs, products = _correlated(weight, lags), _correlated(residual, lags)
    u = np.arange(lags) / lags
    parzen = np.where(u <= 0.5, 1.0 - 6.0 * u**2 * (1.0 - u), 2.0 * (1.0 - u) ** 3)
    found: Array = parzen * products / np.maximum(pairs, 1.0)
    return found


def _correlated(series: Array, lags: int) -> Array:
    """Sums of a series (n,) times itself so many steps later."""
    padded = np.fft.rfft(series, len(series) + lags)
    found: Array = np.fft.irfft(np.abs(padded) ** 2, len(series) + lags)[:lags]
    return found


def _covariance(slopes: Array, gamma: Array) -> tuple[Array, Array]:
    """Of least squares on ``slopes`` (n, 9) with errors of autocovariance ``gamma``: (X'X)^-1 X'GX (X'X)^-1; and the
    norm of what each of the slopes has that the others have not, (9,).
    """
    n, lags = len(slopes), len(gamma)
    covariance, alone = np.full((9, 9), inf), np.zeros(9)
    sizes = np.linalg.norm(slopes, axis=0)
    told = np.flatnonzero(sizes > 1e-9 * n)
    X = slopes[:, told] / sizes[told]
    long = n + lags
    kernel = np.zeros(long)
    kernel[:lags] = gamma
    kernel[long - lags + 1 :] = gamma[:0:-1]
    spread = np.fft.irfft(np.fft.rfft(X, long, axis=0) * np.fft.rfft(kernel)[:, None], long, axis=0)[:n]
    normal = X.T @ X
    if np.linalg.cond(normal) > 1e14:
        return covariance, alone
    inverse = np.linalg.solve(normal, np.eye(len(told)))
    found = inverse @ (X.T @ spread) @ inverse
    # No surer than if each average were independent of the next.
    short = np.maximum(gamma[0] * np.diag(inverse) - np.diag(found), 0.0) * (np.diag(found) <= 0.0)
    found[np.diag_indices_from(found)] += short
    covariance[np.ix_(told, told)] = found / np.outer(sizes[told], sizes[told])
    alone[told] = sizes[told] / np.sqrt(np.diag(inverse))
    return covariance, alone
