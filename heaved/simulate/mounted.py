"""Sensors that stand askew: what another source says in the axes of the vessel, as they read it in their own. Pure."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import msgspec

from heaved.devices.mounting import ANGLES, FORCES, RATES, Matrix, Mounting, Vector, angles_deg, rotation
from heaved.samples import Fault, ImuSample, RatesSample

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from heaved.devices.profile import DeviceSpec
    from heaved.samples import Sample
    from heaved.simulate.slave import Source

LEVEL: Vector = (0.0, 0.0, 0.0)


class Mounted:
    """A source whose IMUs stand, and have a bias, as their devices say, or otherwise by the name of a device."""

    def __init__(self, source: Source, mounts: Mapping[str, Vector], tilt_deg: Vector = LEVEL) -> None:
        """``mounts``: in place of ``rotation_deg`` of the device. ``tilt_deg``: by which all that they are bolted to is
        tilted, likewise.
        """
        self._source, self._mounts, self._tilt = source, mounts, rotation(*tilt_deg)
        self._turns: dict[str, Mounting | None] = {}

    def read(self, device: DeviceSpec, t_s: float) -> Sample:
        """What ``device`` measures at ``t_s``."""
        sample = self._source.read(device, t_s)
        if not isinstance(sample, ImuSample | RatesSample) or sample.fault is not Fault.NONE:
            return sample
        if device.name not in self._turns:
            self._turns[device.name] = self._turn_of(device)
        if (turn := self._turns[device.name]) is None:
            return sample
        names = (*FORCES, *ANGLES, *RATES) if isinstance(sample, ImuSample) else RATES
        return msgspec.structs.replace(sample, **turn.turn({name: getattr(sample, name) for name in names}))

    def _turn_of(self, device: DeviceSpec) -> Mounting | None:
        """From the vessel's axes to those of the sensor: the other way round, so its bias in the vessel's is taken off
        the wrong way, too.
        """
        mounted = _product(self._tilt, rotation(*self._mounts.get(device.name, device.rotation_deg)))
        if mounted == rotation(*LEVEL) and not any(device.bias_mps2):
            return None
        bx, by, bz = device.bias_mps2
        x, y, z = (-(row[0] * bx + row[1] * by + row[2] * bz) for row in mounted)
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = mounted
        return Mounting(angles_deg(((xx, yx, zx), (xy, yy, zy), (xz, yz, zz))), (x, y, z))


def parse_mounts(texts: Sequence[str], devices: Sequence[DeviceSpec]) -> dict[str, Vector]:
    """Read ``device:x,y,z``, degrees, of IMUs among the devices.

    Raises:
        ValueError: one is not that; says which.
    """
    mounts = {}
    names = [device.name for device in devices if device.role in ("imu", "imu2")]
    for text in texts:
        name, colon, angles = text.rpartition(":")
        if not colon or name not in names:
            known = ", ".join(names) or "none"
            raise ValueError(f"mounting {text!r}: write DEVICE:X,Y,Z in degrees; IMUs that there are: {known}")
        x, y, z = _angles(angles, 3, f"mounting {text!r}: write {name}:X,Y,Z in degrees, as rotation_deg")
        mounts[name] = (x, y, z)
    return mounts


def parse_tilt(text: str) -> Vector:
    """Read ``roll,pitch``, degrees, port side up and bow up, as the ``rotation_deg`` of what is tilted so.

    Raises:
        ValueError: it is not that.
    """
    roll, pitch = _angles(text, 2, f"tilt {text!r}: write ROLL,PITCH in degrees, port side up and bow up")
    return roll, -pitch, 0.0


def _angles(text: str, count: int, usage: str) -> tuple[float, ...]:
    number = r"[-+]?\d+(\.\d+)?"
    if not re.fullmatch(rf"{number}(,{number}){{{count - 1}}}", text):
        raise ValueError(usage)
    return tuple(float(part) for part in text.split(","))


def _product(a: Matrix, b: Matrix) -> Matrix:
    def entry(i: int, j: int) -> float:
        return sum(a[i][k] * b[k][j] for k in range(3))

    first, second, third = ((entry(i, 0), entry(i, 1), entry(i, 2)) for i in range(3))
    return first, second, third
