"""From a TOML file to a :class:`heaved.config.Config`, or to every fault of it in one go, each with its path."""

from __future__ import annotations

import re
import tomllib
import unicodedata
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from heaved.config import Config, rules
from heaved.config.typed import check, shown
from heaved.devices.profile import Profile

if TYPE_CHECKING:
    from collections.abc import Mapping


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
    return packaged if packaged.is_dir() else Path(__file__).resolve().parents[2] / "config"


def load(path: Path) -> Config:
    """Read and validate a configuration file.

    Raises:
        ConfigError: the file cannot be read or has faults; all of them are listed, each with its path in the file.
    """
    return parse(_read_toml(path), file=str(path), directory=path.parent)


def load_to_run(path: Path) -> Config:
    """As :func:`load`, and every stage that is switched on has its devices.

    Raises:
        ConfigError: as :func:`load`.
    """
    return parse(_read_toml(path), file=str(path), directory=path.parent, to_run=True)


def parse(document: Mapping[str, Any], *, file: str, directory: Path, to_run: bool = False) -> Config:
    """Validate a decoded TOML document; profile files are looked up beside it, then among the packaged ones.

    ``to_run``: every stage that is switched on must have its devices, too.

    Raises:
        ConfigError: as :func:`load`.
    """
    faults: list[str] = []
    tree = dict(document)
    for key in ("device", "point", "output"):
        if isinstance(tree.get(key), dict):
            faults.append(f"{key}: is one table; write [[{key}]], once for each {key}")
            del tree[key]
    devices = tree.get("device")
    if isinstance(devices, list):
        tree["device"] = [
            _with_profile(device, f"device[{i}]", directory, faults) if isinstance(device, dict) else device
            for i, device in enumerate(devices)
        ]
    check(Config, tree, "", faults)
    written = rules.written(tree, [fault.partition(":")[0] for fault in faults])
    faults += rules.rule_faults(written)
    if to_run:
        faults += rules.run_faults(written)
    if faults:
        # Alone, a rate beyond the line is no reason to refuse a file; beside others it shall not wait for its turn.
        faults += rules.overload_faults(tuple(written.devices.values()))
        raise ConfigError(file, faults)
    return msgspec.convert(tree, Config)


def packaged_profiles() -> tuple[Profile, ...]:
    """The register profiles that come with the program, by name; those of devices that are asked.

    Raises:
        ConfigError: one of them is broken.
    """
    return tuple(profile for profile in _packaged() if profile.blocks)


def packaged_sentences() -> tuple[Profile, ...]:
    """Likewise those of devices that speak by themselves.

    Raises:
        ConfigError: one of them is broken.
    """
    return tuple(profile for profile in _packaged() if profile.sentences)


def _packaged() -> list[Profile]:
    files = sorted((data_directory() / "devices").glob("*.toml"))
    return [msgspec.convert(_read_toml(file), Profile) for file in files]


def _read_toml(path: Path) -> dict[str, Any]:
    text = ""
    try:
        text = path.read_text(encoding="utf-8-sig")  # Some editors put a byte order mark before the text.
        return tomllib.loads(text)
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be read: {error.strerror or error}"]) from error
    except UnicodeDecodeError as error:
        raise ConfigError(str(path), [f"is not UTF-8 text, save it as such: {error}"]) from error
    except (ValueError, RecursionError) as error:  # TOMLDecodeError, a number of thousands of digits, endless brackets
        raise ConfigError(str(path), [f"is not valid TOML: {error}{_odd_character(text, str(error))}"]) from error


def _odd_character(text: str, reason: str) -> str:
    """What stands in the faulty line that looks like something else: a curly quote, a space that does not break."""
    lines = text.split("\n")
    found = re.search(r"at line (\d+)", reason)
    line = lines[int(found[1]) - 1] if found is not None and 0 < int(found[1]) <= len(lines) else ""
    odd = next((char for char in line if not " " <= char <= "~" and char not in "\t\r"), None)
    return f"; the line holds a {unicodedata.name(odd, f'U+{ord(odd):04X}')}: type it anew" if odd else ""


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
        looked = f"; there is no file {directory / name}" if "/" in name or name.endswith(".toml") else ""
        faults.append(f"{path}.profile: no profile {shown(name)}{looked}; give a file or one of: {known}")
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
                {"quantity": "gx_radps", "offset": 2, "unit": "rad/s"},
                {"quantity": "gy_radps", "offset": 3, "unit": "rad/s"},
                {"quantity": "gz_radps", "offset": 4, "unit": "rad/s"},
                {"quantity": "heave_m", "offset": 5, "unit": "m"},
                {"quantity": "pitch_rad", "offset": 6, "unit": "rad"},
            ],
        }
    ],
}
"""Stands for a profile that could not be read, so that the rest of the device can still be checked."""
