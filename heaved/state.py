"""What a restart remembers: one small JSON file, replaced as a whole or not at all."""

from __future__ import annotations

import asyncio
import errno
import hashlib
import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Generic, TypeVar

import msgspec
import structlog

VERSION = 2
"""Of the file's layout and of what its numbers mean; a file of another version is set aside."""
FILE_NAME = "state.json"

T = TypeVar("T", bound=msgspec.Struct)

_log = structlog.get_logger(__name__)


class StateError(Exception):
    """A state file that cannot be used; the message says why."""


class _Envelope(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    version: int
    sha256: str
    """Of the bytes of ``state`` as they stand in the file."""
    state: msgspec.Raw


class _Version(msgspec.Struct, frozen=True):
    version: int


def state_directory(configured: str, environment: Mapping[str, str] = os.environ) -> Path:
    """The configured directory, else systemd's ``$STATE_DIRECTORY``, else ``~/.local/state/heaved``."""
    if configured:
        return Path(configured).expanduser()
    # systemd gives a colon-separated list when a unit names several.
    given = environment.get("STATE_DIRECTORY", "").split(":")[0]
    return Path(given) if given else Path.home() / ".local" / "state" / "heaved"


class StateFile(Generic[T]):
    """The state file of one daemon; ``kind`` is the record it holds.

    Encoding is quick and belongs to whoever owns the state; :meth:`write` waits for the disk and belongs in a thread.
    """

    def __init__(self, directory: Path, kind: type[T]) -> None:
        self.path = directory / FILE_NAME
        self._kind = kind

    def prepare(self) -> None:
        """Make the directory if it is not there.

        Raises:
            OSError: it cannot be made, or not be written to.
        """
        directory = self.path.parent
        directory.mkdir(mode=0o750, parents=True, exist_ok=True)
        if not os.access(directory, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(directory))

    @staticmethod
    def encode(state: msgspec.Struct) -> bytes:
        """The content of the file."""
        body = msgspec.json.encode(state)
        envelope = _Envelope(version=VERSION, sha256=hashlib.sha256(body).hexdigest(), state=msgspec.Raw(body))
        return msgspec.json.encode(envelope) + b"\n"

    def write(self, content: bytes) -> None:
        """Replace the file: after a crash at any moment there is the old one or the new one, whole.

        Raises:
            OSError: the disk is full, the directory is missing or not writable, ...; the old file is as it was.
        """
        temporary = self.path.with_suffix(".tmp")
        try:
            self.path.parent.mkdir(mode=0o750, parents=True, exist_ok=True)
            with temporary.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(self.path)
        except OSError:
            # Half a file must not go on taking room on a full disk.
            temporary.unlink(missing_ok=True)
            raise
        directory = os.open(self.path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(directory)  # Without it the rename itself may be lost in a power cut.
        finally:
            os.close(directory)

    def read(self) -> T | None:
        """The remembered state; None when there is no file.

        Raises:
            StateError: the file is damaged or of another version.
            OSError: it cannot be read.
        """
        try:
            content = self.path.read_bytes()
        except FileNotFoundError:
            return None
        try:
            # Version first: another version may have other fields.
            version = msgspec.json.decode(content, type=_Version).version
            if version != VERSION:
                raise StateError(f"is of version {version}, this release reads version {VERSION}")
            envelope = msgspec.json.decode(content, type=_Envelope)
            body = bytes(envelope.state)
            if hashlib.sha256(body).hexdigest() != envelope.sha256:
                raise StateError("does not match its checksum")
            return msgspec.json.decode(body, type=self._kind)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            raise StateError(f"is damaged: {error}") from error

    def set_aside(self) -> Path:
        """Rename the file to ``*.corrupt``, for a person to look at; returns where it is now.

        Raises:
            OSError: it cannot be renamed.
        """
        return self.path.replace(self.path.with_suffix(".corrupt"))


class Memory(Generic[T]):
    """When and how the state is saved and restored; what goes wrong is said once, and nothing is raised."""

    def __init__(
        self,
        file: StateFile[T],
        state: Callable[[], T],
        *,
        count_save: Callable[[str], None],
        count_load: Callable[[str], None],
    ) -> None:
        """``state``: what there is to remember now. ``count_save`` is told ``saved`` or ``failed`` for each save,
        ``count_load`` what came of the restoring: ``restored``, ``absent`` or ``refused``."""
        self.file = file
        self._state = state
        self._count_save = count_save
        self._count_load = count_load
        self._disk = ThreadPoolExecutor(max_workers=1, thread_name_prefix="state")
        self._fails = False

    def restore(self, take: Callable[[T], None]) -> None:
        """Hand the remembered state, if there is a sound one, to ``take``, which may refuse it with ValueError."""
        try:
            self.file.prepare()
        except OSError as error:
            self._say_failed(error)
        self._count_load(self._restore(take, str(self.file.path)))

    def _restore(self, take: Callable[[T], None], path: str) -> str:
        try:
            state = self.file.read()
            if state is None:
                _log.info("no saved state: starting cold", file=path)
                return "absent"
            take(state)
            _log.info("state restored", file=path)
            return "restored"
        except StateError as error:
            _log.warning("saved state of no use: starting cold", file=path, reason=str(error), kept=self._kept())
        except ValueError as error:
            reason = f"does not fit this configuration: {error}"
            _log.warning("saved state of no use: starting cold", file=path, reason=reason, kept=self._kept())
        except OSError as error:
            _log.warning("saved state cannot be read: starting cold", file=path, reason=error.strerror)
        return "refused"

    async def save(self) -> None:
        """Save now. The disk is waited for in a thread, so that a slow one delays nothing else."""
        content = self.file.encode(self._state())
        try:
            await asyncio.get_running_loop().run_in_executor(self._disk, self.file.write, content)
        except OSError as error:
            self._count_save("failed")
            self._say_failed(error)
            return
        self._count_save("saved")
        if self._fails:
            self._fails = False
            _log.info("the state is saved again", file=str(self.file.path))

    async def keep_saving(self, period_s: float) -> None:
        while True:
            await asyncio.sleep(period_s)
            await self.save()

    def close(self) -> None:
        """No more saves; one that hangs is left behind."""
        self._disk.shutdown(wait=False)

    def _kept(self) -> str:
        try:
            return str(self.file.set_aside())
        except OSError as error:
            return f"nowhere ({error.strerror})"

    def _say_failed(self, error: OSError) -> None:
        if not self._fails:
            hint = "free some room, or correct [state] directory and its permissions; going on without"
            _log.warning("the state cannot be saved", file=str(self.file.path), reason=error.strerror, hint=hint)
        self._fails = True
