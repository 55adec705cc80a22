"""A table put at the end of a configuration file: shown first, checked as the daemon would, written whole or not."""

from __future__ import annotations

import os
from contextlib import suppress
from typing import TYPE_CHECKING

from heaved.config.read import ConfigError, load
from heaved.config.rules import cautions, rate_faults
from heaved.setup.edit import EditError, difference, read_text, validated, write

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path

    from heaved.config import Config


class RefusedError(Exception):
    """The file stays as it is; says why and what to do."""


class Addition:
    """A file with something put at its end, not yet written.

    Attributes:
        diff: what changes, as ``diff -u`` shows it.
        remarks: what ``heaved check-config`` would say of the file besides that it is well.
    """

    def __init__(self, path: Path, text: str) -> None:
        """Raises:
        RefusedError: the file cannot be read, or would not be taken by the daemon.
        """
        self._path = path
        if not os.access(path.resolve().parent, os.W_OK):
            raise RefusedError(f"{path}: nothing can be written into its directory")
        try:
            self._before = read_text(path) if path.exists() else None
        except EditError as error:
            raise RefusedError(str(error)) from error
        self._after = _joined(self._before, text)
        self.remarks = self._checked()
        self.diff = "".join(f"{line}\n" for line in difference(self._before or "", self._after, str(path)))

    def keep(self) -> None:
        """Put it in place, in one step.

        Raises:
            RefusedError: somebody else has changed the file meanwhile, or the disk will not have it.
        """
        try:
            write(self._path, self._after, before=self._before)
        except EditError as error:
            raise RefusedError(str(error)) from error
        except ConfigError as error:
            raise RefusedError(self._refusal(error.faults)) from error

    def _checked(self) -> list[str]:
        try:
            config = validated(self._path, self._after)
        except EditError as error:
            raise RefusedError(self._refusal([str(error)])) from error
        except ConfigError as error:
            raise RefusedError(self._refusal(error.faults)) from error
        if faults := rate_faults(config):
            raise RefusedError(self._refusal(faults))
        return list(self._remarks(config))

    def _refusal(self, faults: list[str]) -> str:
        told = "\n".join(f"{self._path}: {fault}" for fault in faults)
        if self._before is not None:
            try:
                faulty = bool(rate_faults(load(self._path)))
            except ConfigError:
                faulty = True
            if faulty:
                mend = f"mend them first (heaved check-config {self._path})"
                return f"{told}\n{self._path}: has faults of its own and was left alone: {mend}"
        return f"{told}\n{self._path}: was left alone"

    def _remarks(self, config: Config) -> Iterator[str]:
        try:
            validated(self._path, self._after, to_run=True)
        except ConfigError as error:
            yield from (f"not yet enough for heaved run: {fault}" for fault in error.faults)
        if not any(device.role == "imu" for device in config.device):
            yield 'no device of role "imu" yet: the daemon would have no heave'
        yield from (f"caution: {caution}" for caution in cautions(config))


def taken_names(path: Path) -> Collection[str]:
    """Names of the devices in a configuration; none in one that is not there or has faults."""
    with suppress(ConfigError):
        return {device.name for device in load(path).device}
    return ()


def _joined(before: str | None, text: str) -> str:
    if not before:
        return text
    end = "\r\n" if "\r\n" in before else "\n"
    gap = end if before.endswith("\n") else 2 * end
    return before + gap + text.replace("\n", end)
