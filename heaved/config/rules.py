"""Faults that no key has alone: keys, tables, devices and stages that do not go together."""

from __future__ import annotations

import importlib.util
import ipaddress
import os
from collections.abc import Collection, Mapping
from contextlib import suppress
from math import isfinite
from typing import Any, Final, get_args

import msgspec

from heaved.config import Config
from heaved.config.typed import sound_keys, table_of
from heaved.devices.bandwidth import bandwidth_hz, folding, remedy
from heaved.devices.link import bus_load_faults, buses, line_faults, most_rate_hz
from heaved.devices.profile import DeviceSpec, Role, profile_faults, role_needs, role_quantities
from heaved.estimation.craft import fusion
from heaved.estimation.heave.sea.whittle_fit import TUNING as FIT
from heaved.estimation.hull import estimate as hull
from heaved.links import SerialLink, parse_link

LEAST_IMU_RATE_HZ: Final = 2.0 * FIT.band_hz[1]
"""Nyquist: of the highest frequency at which the sea is fitted."""
GOOD_IMU_RATE_HZ: Final = 4.0
"""Two and a half times that: a whole octave above the waves, in which noise and vibration are seen for what they are,
as far as they have not folded: see :mod:`heaved.devices.bandwidth`."""
LONG_TIMEOUT_S: Final = 1.0
"""Twice what a silent device is left alone for."""


class Written(msgspec.Struct, frozen=True, kw_only=True):
    """A file as it is written, and what is right of it in itself: enough to check the rest against each other although
    something else is wrong.
    """

    tree: Mapping[str, Any]
    devices: dict[int, DeviceSpec]
    """The sound ones, by index."""
    tables: Config
    """The others, with defaults in place of wrong keys; no devices."""
    wrong: frozenset[str]
    """Paths that have a fault already."""

    def listed(self, array: str) -> list[Any]:
        """``[[device]]`` or ``[[point]]``, sound or not."""
        found = self.tree.get(array)
        return found if isinstance(found, list) else []


def written(tree: Mapping[str, Any], wrong: Collection[str]) -> Written:
    """``wrong``: paths of the faults found in single keys."""
    devices: dict[int, DeviceSpec] = {}
    listed = tree.get("device")
    for i, device in enumerate(listed if isinstance(listed, list) else ()):
        with suppress(msgspec.ValidationError):
            devices[i] = msgspec.convert(device, DeviceSpec)
    tables: dict[str, Any] = {}
    for field in msgspec.structs.fields(Config):
        if field.name in tree and field.name != "device":
            value = tree[field.name]
            with suppress(msgspec.ValidationError):
                sound = value if table_of(field.type) is None else sound_keys(field.type, value)
                tables[field.name] = msgspec.convert(sound, field.type)
    return Written(tree=tree, devices=devices, tables=Config(**tables), wrong=frozenset(wrong))


def rule_faults(file: Written) -> list[str]:
    """What a file cannot say whatever it is for."""
    devices, config = file.devices, file.tables
    faults = [fault for i, device in devices.items() for fault in _device_faults(f"device[{i}]", device)]
    for i, device in enumerate(file.listed("device")):
        if i not in devices and isinstance(device, dict) and isinstance(device.get("link"), str):
            faults += _link_faults(f"device[{i}]", device["link"])
    for array, key in (("device", "name"), ("device", "role"), ("point", "name")):
        faults += _twice(file, array, key)
    faults += _point_faults(file)
    faults += _heave_faults(config)
    faults += _stage_params_faults(config)
    faults += _port_faults(devices)
    if not any(".link: " in fault for fault in faults):
        overload = overload_faults(tuple(devices.values()))  # Of the plan, not of the file: see rate_faults.
        faults += [fault for fault in line_faults(tuple(devices.values())) if fault not in overload]
    for name, table in (("stream", config.stream), ("http", config.http)):
        faults += _listen_faults(name, table.host, table.allow)
    faults += _recording_faults(config)
    same = config.stream.port == config.http.port != 0 and config.stream.host == config.http.host
    if config.http.enabled and same and not {"stream.port", "http.port"} & file.wrong:
        faults.append(f"http.port: {config.http.port} is also stream.port")
    return faults


def run_faults(file: Written) -> list[str]:
    """What a file must not lack to be run: see :func:`stage_faults`. A device that is not sound counts for what it is
    meant to be, so that nothing is missed which is only wrong.
    """
    carried: dict[str, Collection[str]] = {device.role: _quantities(device) for device in file.devices.values()}
    is_complete = "device" not in file.wrong
    for i, device in enumerate(file.listed("device")):
        if i in file.devices:
            continue
        meant = device.get("role") if isinstance(device, dict) else None
        role: Role | None = next((role for role in get_args(Role) if role == meant), None)
        if role is not None:
            carried.setdefault(role, role_quantities(role))
        else:
            is_complete = False  # It may be the one that is looked for.
    slow = [
        f"device[{i}].rate_hz: {device.rate_hz:g} is too slow for waves: the sea is fitted up to "
        f"{FIT.band_hz[1]:g} Hz, which takes {LEAST_IMU_RATE_HZ:g} Hz at least; "
        "10 or more is good, 100 for a compensator"
        for i, device in file.devices.items()
        if device.role == "imu" and device.rate_hz < LEAST_IMU_RATE_HZ
    ]
    return slow + [
        fault
        for fault in _stage_faults(file.tables, carried, is_complete=is_complete)
        if fault.partition(":")[0] not in file.wrong
    ]


def cautions(config: Config) -> list[str]:
    """What is no fault but costs something that whoever wrote the file may not know."""
    found = []
    for i, device in enumerate(config.device):
        path, period_ms = f"device[{i}]", 1e3 / device.rate_hz
        bandwidth = bandwidth_hz(device)
        if device.role == "imu" and device.rate_hz < GOOD_IMU_RATE_HZ:
            folds = "" if bandwidth else ", and vibration of hull and engines folds into the waves"
            found.append(
                f"{path}.rate_hz: {device.rate_hz:g} Hz sees no wave shorter than {2.0 / device.rate_hz:.2g} s{folds}: "
                f"the heave errs more; set {GOOD_IMU_RATE_HZ:g} or more, 100 for a compensator"
            )
        if device.role in ("imu", "imu2") and (told := folding(device.rate_hz, bandwidth)):
            most_hz = most_rate_hz(parse_link(device.link), device.profile)
            advice = remedy(device.rate_hz, bandwidth, device.profile.bandwidth_register, most_hz)
            found.append(f"{path}.rate_hz: {told}; {advice}")
        if device.timeout_ms > 1e3 * LONG_TIMEOUT_S:
            found.append(
                f"{path}.timeout_ms: {device.timeout_ms:g} ms of waiting for each lost answer, and nothing else is "
                "asked on the line meanwhile: set it little above the device's slowest answer"
            )
        if 0.0 < device.stuck_after_s * 1e3 < period_ms:
            found.append(
                f"{path}.stuck_after_s: {device.stuck_after_s:g} s is less than the period ({period_ms:.3g} ms): two "
                "equal readings would be a fault; raise it"
            )
    for members in buses(config.device).values():
        for device in members:
            hurried = [other for other in members if other is not device and 1e3 / other.rate_hz < device.timeout_ms]
            if hurried:
                names = ", ".join(f"{other.name} ({1e3 / other.rate_hz:.3g} ms)" for other in hurried)
                found.append(
                    f"device {device.name}: timeout_ms {device.timeout_ms:g} is longer than the period of {names} on "
                    "the same line: each answer that it loses costs them polls; lower it, or give each its own line"
                )
    return found


def rate_faults(config: Config) -> list[str]:
    """Poll rates that the line cannot carry, one message per bus: a fault of the plan, found before going to sea."""
    return bus_load_faults(config.device)


def stage_faults(config: Config) -> list[str]:
    """Stages that are switched on without the devices that they live on. A replay needs no device: its file has all."""
    return _stage_faults(config, {device.role: _quantities(device) for device in config.device}, is_complete=True)


def _stage_faults(config: Config, carried: Mapping[str, Collection[str]], *, is_complete: bool) -> list[str]:
    """``carried``: quantities by role. Unless it is complete, no role in it is said to be absent."""
    faults = []
    if config.hull.enabled:
        rates = set(role_needs("imu2"))
        if "imu2" not in carried and is_complete:
            faults.append('hull.enabled: needs a second IMU, a device of role "imu2"')
        if "imu" not in carried and is_complete:
            faults.append('hull.enabled: needs the body rates of a device of role "imu"')
        elif lacking := rates.difference(carried.get("imu", rates)):
            faults.append(f'hull.enabled: the profile of the device of role "imu" has no {", ".join(sorted(lacking))}')
    if config.attitude.enabled and config.attitude.source == fusion.Source.SENSORS and is_complete:
        sensors: set[str] = set().union(*(carried.get(role, ()) for role in ("craft", "heave_sensor", "pitch_sensor")))
        if sensors.isdisjoint(("heave_m", "pitch_rad")):
            faults.append(
                'attitude.source: "sensors" needs heave_m or pitch_rad from a device of role "craft", "heave_sensor" '
                'or "pitch_sensor"; "own" takes the heave and pitch of heaved itself'
            )
    if config.attitude.enabled and config.attitude.source == fusion.Source.OWN and "imu" not in carried and is_complete:
        faults.append('attitude.source: "own" needs a device of role "imu"')
    return faults


def _twice(file: Written, array: str, key: str) -> list[str]:
    """Tables of ``array`` that have the ``key`` of an earlier one."""
    faults = []
    seen: dict[str, int] = {}
    for i, table in enumerate(file.listed(array)):
        value = table.get(key) if isinstance(table, dict) else None
        if not isinstance(value, str) or f"{array}[{i}].{key}" in file.wrong:
            continue
        if value in seen:
            faults.append(f"{array}[{i}].{key}: {value!r} is already the {key} of {array}[{seen[value]}]")
        seen.setdefault(value, i)
    return faults


def _point_faults(file: Written) -> list[str]:
    """Points that need a stage, and a stage that needs a point. Each point counts as it is written."""
    if "point" in file.wrong:
        return []
    points = {i: point for i, point in enumerate(file.listed("point")) if isinstance(point, dict)}
    faults = []
    if not file.tables.hull.enabled and "hull.enabled" not in file.wrong:
        faults += [
            f'point[{i}].frame: "crane" needs [hull] enabled' for i, p in points.items() if p.get("frame") == "crane"
        ]
    wanted = file.tables.quiet.point
    if wanted and wanted not in [point.get("name") for point in points.values()]:
        faults.append(f"quiet.point: no [[point]] is named {wanted!r}")
    return faults


def _heave_faults(config: Config) -> list[str]:
    """Of the observers, their horizons and their laser."""
    faults = []
    if config.laser.role == "aiding" and config.heave.observer != "sea":
        faults.append("laser.role: 'aiding' needs heave.observer = 'sea'; the harmonic observer can only be compared")
    windows_s = list(config.heave.sea.windows_s)
    if windows_s != sorted(set(windows_s)) or not windows_s:
        faults.append(f"heave.sea.windows_s: must be lengths that increase (got {windows_s})")
    low, high = config.heave.band_hz
    if isfinite(low) and isfinite(high) and not 0.0 < low < high:
        faults.append(f"heave.band_hz: must be a lower and a higher frequency above 0 (got [{low:g}, {high:g}])")
    for path, horizons in (
        ("heave.forecast_horizons_s", config.heave.forecast_horizons_s),
        ("rock.horizons_s", config.rock.horizons_s),
    ):
        if len({f"{horizon:g}" for horizon in horizons}) < len(horizons):
            faults.append(f"{path}: names a horizon twice")
    return faults


def _stage_params_faults(config: Config) -> list[str]:
    """Parameters of the stages that do not go together."""
    faults = []
    if config.hull.start == hull.Start.ZERO and config.hull.method == hull.Method.SO3:
        faults.append('hull.start: "zero" is for the methods ckf and ukf; so3 needs an alignment')
    if config.attitude.enabled:
        try:
            fusion.AttitudeFusion(config.attitude)
        except ArithmeticError as error:
            faults.append(f"attitude.vessel: {error}")
    return faults


def overload_faults(devices: tuple[DeviceSpec, ...]) -> list[str]:
    """As :func:`rate_faults`; none when a link cannot be parsed, which is a fault of its own."""
    try:
        return bus_load_faults(devices)
    except ValueError:
        return []


def _port_faults(devices: Mapping[int, DeviceSpec]) -> list[str]:
    """Serial ports that go by two names, such as /dev/ttyUSB0 and its link under /dev/serial/by-id: the second could
    not be opened beside the first.
    """
    faults = []
    first: dict[str, tuple[int, str]] = {}
    for i, device in devices.items():
        with suppress(ValueError):
            link = parse_link(device.link)
            if isinstance(link, SerialLink):
                other, name = first.setdefault(os.path.realpath(link.path), (i, link.path))
                if name != link.path:
                    faults.append(
                        f"device[{i}].link: {link.path} is the same port as {name} of device[{other}]: give both the "
                        "same link; they share the line"
                    )
    return faults


def _device_faults(path: str, device: DeviceSpec) -> list[str]:
    faults = _link_faults(path, device.link)
    if device.latency_ms > device.timeout_ms:
        faults.append(
            f"{path}.latency_ms: {device.latency_ms:g} is beyond timeout_ms ({device.timeout_ms:g}): no device "
            "measures after it has answered; one that answers with an older reading has a negative latency_ms"
        )
    faults += [f"{path}.profile: {fault}" for fault in profile_faults(device.profile)]
    carried = _quantities(device)
    lacking = [name for name in role_needs(device.role) if name not in carried]
    if lacking:
        lacks = " and no ".join(lacking)
        faults.append(f"{path}.profile: {device.profile.name!r} has no {lacks}, which role {device.role!r} needs")
    elif carried.isdisjoint(useful := role_quantities(device.role)):
        names = ", ".join(useful)
        faults.append(f"{path}.profile: {device.profile.name!r} has none of {names}: of no use in role {device.role!r}")
    return faults


def _quantities(device: DeviceSpec) -> set[str]:
    return {field.quantity for block in device.profile.blocks for field in block.fields}


def _link_faults(path: str, link: str) -> list[str]:
    try:
        parse_link(link)
    except ValueError as error:
        return [f"{path}.link: {error}"]
    return []


def _recording_faults(config: Config) -> list[str]:
    directory, faults = config.recording.directory, []
    if directory and not directory.startswith(("/", "~")):
        faults.append(f"recording.directory: {directory!r} must be an absolute path: the daemon runs anywhere")
    if config.recording.enabled and importlib.util.find_spec("pyarrow") is None:
        faults.append("recording.enabled: needs pyarrow, which is not installed: pip install 'heaved[recording]'")
    return faults


def _listen_faults(table: str, host: str, allow: tuple[str, ...]) -> list[str]:
    faults = []
    for i, network in enumerate(allow):
        try:
            ipaddress.ip_network(network)
        except ValueError as error:
            faults.append(f"{table}.allow[{i}]: {error}")
    try:
        loopback = ipaddress.ip_address(host).is_loopback
    except ValueError:
        loopback = host == "localhost"
        if not loopback:
            return [*faults, f"{table}.host: {host!r} is no IP address; give the address to listen on, e.g. 127.0.0.1"]
    if not loopback and not allow:
        faults.append(f"{table}.host: {host} listens beyond this machine; name who may connect in {table}.allow")
    return faults
