"""``heaved install-service``: the unit, its drop-in, names of the adapters and the configuration, put where systemd and
udev look for them; and taken away again.

What is made carries a mark in its first line. A file without it is somebody else's and is left alone, and so is a
configuration that is there already: it decides then what the drop-in allows and which adapters get names.
"""

from __future__ import annotations

import os
import re
import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.config.read import data_directory, load
from heaved.setup.udev import GROUP, kept_rules, rules
from heaved.setup.unit import UNIT_PROGRAM, needs, serial_ports, unit_text

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from heaved.config import Config
    from heaved.setup.adapters import Adapter

    Run = Callable[[Sequence[str]], None]
    """Runs a command of the machine."""

CONFIG: Final = Path("/etc/heaved/heaved.toml")
UNIT: Final = Path("/etc/systemd/system/heaved.service")
DROP_IN: Final = Path("/etc/systemd/system/heaved.service.d/configuration.conf")
RULES: Final = Path("/etc/udev/rules.d/70-heaved.rules")
PACKAGED_UNITS: Final = (Path("/usr/lib/systemd/system/heaved.service"), Path("/lib/systemd/system/heaved.service"))
STATE: Final = Path("/var/lib/heaved")
MARK: Final = "# Made by heaved install-service, and made anew by it: what you change here is lost."
HIDDEN: Final = ("/home", "/root", "/run/user", "/tmp", "/var/tmp")  # noqa: S108  # Where the unit sees nothing.
UNSTABLE: Final = re.compile(r"/dev/tty(USB|ACM)\d+")


class ServiceError(Exception):
    """It cannot be installed, and the reason."""


class File(msgspec.Struct, frozen=True, kw_only=True):
    """One file to be made."""

    path: Path
    text: str
    said: str
    """What it is."""


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """What is to be done, and what to say of it."""

    files: tuple[File, ...]
    notes: tuple[str, ...]
    """What is allowed, what was left alone, what people should know."""
    next_steps: tuple[str, ...]


def below(root: Path, path: Path) -> Path:
    """Where an absolute path is in a system whose root is ``root``."""
    return root / path.relative_to("/")


def plan(*, source: Path | None, root: Path, program: Path, plugged: Sequence[Adapter]) -> Plan:
    """What an installation takes.

    source: configuration to install; None: the one that is installed, else the one that comes with the program.

    Raises:
        ConfigError: the configuration has faults.
        ServiceError: a profile that it names cannot be handed over.
    """
    notes = [*program_faults(program), *group_faults(root)]
    installed = below(root, CONFIG)
    chosen = source or (installed if installed.is_file() else data_directory() / "heaved.toml")
    names = _new_names(load(chosen), plugged)
    text = renamed(chosen.read_text(encoding="utf-8-sig"), names)
    files: list[File] = []
    if not installed.is_file():
        files.append(File(path=CONFIG, text=text, said=f"the configuration, from {chosen}"))
        files += _profiles(chosen)
        notes += [f"{CONFIG}: {old} is written as {new} there, a name that stays" for old, new in names.items()]
    elif installed.read_text(encoding="utf-8-sig") != text:
        if source is not None and not source.samefile(installed):
            notes.append(f"{CONFIG}: is there already and differs from {source}: left as it is. To take yours, copy it")
        in_force = serial_ports(load(installed))
        notes += [
            f"{CONFIG}: write {new} in place of {old}: that name stays" for old, new in names.items() if old in in_force
        ]
    config = load(installed if installed.is_file() else chosen)
    files += _unit(root, program, notes)
    files += _drop_in(config, notes)
    files += _rules(config, names, root, plugged, notes)
    return Plan(files=tuple(files), notes=tuple(notes), next_steps=_next_steps(installed, source))


def _new_names(config: Config, plugged: Sequence[Adapter]) -> dict[str, str]:
    """By port whose name depends on what was plugged in first, the name that its rule gives it."""
    return {
        path: rule.path
        for path, names in serial_ports(config).items()
        if UNSTABLE.fullmatch(path)
        for rule in rules({path: names}, plugged)
    }


def renamed(text: str, names: Mapping[str, str]) -> str:
    """A configuration with other names for its serial ports; comments stay."""
    lines = text.splitlines(keepends=True)
    for old, new in names.items():
        link = re.compile(rf'(?<=://){re.escape(old)}(?=["\'?])')
        lines = [line if line.lstrip().startswith("#") else link.sub(new, line) for line in lines]
    return "".join(lines)


def _profiles(source: Path) -> list[File]:
    """Profiles of the user's own that a configuration names, at the same place beside it.

    Raises:
        ServiceError: one of them lies elsewhere.
    """
    found = []
    for device in tomllib.loads(source.read_text(encoding="utf-8-sig")).get("device", ()):
        name = device.get("profile")
        if not isinstance(name, str):
            continue
        for relative in (Path(name), Path("devices") / f"{name}.toml"):
            file = source.parent / relative
            if file.is_relative_to(data_directory()) or not file.is_file():
                continue
            if relative.is_absolute() or ".." in relative.parts:
                raise ServiceError(
                    f"{source}: profile {name!r} is not beside the configuration: put it there, so that both go to "
                    f"{CONFIG.parent}"
                )
            text = file.read_text(encoding="utf-8-sig")
            found.append(File(path=CONFIG.parent / relative, text=text, said=f"profile of device {device['name']}"))
            break
    return found


def _unit(root: Path, program: Path, notes: list[str]) -> list[File]:
    packaged = next((path for path in PACKAGED_UNITS if below(root, path).is_file()), None)
    if packaged is not None:
        notes.append(f"{packaged}: the package's unit is there: no other is made")
        return []
    if _is_theirs(below(root, UNIT)):
        notes.append(f"{UNIT}: is there, and not made by this command: left as it is")
        return []
    text = f"{MARK}\n# Yours goes into a drop-in: systemctl edit heaved\n" + unit_text().replace(
        UNIT_PROGRAM, str(program)
    )
    return [File(path=UNIT, text=text, said=f"the service: runs {program} as a user of its own, made when it starts")]


def _drop_in(config: Config, notes: list[str]) -> list[File]:
    """Made in any case: what an earlier configuration was allowed must not stay."""
    found, cautions = needs(config)
    told: dict[tuple[str, str], list[str]] = {}
    for need in found:
        told.setdefault((need.key, need.said), []).append(need.setting)
    notes += [f"{key}: {said} ({', '.join(settings)})" for (key, said), settings in told.items()] + cautions
    lines = [f"# {need.key}\n{need.setting}\n" for need in found]
    text = f"{MARK}\n# What {CONFIG} names beyond this machine and its serial ports.\n\n[Service]\n" + "".join(lines)
    said = "what the configuration needs besides" if found else "nothing besides: it may talk to this machine alone"
    return [File(path=DROP_IN, text=text, said=said)]


def _rules(
    config: Config, names: Mapping[str, str], root: Path, plugged: Sequence[Adapter], notes: list[str]
) -> list[File]:
    ports = serial_ports(config)
    # The name that an earlier run gave and the adapter's own are both the adapter.
    old_of = {new: old for old, new in names.items()}
    found = rules({old_of.get(path, path): on for path, on in ports.items()}, plugged)
    told = {name for rule in found for name in rule.names}
    missing = {path: on for path, on in ports.items() if not told & set(on)}
    file = below(root, RULES)
    earlier = file.read_text(encoding="utf-8") if file.is_file() else ""
    kept = kept_rules(earlier, [on[0] for on in missing.values()])
    for path, on in missing.items():
        if f'"heaved-{on[0]}' in kept:
            notes.append(f"{on[0]}: {path} is not plugged in just now: its rule stays as it is")
        elif UNSTABLE.fullmatch(path) or path.startswith("/dev/heaved-"):
            notes.append(
                f"{on[0]}: {path} is not plugged in, so its adapter is not known: plug it in and run this again, and "
                "it gets a name that stays"
            )
    notes += [rule.caution for rule in found if rule.caution]
    notes += [f"{', '.join(rule.names)}: the adapter is {rule.path} from now on" for rule in found]
    if not found and not kept:
        return []
    body = "\n".join([rule.text for rule in found] + ([kept] if kept else []))
    return [File(path=RULES, text=f"{MARK}\n\n{body}", said="names of the adapters, and no waiting in those of FTDI")]


def program_faults(program: Path) -> list[str]:
    """Why the service could not start a program there: the unit hides these directories from it."""
    interpreter = Path(os.path.realpath(sys.executable))
    return [
        f"{what} {path} is below {hidden}, where the service cannot see it: install heaved into /opt/heaved "
        "(python3 -m venv /opt/heaved; /opt/heaved/bin/pip install heaved) and run that one"
        for what, path in (("the program", program), ("its Python", interpreter))
        for hidden in HIDDEN
        if path.is_relative_to(hidden) and (what == "the program" or program.is_relative_to(sys.prefix))
    ]


def group_faults(root: Path) -> list[str]:
    """That the group of serial ports, in which the unit is, does not exist: the service would not start."""
    groups = below(root, Path("/etc/group"))
    if not groups.is_file() or any(line.startswith(f"{GROUP}:") for line in groups.read_text().splitlines()):
        return []
    return [f"there is no group {GROUP} here, which the unit is in and ports are given to: groupadd --system {GROUP}"]


def _is_theirs(file: Path) -> bool:
    """Whether there is a file that this command has not made."""
    return file.is_file() and not file.read_text(encoding="utf-8", errors="replace").startswith(MARK)


def _next_steps(installed: Path, source: Path | None) -> tuple[str, ...]:
    edit = (
        () if installed.is_file() or source is not None else (f"edit {CONFIG}: links, ids and profiles are examples",)
    )
    return (
        *edit,
        f"heaved check-config {CONFIG}",
        "systemctl enable --now heaved",
        "heaved status; journalctl -u heaved -e",
        f"after a change of {CONFIG}: run this again (networks, adapters), then systemctl restart heaved",
    )


# ---- doing it --------------------------------------------------------------------------------------------------------


def write(wanted: Plan, root: Path, run: Run) -> list[str]:
    """Make the files that are not so already; returns what was done. ``run``: of the machine itself, what makes systemd
    and udev read them.

    Raises:
        ServiceError: a file cannot be written; what was written until then stays.
    """
    done = []
    changed = set()
    for file in wanted.files:
        path = below(root, file.path)
        if path.is_file() and path.read_bytes() == file.text.encode():
            done.append(f"{file.path}: as it should be")
            continue
        if file.path.is_relative_to(CONFIG.parent) and path.exists():
            done.append(f"{file.path}: is there already: left as it is")
            continue
        verb = "renewed" if path.exists() else "made"
        _put(path, file.text)
        changed.add(file.path)
        done.append(f"{file.path}: {verb}: {file.said}")
    if changed & {UNIT, DROP_IN}:
        run(["systemctl", "daemon-reload"])
    if RULES in changed:
        run(["udevadm", "control", "--reload"])
        run(["udevadm", "trigger", "--action=add", "--subsystem-match=tty", "--subsystem-match=usb-serial"])
    return done


def _put(path: Path, text: str) -> None:
    """Whole or not at all; anybody may read it."""
    new = path.with_name(f".{path.name}.new")
    try:
        path.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
        new.write_text(text, encoding="utf-8")
        new.chmod(0o644)
        new.replace(path)
    except OSError as error:
        raise ServiceError(f"{path}: cannot be written: {error.strerror or error}") from error


def remove(root: Path, run: Run) -> list[str]:
    """Take away what :func:`write` has made; configuration and state stay. Returns what was done.

    Raises:
        ServiceError: a file cannot be removed.
    """
    done = []
    ours = [path for path in (UNIT, DROP_IN, RULES) if below(root, path).is_file()]
    if UNIT in ours and not _is_theirs(below(root, UNIT)):
        run(["systemctl", "disable", "--now", "heaved"])
    for path in ours:
        file = below(root, path)
        if _is_theirs(file):
            done.append(f"{path}: not made by this command: left as it is")
            continue
        try:
            file.unlink()
        except OSError as error:
            raise ServiceError(f"{file}: cannot be removed: {error.strerror or error}") from error
        done.append(f"{path}: removed")
    directory = below(root, DROP_IN).parent
    if directory.is_dir() and not any(directory.iterdir()):
        directory.rmdir()
    if any(line.endswith(": removed") for line in done):
        run(["systemctl", "daemon-reload"])
        run(["udevadm", "control", "--reload"])
    else:
        done.append("nothing of it is here")
    done += [
        f"{path}: left as it is; to take it away too: rm -r {path}{note}"
        for path, note in ((CONFIG.parent, ""), (STATE, " /var/lib/private/heaved"))
        if below(root, path).exists()
    ]
    return done
