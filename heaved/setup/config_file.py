"""A table put at the end of a configuration file: shown first, checked as the daemon would, written whole or not."""

from __future__ import annotations

import difflib
import os
import stat
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from heaved.config.read import ConfigError, load, load_to_run
from heaved.config.rules import cautions, rate_faults

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from heaved.config import Config


class RefusedError(Exception):
    """The file stays as it is; says why and what to do."""


class Addition:
    """A file with something put at its end, not yet written. A context manager: what is not kept leaves nothing behind.

    Attributes:
        diff: what changes, as ``diff -u`` shows it.
        remarks: what ``heaved check-config`` would say of the file besides that it is well.
    """

    def __init__(self, path: Path, text: str) -> None:
        """Raises:
        RefusedError: the file cannot be read or written, or would not be taken by the daemon.
        """
        self._path = path
        self._target = Path(os.path.realpath(path))  # A link stays a link.
        self._before = _read(self._target, path)
        after = _joined(self._before, text)
        self.diff = "".join(_diff(self._before or b"", after, path))
        self._candidate = _write_beside(self._target, after, path)
        try:
            self.remarks = _checked(self._candidate, path, is_new=self._before is None)
        except RefusedError:
            self.drop()
            raise

    def __enter__(self) -> Addition:
        return self

    def __exit__(self, *_: object) -> None:
        self.drop()

    def drop(self) -> None:
        """Leave the file as it is."""
        with suppress(FileNotFoundError):
            self._candidate.unlink()

    def keep(self) -> None:
        """Put it in place, in one step.

        Raises:
            RefusedError: somebody else has changed the file meanwhile, or the disk will not have it.
        """
        if _read(self._target, self._path) != self._before:
            raise RefusedError(f"{self._path}: has been changed meanwhile, and was left alone: do it again")
        try:
            if self._before is not None:
                old = self._target.stat()
                self._candidate.chmod(stat.S_IMODE(old.st_mode))
                with suppress(PermissionError):  # Only root may give a file away.
                    os.chown(self._candidate, old.st_uid, old.st_gid)
            self._candidate.replace(self._target)
            directory = os.open(self._target.parent, os.O_RDONLY)
            try:
                os.fsync(directory)
            finally:
                os.close(directory)
        except OSError as error:
            raise RefusedError(f"{self._path}: cannot be written: {error.strerror or error}") from error


def taken_names(path: Path) -> Collection[str]:
    """Names of the devices in a configuration; none in one that is not there or has faults."""
    with suppress(ConfigError):
        return {device.name for device in load(path).device}
    return ()


def _read(target: Path, path: Path) -> bytes | None:
    """None: there is no such file yet."""
    try:
        return target.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise RefusedError(f"{path}: cannot be read: {error.strerror or error}") from error


def _joined(before: bytes | None, text: str) -> bytes:
    if not before:
        return text.encode()
    end = b"\r\n" if b"\r\n" in before else b"\n"
    gap = end if before.endswith(b"\n") else 2 * end
    return before + gap + text.encode().replace(b"\n", end)


def _diff(before: bytes, after: bytes, path: Path) -> Iterator[str]:
    old, new = ([*data.decode(errors="replace").splitlines(keepends=True)] for data in (before, after))
    for line in difflib.unified_diff(old, new, str(path), f"{path} (new)"):
        yield line if line.endswith("\n") else f"{line}\n"


def _write_beside(target: Path, data: bytes, path: Path) -> Path:
    """In the same directory: profiles are looked for from there, and only there a file is put in place in one step."""
    try:
        descriptor, name = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".new", dir=target.parent)
    except OSError as error:
        raise RefusedError(f"{path}: nothing can be written into its directory: {error.strerror or error}") from error
    candidate = Path(name)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        candidate.chmod(0o644)
    except OSError as error:
        candidate.unlink()
        raise RefusedError(f"{path}: cannot be written: {error.strerror or error}") from error
    return candidate


def _checked(candidate: Path, path: Path, *, is_new: bool) -> list[str]:
    """What is to be remarked of a file that is sound.

    Raises:
        RefusedError: it has faults; whether it had them before is said.
    """
    try:
        config = load(candidate)
    except ConfigError as error:
        raise RefusedError(_refusal(error.faults, path, is_new=is_new)) from error
    if faults := rate_faults(config):
        raise RefusedError(_refusal(faults, path, is_new=is_new))
    return list(_remarks(config, candidate))


def _refusal(faults: list[str], path: Path, *, is_new: bool) -> str:
    told = "\n".join(f"{path}: {fault}" for fault in faults)
    if not is_new:
        try:
            faulty = bool(rate_faults(load(path)))
        except ConfigError:
            faulty = True
        if faulty:
            mend = f"mend them first (heaved check-config {path})"
            return f"{told}\n{path}: has faults of its own and was left alone: {mend}"
    return f"{told}\n{path}: was left alone"


def _remarks(config: Config, candidate: Path) -> Iterator[str]:
    try:
        load_to_run(candidate)
    except ConfigError as error:
        yield from (f"not yet enough for heaved run: {fault}" for fault in error.faults)
    if not any(device.role == "imu" for device in config.device):
        yield 'no device of role "imu" yet: the daemon would have no heave'
    yield from (f"caution: {caution}" for caution in cautions(config))
