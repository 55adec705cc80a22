"""How a sensor is bolted to the vessel: from its own axes to those of :mod:`heaved.samples`. Pure.

``R = vessel_from_sensor = Rz(z) Ry(y) Rx(x)``, active and right-handed: a sensor along the vessel's axes that is turned
by z about the vertical, then by y about its new y axis, then by x about its new x axis, stands as it does. Of a vector
``v_vessel = R v_sensor``; of the attitude ``level_from_vessel = level_from_sensor R'``.

The attitude is turned as the two directions that it consists of, so that no angle of the sensor is divided by: the
vertical, ``up_sensor = (sin pitch, sin roll cos pitch, cos roll cos pitch)``, which gives roll and pitch whatever the
heading is; and the vessel's bow, whose heading is that of the sensor plus what it is off the sensor's x axis in the
level plane. On a bulkhead, where the sensor's own pitch is near a right angle, roll and yaw of the sensor turn about
the same axis: neither means anything alone, and the vessel's heading is right as far as they are of one moment.

What would take a reading that is not there is nan.
"""

from __future__ import annotations

from math import asin, atan2, cos, degrees, hypot, isfinite, nan, pi, radians, sin
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

    from heaved.devices.profile import DeviceSpec, Quantity

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]

FORCES: Final[tuple[Quantity, Quantity, Quantity]] = ("ax_mps2", "ay_mps2", "az_mps2")
RATES: Final[tuple[Quantity, Quantity, Quantity]] = ("gx_radps", "gy_radps", "gz_radps")
ANGLES: Final[tuple[Quantity, Quantity, Quantity]] = ("roll_rad", "pitch_rad", "yaw_rad")
_QUARTER: Final = {0.0: (0.0, 1.0), 90.0: (1.0, 0.0), 180.0: (0.0, -1.0), 270.0: (-1.0, 0.0)}
"""Sine and cosine as they are, so that an axis has no share in another one at a right angle to it."""
_NONE: Final = (0.0, 0.0, 0.0)


def rotation(x_deg: float, y_deg: float, z_deg: float) -> Matrix:
    """``Rz(z) Ry(y) Rx(x)``."""
    (sx, cx), (sy, cy), (sz, cz) = (_sine_cosine(angle) for angle in (x_deg, y_deg, z_deg))
    return (
        (cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx),
        (sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx),
        (-sy, cy * sx, cy * cx),
    )


def angles_deg(matrix: Matrix) -> Vector:
    """The (x, y, z) of which :func:`rotation` makes the matrix, y in [-90, 90]. At y = +-90 only x -+ z is defined:
    x is zero.
    """
    (xx, xy, _), (yx, yy, _), (zx, zy, zz) = matrix
    y = asin(min(1.0, max(-1.0, -zx)))
    if abs(zx) > 1.0 - 1e-12:
        return 0.0, degrees(y), degrees(atan2(-xy, yy))
    return degrees(atan2(zy, zz)), degrees(y), degrees(atan2(yx, xx))


class Mounting:
    """Turns what one sensor reads; made by :func:`mounting_of`."""

    def __init__(self, rotation_deg: Vector, bias_mps2: Vector = _NONE) -> None:
        """``bias_mps2``: of the accelerometers, in the sensor's axes."""
        self._matrix = rotation(*rotation_deg)
        self._is_turned = any(angle % 360.0 for angle in rotation_deg)
        self._bias = bias_mps2

    def turn(self, values: Mapping[Quantity, float]) -> dict[Quantity, float]:
        """Readings in the sensor's axes, SI units, as they are in the vessel's; others stay as they are."""
        turned = dict(values)
        if any(name in values for name in FORCES):
            force = _vector(values, FORCES)
            bx, by, bz = self._bias
            self._put(turned, FORCES, (force[0] - bx, force[1] - by, force[2] - bz))
        if self._is_turned:
            if any(name in values for name in RATES):
                self._put(turned, RATES, _vector(values, RATES))
            if any(name in values for name in ANGLES):
                turned.update(zip(ANGLES, self._attitude(*_vector(values, ANGLES)), strict=True))
        return turned

    def _put(self, turned: dict[Quantity, float], names: tuple[Quantity, ...], vector: Vector) -> None:
        turned.update(zip(names, self._product(vector) if self._is_turned else vector, strict=True))

    def _product(self, v: Vector) -> Vector:
        x, y, z = v
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = self._matrix
        if isfinite(x + y + z):
            return xx * x + xy * y + xz * z, yx * x + yy * y + yz * z, zx * x + zy * y + zz * z
        # An axis that has no share of the missing one is known.
        first, second, third = (
            sum(share * part for share, part in zip(row, v, strict=True) if share != 0.0) for row in self._matrix
        )
        return first, second, third

    def _attitude(self, roll: float, pitch: float, yaw: float) -> Vector:
        if not isfinite(roll + pitch):
            return self._partly(roll, pitch, yaw)
        sr, cr, sp, cp = sin(roll), cos(roll), sin(pitch), cos(pitch)
        bow_x, bow_y, bow_z = self._matrix[0]
        forward = cp * bow_x - sp * (sr * bow_y + cr * bow_z)
        to_port = cr * bow_y - sr * bow_z
        up_x, up_y, up_z = self._product((sp, sr * cp, cr * cp))
        heading = (yaw + atan2(-to_port, forward)) % (2.0 * pi)
        return atan2(up_y, up_z), asin(min(1.0, max(-1.0, up_x))), heading

    def _partly(self, roll: float, pitch: float, yaw: float) -> Vector:
        """Of a sensor whose x axis lies along the vessel's, if only the other way round, each angle stands alone."""
        along = self._matrix[0][0]
        if abs(along) != 1.0:
            return nan, nan, nan
        (_, yy, yz), (_, zy, zz) = self._matrix[1], self._matrix[2]
        sr, cr = sin(roll), cos(roll)
        heading = (yaw if along > 0.0 else yaw + pi) % (2.0 * pi)
        return atan2(yy * sr + yz * cr, zy * sr + zz * cr), along * pitch, heading


def mounting_of(device: DeviceSpec) -> Mounting | None:
    """How a device is mounted; None: as the vessel's axes are, and without a bias."""
    if not (any(angle % 360.0 for angle in device.rotation_deg) or any(device.bias_mps2)):
        return None
    return Mounting(device.rotation_deg, device.bias_mps2)


def mounting_lines(device: DeviceSpec) -> list[str]:
    """For a person: how the sensor stands, and what is taken off; none if there is nothing to say."""
    lines = []
    if any(angle % 360.0 for angle in device.rotation_deg):
        matrix = rotation(*device.rotation_deg)
        axes = ", ".join(
            f"its {name} axis points {_direction(column)}"
            for name, column in zip("xyz", zip(*matrix, strict=True), strict=True)
        )
        lines.append(f"mounting: {axes}")
    if any(device.bias_mps2):
        lines.append(
            "bias taken off, in its own axes: " + ", ".join(f"{part:+.3f}" for part in device.bias_mps2) + " m/s2"
        )
    if device.attitude_latency_ms:
        age = "older" if device.attitude_latency_ms > 0.0 else "younger"
        lines.append(f"its angles are {abs(device.attitude_latency_ms):g} ms {age} than its accelerations")
    return lines


def _direction(v: tuple[float, ...]) -> str:
    """Of a unit vector in the vessel's axes: the nearest of the six, and how far off that it is."""
    k = max(range(3), key=lambda i: abs(v[i]))
    name = (("aft", "forward"), ("to starboard", "to port"), ("down", "up"))[k][v[k] > 0.0]
    off_deg = degrees(atan2(hypot(*(v[i] for i in range(3) if i != k)), abs(v[k])))
    return name if off_deg < 0.05 else f"{name}, {off_deg:.1f} degrees off"


def _vector(values: Mapping[Quantity, float], names: tuple[Quantity, Quantity, Quantity]) -> Vector:
    x, y, z = names
    return values.get(x, nan), values.get(y, nan), values.get(z, nan)


def _sine_cosine(angle_deg: float) -> tuple[float, float]:
    angle_deg %= 360.0
    return _QUARTER.get(angle_deg) or (sin(radians(angle_deg)), cos(radians(angle_deg)))
