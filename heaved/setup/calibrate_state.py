"""What a calibration has found so far, kept beside the configuration until it is written, so that it can be resumed.

Its format is MessagePack, which knows infinity, the standard error of what is not known.
"""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING, Any, Final

import msgspec

from heaved.estimation.heave.laser.geometry import GeometryFit
from heaved.setup.calibrate_latency import Latency
from heaved.setup.calibrate_rest import Rest
from heaved.setup.calibrate_signs import Verdict
from heaved.setup.calibrate_turn import Tilted, Turned

if TYPE_CHECKING:
    from pathlib import Path

    from heaved.devices.mounting import Vector
    from heaved.devices.profile import DeviceSpec
    from heaved.estimation.heave.laser.reference import Params as LaserParams

VERSION: Final = 1


class Found(msgspec.Struct, frozen=True, kw_only=True):
    """What is known after some steps; None: that step is still to come, or was skipped."""

    version: int = VERSION
    device: str = ""
    """Name of the IMU,"""
    fingerprint: str = ""
    """and how it is read: with another profile nothing of this holds."""
    list_deg: tuple[float, float] = (0.0, 0.0)
    """Roll and pitch of the vessel at rest."""
    rest: Rest | None = None
    signs: tuple[Verdict, ...] = ()
    tilted: Tilted | None = None
    tilt: Rest | None = None
    turned: Turned | None = None
    latency: Latency | None = None
    laser: GeometryFit | None = None
    laser_by_rates: bool = True
    """Whether the angles that it was found with came from gyroscopes."""
    skipped: tuple[str, ...] = ()


class StateError(Exception):
    """What was kept cannot be gone on with; the message says why."""


def state_path(config: Path) -> Path:
    """Where it is kept."""
    return config.with_name(config.name + ".calibration")


def fingerprint(device: DeviceSpec) -> str:
    """How a device is read."""
    return msgspec.json.encode((device.name, device.profile)).decode()


def load(path: Path, device: DeviceSpec) -> Found | None:
    """What was kept of that device; None: nothing.

    Raises:
        StateError: it cannot be used.
    """
    try:
        found = msgspec.msgpack.decode(path.read_bytes(), type=Found)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise StateError(f"{path}: cannot be read: {error.strerror or error}") from error
    except msgspec.MsgspecError as error:
        raise StateError(f"{path}: is no progress of a calibration ({error})") from error
    if found.version != VERSION:
        raise StateError(f"{path}: is of another version of heaved")
    if found.fingerprint != fingerprint(device):
        raise StateError(f"{path}: is of device {found.device} as it was read then: name or profile have changed since")
    return found


def save(path: Path, found: Found) -> None:
    """Keep it, whole or not at all.

    Raises:
        StateError: it cannot be written.
    """
    beside = path.with_name(path.name + ".new")
    try:
        with beside.open("wb") as file:
            file.write(msgspec.msgpack.encode(found))
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    except OSError as error:
        raise StateError(f"{path}: progress cannot be kept: {error.strerror or error}") from error


def age(path: Path, now_s: float | None = None) -> str:
    """How long ago it was kept, in words."""
    seconds = (time.time() if now_s is None else now_s) - path.stat().st_mtime
    for unit, size in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.0f} {unit} ago"
    return "a moment ago"


def forget(path: Path) -> None:
    """It has been written, or is begun anew."""
    path.unlink(missing_ok=True)


# ---- what it means for the configuration -----------------------------------------------------------------------------

SIGNIFICANT: Final = 2.0
"""Standard errors from which something is there."""
LATENCY_STD_S: Final = 0.010
"""A latency that is not known to this is not written."""
PLACE_STD_M: Final = 1.0
"""Nor is a place of the laser."""


def device_keys(found: Found, device: DeviceSpec, bias_limit_mps2: float) -> dict[str, Any]:
    """The keys of the IMU as they shall be; those that nothing is known of are left out."""
    keys: dict[str, Any] = {}
    if (rotation := mounting_deg(found)) is not None:
        keys["rotation_deg"] = [_rounded(angle, 2) for angle in rotation]
    if found.rest is not None and max(abs(part) for part in found.rest.bias_mps2) <= bias_limit_mps2:
        keys["bias_mps2"] = [_rounded(part, 3) for part in found.rest.bias_mps2]
    if (latency := found.latency) is not None and latency.late_std_s <= LATENCY_STD_S:
        is_there = abs(latency.late_s) > SIGNIFICANT * latency.late_std_s
        keys["attitude_latency_ms"] = _rounded(latency.late_s * 1e3, 1) if is_there else 0.0
    return {name: value for name, value in keys.items() if not _is_same(value, getattr(device, name))}


def laser_keys(found: Found, params: LaserParams) -> dict[str, Any]:
    """Likewise the keys of ``[laser]``."""
    if (fit := found.laser) is None:
        return {}
    geometry = fit.geometry
    keys: dict[str, Any] = {"sign": geometry.sign}
    if max(fit.foot_forward_std_m, fit.foot_port_std_m) <= PLACE_STD_M:
        keys["forward_m"] = _rounded(geometry.forward_m, 2)
        keys["port_m"] = _rounded(geometry.port_m, 2)
        if fit.is_up_found:
            keys["up_m"] = _rounded(geometry.up_m, 2)
        if fit.is_lean_found or geometry.beam[2] * params.beam[2] < 0.0:
            keys["beam"] = [_rounded(part, 4) for part in geometry.beam]
    return {name: value for name, value in keys.items() if not _is_same(value, getattr(params, name))}


def mounting_deg(found: Found) -> Vector | None:
    """How the sensor is mounted, as far as is known; None: it is not."""
    return None if found.turned is None else found.turned.rotation_deg


def _rounded(value: float, digits: int) -> float:
    return round(value, digits) + 0.0  # No minus zero.


def _is_same(value: Any, old: Any) -> bool:
    return bool((tuple(value) if isinstance(value, list) else value) == (tuple(old) if isinstance(old, list) else old))
