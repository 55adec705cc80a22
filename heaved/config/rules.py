"""Faults that no key has alone: keys, tables, devices and stages that do not go together."""

from __future__ import annotations

import importlib.util
import ipaddress
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from math import asin, degrees, hypot, isfinite
from typing import Any, Final, get_args

import msgspec

from heaved.config import Config, services
from heaved.config.outputs import output_cautions, output_faults
from heaved.config.ports import Use, port_faults
from heaved.config.register_rules import register_faults
from heaved.config.typed import sound_keys, table_of
from heaved.devices.bandwidth import bandwidth_hz, folding, remedy
from heaved.devices.link import bus_load_faults, buses, line_faults, most_rate_hz
from heaved.devices.listening import SCHEMES
from heaved.devices.mounting import ANGLES, FORCES, rotation
from heaved.devices.profile import DeviceSpec, Role, profile_faults, role_needs, role_quantities, told_together
from heaved.estimation.craft import fusion
from heaved.estimation.crane.geometry import JOINTS, needed
from heaved.estimation.heave.laser.geometry import Geometry
from heaved.estimation.heave.sea.whittle_fit import TUNING as FIT
from heaved.estimation.hull import estimate as hull
from heaved.links import AnyLink, TcpLink, TcpListenLink, UdpListenLink, parse_any_link, parse_link
from heaved.outputs.register_map import Mode
from heaved.outputs.telegram_output import SCHEMES as OUTPUT_SCHEMES
from heaved.outputs.telegrams.spec import OutputSpec

LEAST_IMU_RATE_HZ: Final = 2.0 * FIT.band_hz[1]
"""Nyquist: of the highest frequency at which the sea is fitted."""
GOOD_IMU_RATE_HZ: Final = 4.0
"""Two and a half times that: a whole octave above the waves, in which noise and vibration are seen for what they are,
as far as they have not folded: see :mod:`heaved.devices.bandwidth`."""
MODBUS: Final = ("tcp", "rtu")
"""Links of devices that are asked."""
_QUANTITY_OF: Final = dict(zip(JOINTS, role_quantities("crane"), strict=True))
"""What shows a joint of the crane."""
ON_END: Final = 0.94
"""Sine of 70 degrees: of an IMU whose x axis stands up."""
STEEP: Final = 0.5
"""Least cosine to the mast of the beam of a laser."""
LONG_TIMEOUT_S: Final = 1.0
"""Twice what a silent device is left alone for."""


class Written(msgspec.Struct, frozen=True, kw_only=True):
    """A file as it is written, and what is right of it in itself: enough to check the rest against each other although
    something else is wrong.
    """

    tree: Mapping[str, Any]
    devices: dict[int, DeviceSpec]
    """The sound ones, by index."""
    outputs: dict[int, OutputSpec]
    """Those of which the telegram is known, by index, with defaults in place of wrong keys."""
    tables: Config
    """The others, with defaults in place of wrong keys; no devices, no outputs."""
    wrong: frozenset[str]
    """Paths that have a fault already."""

    def listed(self, array: str) -> list[Any]:
        """``[[device]]``, ``[[point]]`` or ``[[output]]``, sound or not."""
        return _tables(self.tree, array)


def written(tree: Mapping[str, Any], wrong: Collection[str]) -> Written:
    """``wrong``: paths of the faults found in single keys."""
    tables: dict[str, Any] = {}
    for field in msgspec.structs.fields(Config):
        if field.name in tree and field.name not in ("device", "output"):
            value = tree[field.name]
            with suppress(msgspec.ValidationError):
                sound = value if table_of(field.type) is None else sound_keys(field.type, value)
                tables[field.name] = msgspec.convert(sound, field.type)
    devices: dict[int, DeviceSpec] = {}
    for i, device in enumerate(_tables(tree, "device")):
        with suppress(msgspec.ValidationError):
            devices[i] = msgspec.convert(device, DeviceSpec)
    outputs: dict[int, OutputSpec] = {}
    for i, output in enumerate(_tables(tree, "output")):
        with suppress(msgspec.ValidationError):
            outputs[i] = msgspec.convert({"name": "unnamed", "link": ""} | sound_keys(OutputSpec, output), OutputSpec)
    return Written(tree=tree, devices=devices, outputs=outputs, tables=Config(**tables), wrong=frozenset(wrong))


def _tables(tree: Mapping[str, Any], array: str) -> list[Any]:
    listed = tree.get(array)
    return listed if isinstance(listed, list) else []


def rule_faults(file: Written) -> list[str]:
    """What a file cannot say whatever it is for."""
    devices, config = file.devices, file.tables
    faults = [fault for i, device in devices.items() for fault in _device_faults(f"device[{i}]", device)]
    for i, device in enumerate(file.listed("device")):
        if i not in devices and isinstance(device, dict) and isinstance(device.get("link"), str):
            faults += _link_faults(f"device[{i}]", device["link"], dict.fromkeys((*MODBUS, *SCHEMES)))
    for array, key in (("device", "name"), ("device", "role"), ("point", "name"), ("output", "name")):
        faults += _twice(file, array, key)
    faults += _point_faults(file)
    faults += _heave_faults(config)
    faults += _stage_params_faults(config)
    faults += [fault for fault in port_faults(tuple(_uses(file))) if fault.partition(":")[0] not in file.wrong]
    faults += [fault for fault in services.faults(config) if fault.partition(":")[0] not in file.wrong]
    if not any(".link: " in fault for fault in faults):
        overload = overload_faults(tuple(devices.values()))  # Of the plan, not of the file: see rate_faults.
        faults += [fault for fault in line_faults(tuple(devices.values())) if fault not in overload]
    for name, table in (("stream", config.stream), ("http", config.http)):
        faults += _listen_faults(name, table.host, table.allow, wants_certificates=table.tls)
    faults += _recording_faults(config)
    found = output_faults(
        file.listed("output"),
        file.outputs,
        imu_hz=next((device.rate_hz for device in devices.values() if device.role == "imu"), None),
        points=_points(file),
    )
    faults += [fault for fault in found if fault.partition(":")[0] not in file.wrong]
    points = [point.get("name", "") for point in file.listed("point") if isinstance(point, dict)]
    return faults + register_faults(config, points, file.wrong)


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
        for fault in (
            *_stage_faults(file.tables, carried, is_complete=is_complete),
            *services.run_faults(file.tables),
        )
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
        found += _mounting_cautions(path, device)
        if device.role == "crane" and not config.crane.is_there:
            found.append(f"{path}.role: its readings go nowhere: [crane] does not say how the crane is built")
        if device.role == "reference_mru" and not any(other.role == "imu" for other in config.device):
            found.append(f'{path}.role: there is nothing to compare it with: no device of role "imu" is configured')
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
    if config.correction.enabled and config.has_laser and importlib.util.find_spec("torch") is None:
        found.append(
            "correction.enabled: torch is not installed, so no correction is trained: pip install torch (of the Debian "
            "package: heaved-torch), or set it to false"
        )
    measured = next((_quantities(device) for device in config.device if device.role == "imu"), set())
    has_attitude = {"roll_rad", "pitch_rad"} <= measured
    if config.has_laser:
        found += _laser_cautions(config, has_attitude=has_attitude)
    found += output_cautions(config.output, config.compensation.lead_s, has_attitude=has_attitude)
    return found + services.cautions(config)


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
    faults += _crane_faults(config, carried, is_complete=is_complete)
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


def _crane_faults(config: Config, carried: Mapping[str, Collection[str]], *, is_complete: bool) -> list[str]:
    """Points on a moving crane that nobody says how it stands."""
    faults = []
    for i, point in enumerate(config.point):
        if not point.rides or not config.crane.is_there:
            continue
        where = f"point[{i}].frame: {point.frame!r}"
        if "crane" not in carried:
            if is_complete:
                faults.append(f'{where} needs the readings of a device of role "crane"')
            continue
        quantities = [_QUANTITY_OF[JOINTS[j]] for j in needed(config.crane, hook=point.frame == "hook")]
        if lacking := [quantity for quantity in quantities if quantity not in carried["crane"]]:
            fixed = ", ".join(
                f"crane.{quantity.removesuffix('_rad')}_fixed_deg" for quantity in lacking if quantity.endswith("_rad")
            )
            hint = f"; if that joint is fixed, set {fixed}" if fixed else ""
            faults.append(f'{where}: the profile of the device of role "crane" has no {", ".join(lacking)}{hint}')
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
        if file.tables.crane.frame == "crane":
            faults.append('crane.frame: "crane" needs [hull] enabled')
    crane = file.tables.crane
    if not crane.is_there and not any(path.startswith("crane") for path in file.wrong):
        faults += [
            f"point[{i}].frame: {p['frame']!r} needs [crane]: its boom_length_m is not given"
            for i, p in points.items()
            if p.get("frame") in ("boom", "hook")
        ]
    faults += [
        f"point[{i}].{key}: the hook hangs plumb and turns as it likes: only up_m changes its height"
        for i, p in points.items()
        for key in ("forward_m", "port_m")
        if p.get("frame") == "hook" and p.get(key)
    ]
    wanted = file.tables.quiet.point
    if wanted and wanted not in [point.get("name") for point in points.values()]:
        faults.append(f"quiet.point: no [[point]] is named {wanted!r}")
    wanted = file.tables.reference_mru.point
    if wanted and wanted not in [point.get("name") for point in points.values()]:
        faults.append(f"reference_mru.point: no [[point]] is named {wanted!r}")
    return faults


def _points(file: Written) -> Collection[object] | None:
    """Names of the points, as they are written; None: that cannot be said."""
    if "point" in file.wrong:
        return None
    return [point.get("name") for point in file.listed("point") if isinstance(point, dict)]


def _uses(file: Written) -> Iterator[Use]:
    """Who wants which port, as far as that is sound."""
    config = file.tables
    for name, server in (("stream", config.stream), ("http", config.http)):
        is_on = name == "stream" or config.http.enabled
        if is_on and not {f"{name}.port", f"{name}.host"} & file.wrong:
            yield Use(f"{name}.port", TcpListenLink(server.host, server.port))
    for i, device in file.devices.items():
        if (link := _parsed(device.link, MODBUS if device.is_asked else SCHEMES)) is not None:
            yield Use(f"device[{i}].link", link, is_master=device.is_asked)
    registers, mode = config.registers, config.registers.mode
    if registers.enabled and (link := _parsed(registers.link, MODBUS)) is not None:
        if mode is Mode.SERVE and isinstance(link, TcpLink):
            link = TcpListenLink(link.host, link.port)
        yield Use("registers.link", link, is_master=isinstance(link, TcpLink))
    for i, output in enumerate(file.listed("output")):
        link = _parsed(output.get("link"), OUTPUT_SCHEMES) if isinstance(output, dict) else None
        if link is not None:
            yield Use(f"output[{i}].link", link)


def _parsed(text: object, schemes: Sequence[str]) -> AnyLink | None:
    with suppress(ValueError):
        return parse_any_link(text, schemes) if isinstance(text, str) else None
    return None


def _laser_cautions(config: Config, *, has_attitude: bool) -> list[str]:
    """Of where the laser is."""
    laser, found = config.laser, []
    if max(abs(laser.forward_m), abs(laser.port_m)) > 0.0 and not has_attitude:
        found.append(
            "laser.forward_m, laser.port_m: no imu measures roll and pitch, so that nothing of the heave is known from "
            "where the laser is: it is of no use"
        )
    if laser.sign * laser.beam[2] > 0.0 and laser.geometry != Geometry(sign=laser.sign):
        looks = "looks down" if laser.beam[2] < 0.0 else "looks up"
        turned = "[0, 0, 1]" if laser.beam[2] < 0.0 else "[0, 0, -1]"
        found.append(
            f"laser.sign: {laser.sign} with a beam that {looks} is a laser that stands on something fixed and looks at "
            f"the ship; for one on board that looks the other way write beam = {turned}"
        )
    return found


def _heave_faults(config: Config) -> list[str]:
    """Of the observers, their horizons and their laser."""
    faults = []
    if config.laser.role == "aiding" and config.heave.observer != "sea":
        faults.append("laser.role: 'aiding' needs heave.observer = 'sea'; the harmonic observer can only be compared")
    x, y, z = config.laser.beam
    if not abs(z) > STEEP * hypot(x, y, z):
        faults.append(
            f"laser.beam: must point down or up, by no more than 60 degrees from it (got [{x:g}, {y:g}, {z:g}])"
        )
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


def _device_faults(path: str, device: DeviceSpec) -> list[str]:
    faults = _link_faults(path, device.link, MODBUS if device.is_asked else SCHEMES)
    if not faults:
        faults += _allow_faults(path, device)
    if device.latency_ms > device.timeout_ms:
        faults.append(
            f"{path}.latency_ms: {device.latency_ms:g} is beyond timeout_ms ({device.timeout_ms:g}): no device "
            "measures after it has answered; one that answers with an older reading has a negative latency_ms"
        )
    faults += [f"{path}.profile: {fault}" for fault in profile_faults(device.profile)]
    carried = _quantities(device)
    faults += _mounting_faults(path, device, carried)
    lacking = [name for name in role_needs(device.role) if name not in carried]
    if lacking:
        lacks = " and no ".join(lacking)
        faults.append(f"{path}.profile: {device.profile.name!r} has no {lacks}, which role {device.role!r} needs")
    elif carried.isdisjoint(useful := role_quantities(device.role)):
        names = ", ".join(useful)
        faults.append(f"{path}.profile: {device.profile.name!r} has none of {names}: of no use in role {device.role!r}")
    return faults


def _mounting_faults(path: str, device: DeviceSpec, carried: Collection[str]) -> list[str]:
    """A mounting of what has no axes, or not all that are to be turned."""
    faults = []
    is_imu = device.role in ("imu", "imu2")
    for key, is_set in (
        ("rotation_deg", any(device.rotation_deg)),
        ("bias_mps2", any(device.bias_mps2)),
        ("attitude_latency_ms", device.attitude_latency_ms != 0.0),
    ):
        if is_set and not (is_imu and (key == "rotation_deg" or device.role == "imu")):
            faults.append(f"{path}.{key}: is for an IMU; a device in role {device.role!r} has nothing to apply it to")
    if device.role == "imu" and (device.rotation_deg[0] % 360.0 or device.rotation_deg[1] % 360.0):
        lacking = [name for name in FORCES if name not in carried]
        if lacking:
            faults.append(
                f"{path}.rotation_deg: the vertical acceleration of a tilted sensor takes all three, and profile "
                f"{device.profile.name!r} has no {' and no '.join(lacking)}"
            )
    return faults


def _mounting_cautions(path: str, device: DeviceSpec) -> list[str]:
    """What a mounting costs."""
    found = []
    _, y, z = device.rotation_deg
    if device.role == "imu" and (y % 180.0 or z % 180.0):
        told = [_quantities(device)] if device.is_asked else [set(names) for names in told_together(device.profile)]
        pair = set(ANGLES[:2])
        if any(pair & names for names in told) and not any(pair <= names for names in told):
            found.append(
                f"{path}.rotation_deg: to be turned, roll and pitch take each other, and the profile has not both in "
                "one answer: there will be no attitude; map the axes in the profile instead"
            )
    steep = abs(rotation(*device.rotation_deg)[2][0])
    if device.role == "imu" and steep > ON_END:
        found.append(
            f"{path}.rotation_deg: its x axis stands {degrees(asin(min(steep, 1.0))):.0f} degrees up or down: roll and "
            "yaw of the sensor turn about the same axis there, so the vessel's heading is only as good as they are of "
            "one moment; roll and pitch are not affected. Better: map its axes in the profile, or in the sensor"
        )
    return found


def _quantities(device: DeviceSpec) -> set[str]:
    return {name for names in told_together(device.profile) for name in names}


def _allow_faults(path: str, device: DeviceSpec) -> list[str]:
    """Of who may send the sentences of a device that speaks by itself."""
    link = parse_any_link(device.link, (*MODBUS, *SCHEMES))
    if isinstance(link, UdpListenLink):
        return _listen_faults(path, link.host, device.allow, key="link")
    return [f"{path}.allow: is for a udp-listen link alone; nobody else can reach this one"] if device.allow else []


def _link_faults(path: str, link: str, schemes: Collection[str]) -> list[str]:
    try:
        parse_any_link(link, tuple(schemes))
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


def _listen_faults(
    table: str, host: str, allow: tuple[str, ...], key: str = "host", *, wants_certificates: bool | None = None
) -> list[str]:
    """``wants_certificates``: None where TLS is not spoken."""
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
            return [*faults, f"{table}.{key}: {host!r} is no IP address; give the address to listen on, e.g. 127.0.0.1"]
    if not loopback and not allow and not wants_certificates:
        tls = "" if wants_certificates is None else f", or want certificates of them: {table}.tls = true, with [tls]"
        faults.append(f"{table}.{key}: {host} listens beyond this machine; name who may connect in {table}.allow{tls}")
    return faults
