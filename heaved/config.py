"""TOML -> frozen, validated :class:`Config`. Every fault of a file is found in one go and named with its path."""

from __future__ import annotations

import ipaddress
import tomllib
import types
from collections.abc import Collection, Mapping
from contextlib import suppress
from importlib import resources
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec

from heaved.devices.line import bus_load_faults, line_faults, parse_link
from heaved.devices.profile import DeviceSpec, Profile, profile_faults
from heaved.estimation import correction, heave, quiescence, reference, rock
from heaved.estimation.points import Point

Port = Annotated[int, msgspec.Meta(ge=0, le=65535)]


class StreamParams(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[stream]``: the TCP stream of JSON lines."""

    host: str = "127.0.0.1"
    port: Port = 5570
    max_clients: Annotated[int, msgspec.Meta(ge=1, le=1024)] = 64
    queue_frames: Annotated[int, msgspec.Meta(ge=1, le=65536)] = 256
    stuck_s: Annotated[float, msgspec.Meta(gt=0, le=3600)] = 10.0
    """A client whose queue has been full without progress for this long is disconnected."""
    allow: tuple[str, ...] = ()
    """Networks (CIDR) from which clients may connect, besides loopback."""


class HttpParams(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[http]``: /metrics, /healthz, /readyz."""

    enabled: bool = True
    host: str = "127.0.0.1"
    port: Port = 9570
    allow: tuple[str, ...] = ()


class StateParams(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[state]``: what a restart remembers."""

    directory: str = ""
    """Empty: $STATE_DIRECTORY (systemd), else ~/.local/state/heaved."""
    save_period_s: Annotated[float, msgspec.Meta(ge=1, le=86400)] = 60.0


class CompensationParams(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[compensation]``: what the consumer makes of the heave."""

    lead_s: Annotated[float, msgspec.Meta(ge=0, le=5)] = 0.0
    """Its own reaction time: heave, velocity and points are published for this long ahead."""


class RuntimeParams(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[runtime]``: how the process runs."""

    fifo_priority: Annotated[int, msgspec.Meta(ge=0, le=99)] = 0
    """SCHED_FIFO priority of the event loop; 0: ordinary scheduling."""


class Config(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The whole configuration."""

    device: tuple[DeviceSpec, ...] = ()
    heave: heave.Params = heave.Params()
    laser: reference.Params = reference.Params()
    correction: correction.Params = correction.Params()
    rock: rock.Params = rock.Params()
    quiet: quiescence.Params = quiescence.Params()
    point: tuple[Point, ...] = ()
    compensation: CompensationParams = CompensationParams()
    stream: StreamParams = StreamParams()
    http: HttpParams = HttpParams()
    state: StateParams = StateParams()
    runtime: RuntimeParams = RuntimeParams()


class ConfigError(Exception):
    """A configuration with faults; ``faults`` has one line for each: path and reason."""

    def __init__(self, file: str, faults: list[str]) -> None:
        super().__init__("\n".join(f"{file}: {fault}" for fault in faults))
        self.file = file
        self.faults = faults


def data_directory() -> Path:
    """Directory of the packaged ``heaved.toml``, ``demo.toml`` and ``devices/*.toml``.

    In an installed wheel they lie in the package; in a checkout, beside it.
    """
    packaged = Path(str(resources.files("heaved"))) / "_config"
    return packaged if packaged.is_dir() else Path(__file__).resolve().parent.parent / "config"


def load(path: Path) -> Config:
    """Read and validate a configuration file.

    Raises:
        ConfigError: the file cannot be read or has faults; all of them are listed, each with its path in the file.
    """
    return parse(_read_toml(path), file=str(path), directory=path.parent)


def parse(document: Mapping[str, Any], *, file: str, directory: Path) -> Config:
    """Validate a decoded TOML document; profile files are looked up beside it, then among the packaged ones.

    Raises:
        ConfigError: as :func:`load`.
    """
    faults: list[str] = []
    tree = dict(document)
    devices = tree.get("device")
    single = [key for key, what in (("device", "device"), ("point", "point")) if isinstance(tree.get(key), dict)]
    if single:
        raise ConfigError(file, [f"{key}: is one table; write [[{key}]], once for each {key}" for key in single])
    if isinstance(devices, list):
        tree["device"] = [
            _with_profile(device, f"device[{i}]", directory, faults) if isinstance(device, dict) else device
            for i, device in enumerate(devices)
        ]
    _check(Config, tree, "", faults)
    sound, tables = _sound_parts(tree)
    faults += _cross_checks(tree.get("device"), sound, tables, [fault.partition(":")[0] for fault in faults])
    if faults:
        # Alone, a rate beyond the line is no reason to refuse a file; beside others it shall not wait for its turn.
        faults += _overload_faults(tuple(sound.values()))
        raise ConfigError(file, faults)
    return msgspec.convert(tree, Config)


def packaged_profiles() -> tuple[Profile, ...]:
    """The register profiles that come with the program, by name.

    Raises:
        ConfigError: one of them is broken.
    """
    files = sorted((data_directory() / "devices").glob("*.toml"))
    return tuple(msgspec.convert(_read_toml(file), Profile) for file in files)


def rate_faults(config: Config) -> list[str]:
    """Poll rates that the line cannot carry, one message per bus: a fault of the plan, found before going to sea."""
    return bus_load_faults(config.device)


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be read: {error.strerror or error}"]) from error
    except UnicodeDecodeError as error:
        raise ConfigError(str(path), [f"is not UTF-8 text: {error}"]) from error
    except (ValueError, RecursionError) as error:  # TOMLDecodeError, a number of thousands of digits, endless brackets
        raise ConfigError(str(path), [f"is not valid TOML: {error}"]) from error


def _with_profile(device: dict[str, Any], path: str, directory: Path, faults: list[str]) -> dict[str, Any]:
    """Replace the name of a profile by the profile itself."""
    name = device.get("profile")
    if not isinstance(name, str):
        return device
    file_name = f"{name}.toml"
    candidates = [directory / name, directory / "devices" / file_name, data_directory() / "devices" / file_name]
    found = next((candidate for candidate in candidates if _is_file(candidate)), None)
    if found is None:
        known = ", ".join(sorted(p.stem for p in (data_directory() / "devices").glob("*.toml")))
        faults.append(f"{path}.profile: no profile {_shown(name)}; give a file or one of: {known}")
        return {key: value for key, value in device.items() if key != "profile"} | {"profile": _PLACEHOLDER}
    try:
        return device | {"profile": _read_toml(found)}
    except ConfigError as error:
        faults += [f"{path}.profile: {found}: {fault}" for fault in error.faults]
        return device | {"profile": _PLACEHOLDER}


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # A name too long, a directory that may not be entered.
        return False


_PLACEHOLDER: dict[str, Any] = {
    "name": "?",
    "blocks": [
        {
            "start": 0,
            "fields": [
                {"quantity": "az_mps2", "offset": 0, "unit": "m/s2"},
                {"quantity": "laser_m", "offset": 1, "unit": "m"},
            ],
        }
    ],
}
"""Stands for a profile that could not be read, so that the rest of the device can still be checked."""


def _check(kind: Any, value: Any, path: str, faults: list[str]) -> None:
    """Collect every fault of ``value`` against type ``kind``; msgspec alone would stop at the first."""
    struct, element = _table_of(kind), _element_of(kind)
    if struct is not None and isinstance(value, dict):
        hints = get_type_hints(struct, include_extras=True)
        fields = {field.name: field for field in msgspec.structs.fields(struct)}
        for key in value:
            if key not in fields:
                faults.append(f"{_join(path, key)}: unknown key; known here: {', '.join(fields)}")
        for name, field in fields.items():
            if name in value:
                _check(hints[name], value[name], _join(path, name), faults)
            elif field.required:
                faults.append(f"{_join(path, name)}: missing")
    elif element is not None and isinstance(value, list) and _table_of(element) is not None:
        for i, item in enumerate(value):
            _check(element, item, f"{path}[{i}]", faults)
        if not value:
            _convert(kind, value, path, faults)
    else:
        _convert(kind, value, path, faults)


def _convert(kind: Any, value: Any, path: str, faults: list[str]) -> None:
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        choices = _choices_of(kind)
        reason = f"must be {choices}" if choices and "Invalid enum value" in str(error) else str(error)
        faults.append(f"{path}: {reason} (got {_shown(value)})")
        return
    numbers = value if isinstance(value, list) else [value]
    if any(isinstance(number, float) and not isfinite(number) for number in numbers):
        faults.append(f"{path}: must be finite (got {_shown(value)})")


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:80] + "…"


def _strip(kind: Any) -> Any:
    return _strip(get_args(kind)[0]) if get_origin(kind) is Annotated else kind


def _table_of(kind: Any) -> Any:
    """The struct type behind ``kind`` (also ``Struct | None``), or None."""
    kind = _strip(kind)
    if get_origin(kind) in (Union, types.UnionType):
        structs = [_table_of(option) for option in get_args(kind) if _table_of(option) is not None]
        return structs[0] if len(structs) == 1 else None
    return kind if isinstance(kind, type) and issubclass(kind, msgspec.Struct) else None


def _element_of(kind: Any) -> Any:
    kind = _strip(kind)
    return get_args(kind)[0] if get_origin(kind) is tuple else None


def _choices_of(kind: Any) -> str:
    """``'a', 'b' or 'c'`` for a Literal; empty for any other type."""
    kind = _strip(kind)
    if get_origin(kind) is not Literal:
        return ""
    *others, last = map(repr, get_args(kind))
    return f"{', '.join(others)} or {last}" if others else last


def _join(path: str, key: str) -> str:
    return f"{path}.{key}" if path else key


def _sound_parts(tree: Mapping[str, Any]) -> tuple[dict[int, DeviceSpec], Config]:
    """What is right in itself: whole devices (by index), and tables with defaults in place of wrong keys. Enough to
    check the rest against each other although something else is wrong."""
    devices: dict[int, DeviceSpec] = {}
    listed = tree.get("device")
    for i, device in enumerate(listed if isinstance(listed, list) else ()):
        with suppress(msgspec.ValidationError):
            devices[i] = msgspec.convert(device, DeviceSpec)
    tables: dict[str, Any] = {}
    for field in msgspec.structs.fields(Config):
        if field.name in tree and field.name != "device":
            with suppress(msgspec.ValidationError):
                is_table = _table_of(field.type) is not None
                value = _sound_keys(field.type, tree[field.name]) if is_table else tree[field.name]
                tables[field.name] = msgspec.convert(value, field.type)
    return devices, Config(**tables)


def _sound_keys(kind: Any, table: Any) -> dict[str, Any]:
    """The keys of a table that have no fault of their own, tables within it likewise."""
    sound: dict[str, Any] = {}
    for name, hint in get_type_hints(_table_of(kind), include_extras=True).items():
        if isinstance(table, dict) and name in table:
            value = _sound_keys(hint, table[name]) if _table_of(hint) is not None else table[name]
            faults: list[str] = []
            _check(hint, value, name, faults)
            if not faults:
                sound[name] = value
    return sound


def _cross_checks(
    listed: Any, devices: Mapping[int, DeviceSpec], config: Config, wrong: Collection[str]
) -> list[str]:
    """What no single key can get wrong alone. ``listed``: the devices as written; ``devices`` and ``config``: what is
    sound of the file; ``wrong``: the paths that have a fault already."""
    faults = [fault for i, device in devices.items() for fault in _device_faults(f"device[{i}]", device)]
    for i, device in enumerate(listed if isinstance(listed, list) else ()):
        if i not in devices and isinstance(device, dict) and isinstance(device.get("link"), str):
            faults += _link_faults(f"device[{i}]", device["link"])
    for key in ("name", "role"):
        seen: dict[str, int] = {}
        for i, device in enumerate(listed if isinstance(listed, list) else ()):
            value = device.get(key) if isinstance(device, dict) else None
            if not isinstance(value, str) or f"device[{i}].{key}" in wrong:
                continue
            if value in seen:
                faults.append(f"device[{i}].{key}: {value!r} is already the {key} of device[{seen[value]}]")
            seen.setdefault(value, i)
    names = [point.name for point in config.point]
    faults += [f"point[{i}].name: {name!r} is taken" for i, name in enumerate(names) if name in names[:i]]
    if config.quiet.point and config.quiet.point not in names:
        faults.append(f"quiet.point: no [[point]] is named {config.quiet.point!r}")
    if list(config.heave.sea.windows_s) != sorted(set(config.heave.sea.windows_s)) or not config.heave.sea.windows_s:
        faults.append(f"heave.sea.windows_s: must be lengths that increase (got {list(config.heave.sea.windows_s)})")
    if not any(".link: " in fault for fault in faults):
        overload = _overload_faults(tuple(devices.values()))  # Of the plan, not of the file: see rate_faults.
        faults += [fault for fault in line_faults(tuple(devices.values())) if fault not in overload]
    low, high = config.heave.band_hz
    if isfinite(low) and isfinite(high) and not 0.0 < low < high:
        faults.append(f"heave.band_hz: must be a lower and a higher frequency above 0 (got [{low:g}, {high:g}])")
    for path, horizons in (
        ("heave.forecast_horizons_s", config.heave.forecast_horizons_s),
        ("rock.horizons_s", config.rock.horizons_s),
    ):
        if len({f"{horizon:g}" for horizon in horizons}) < len(horizons):
            faults.append(f"{path}: names a horizon twice")
    for name, table in (("stream", config.stream), ("http", config.http)):
        faults += _listen_faults(name, table.host, table.allow)
    same = config.stream.port == config.http.port != 0 and config.stream.host == config.http.host
    if config.http.enabled and same and not {"stream.port", "http.port"} & set(wrong):
        faults.append(f"http.port: {config.http.port} is also stream.port")
    return faults


def _overload_faults(devices: tuple[DeviceSpec, ...]) -> list[str]:
    """As :func:`rate_faults`; none when a link cannot be parsed, which is a fault of its own."""
    try:
        return bus_load_faults(devices)
    except ValueError:
        return []


def _device_faults(path: str, device: DeviceSpec) -> list[str]:
    faults = _link_faults(path, device.link)
    faults += [f"{path}.profile: {fault}" for fault in profile_faults(device.profile)]
    quantities = {field.quantity for block in device.profile.blocks for field in block.fields}
    needed = {"imu": "az_mps2", "laser": "laser_m"}[device.role]
    if needed not in quantities:
        faults.append(f"{path}.profile: {device.profile.name!r} has no {needed}, which role {device.role!r} needs")
    return faults


def _link_faults(path: str, link: str) -> list[str]:
    try:
        parse_link(link)
    except ValueError as error:
        return [f"{path}.link: {error}"]
    return []


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
