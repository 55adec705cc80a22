"""What a restart remembers: one small JSON file, replaced as a whole or not at all.

A disk may hang, and where the file should be there may be anything: nothing here makes the event loop wait for it.
"""

from __future__ import annotations

import asyncio
import errno
import hashlib
import os
import stat
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from math import isfinite, nan
from pathlib import Path
from typing import TYPE_CHECKING, Final, Generic, TypeVar

import msgspec
import structlog

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

VERSION: Final = 3
"""Of the file's layout and of what its numbers mean; a file of another version is set aside."""
READABLE: Final = (2, VERSION)
"""Version 2 does not say when it was saved, and is otherwise the same."""
FILE_NAME: Final = "state.json"
MAX_BYTES: Final = 4 << 20
"""Several times the state with the largest network that can be configured."""
LOAD_S: Final = 1.5
"""A start waits so long for the disk; what hangs longer is not waited for."""
SAVE_S: Final = 30.0
"""A save that takes longer is one that fails."""
MAX_AHEAD_S: Final = 86400.0
"""A state that claims to be saved in the future by more than this was written by a clock that cannot be believed."""

T = TypeVar("T", bound=msgspec.Struct)
R = TypeVar("R")

_log = structlog.get_logger(__name__)


class StateError(Exception):
    """A state file that cannot be used; the message says why."""


class Saved(msgspec.Struct, Generic[T], frozen=True):
    """The content of a state file."""

    state: T
    saved_s: float
    """When, UTC, seconds since 1970; nan: not known."""


class _Envelope(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    version: int
    saved: str = ""
    """UTC, ISO 8601; absent in version 2."""
    sha256: str
    """Of ``saved`` and the bytes of ``state`` as they stand in the file."""
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

    Encoding is quick and belongs to whoever owns the state; the rest waits for the disk and belongs in a thread.
    """

    def __init__(self, directory: Path, kind: type[T], check: Callable[[T], None] = lambda _state: None) -> None:
        """``check``: raises ValueError for a record whose numbers cannot be."""
        self.path = directory / FILE_NAME
        self._kind = kind
        self.check = check

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
    def encode(state: msgspec.Struct, saved_s: float = nan) -> bytes:
        """The content of the file. ``saved_s``: when, UTC, seconds since 1970; nan: not known."""
        body = msgspec.json.encode(state)
        saved = datetime.fromtimestamp(saved_s, UTC).isoformat(timespec="milliseconds") if isfinite(saved_s) else ""
        envelope = _Envelope(version=VERSION, saved=saved, sha256=_digest(saved, body), state=msgspec.Raw(body))
        return msgspec.json.encode(envelope) + b"\n"

    def write(self, content: bytes) -> None:
        """Replace the file: after a crash at any moment there is the old one or the new one, whole.

        Raises:
            OSError: the disk is full, the directory is missing or not writable, ...; the old file is as it was.
        """
        temporary = self.path.with_suffix(".tmp")
        try:
            self.path.parent.mkdir(mode=0o750, parents=True, exist_ok=True)
            temporary.unlink(missing_ok=True)  # Left by a crash, or put there by somebody: never written through.
            with os.fdopen(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode=0o600), "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(self.path)
        except OSError:
            # Half a file must not go on taking room on a full disk.
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise
        directory = os.open(self.path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(directory)  # Without it the rename itself may be lost in a power cut.
        finally:
            os.close(directory)

    def read(self) -> Saved[T] | None:
        """The remembered state; None when there is no file.

        Raises:
            StateError: it is no regular file, damaged, of another version, or holds what nobody has saved.
            OSError: it cannot be read.
        """
        try:
            content = _content(self.path)
        except FileNotFoundError:
            return None
        try:
            # Version first: another version may have other fields.
            version = msgspec.json.decode(content, type=_Version).version
            if version not in READABLE:
                readable = " and ".join(map(str, READABLE))
                raise StateError(f"is of version {version}, this release reads {readable}")
            envelope = msgspec.json.decode(content, type=_Envelope)
            body = bytes(envelope.state)
            if _digest(envelope.saved, body) != envelope.sha256:
                raise StateError("does not match its checksum")
            saved_s = datetime.fromisoformat(envelope.saved).timestamp() if envelope.saved else nan
            state = msgspec.json.decode(body, type=self._kind)
        except (msgspec.MsgspecError, ValueError, OverflowError, RecursionError) as error:
            raise StateError(f"is damaged: {error}") from error
        try:
            self.check(state)
        except ValueError as error:
            raise StateError(f"holds nonsense: {error}") from error
        return Saved(state, saved_s)

    def set_aside(self) -> Path:
        """Rename the file to ``*.corrupt``, for a person to look at; returns where it is now.

        Raises:
            OSError: it cannot be renamed.
        """
        return self.path.replace(self.path.with_suffix(".corrupt"))


def _digest(saved: str, body: bytes) -> str:
    return hashlib.sha256(saved.encode() + body).hexdigest()


def _content(path: Path) -> bytes:
    """What is in a regular file, and in nothing else: a FIFO would be waited for, a link may lead anywhere.

    Raises:
        StateError: it is none, or too long.
        OSError: it cannot be read.
    """
    try:
        fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.ENXIO):  # A link; a socket or a device without anybody behind it.
            raise StateError("is no regular file") from error
        raise
    if not stat.S_ISREG(os.fstat(fd).st_mode):
        os.close(fd)
        raise StateError("is no regular file")
    with os.fdopen(fd, "rb") as file:
        content = file.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise StateError(f"is longer than {MAX_BYTES >> 20} MiB")
    return content


class Memory(Generic[T]):
    """When and how the state is saved and restored; what goes wrong is said once, and nothing is raised."""

    def __init__(
        self,
        file: StateFile[T],
        state: Callable[[], T],
        *,
        count_save: Callable[[str], None],
        count_load: Callable[[str], None],
        realtime: Callable[[], float] = time.time,
        load_s: float = LOAD_S,
        save_s: float = SAVE_S,
    ) -> None:
        """``state``: what there is to remember now. ``count_save`` is told ``saved`` or ``failed`` for each save,
        ``count_load`` what came of the restoring: ``restored``, ``absent`` or ``refused``. ``realtime``: UTC, seconds
        since 1970. ``load_s`` and ``save_s``: what the disk may take.
        """
        self.file = file
        self._state = state
        self._count_save = count_save
        self._count_load = count_load
        self._realtime = realtime
        self._load_s = load_s
        self._save_s = save_s
        self._disk = ThreadPoolExecutor(max_workers=1, thread_name_prefix="state")
        self._saving: asyncio.Future[None] | None = None
        """A save that the disk has not done yet."""
        self._fails = False

    async def restore(self, take: Callable[[T, float], None]) -> None:
        """Hand the remembered state, if there is a sound one, and its age in seconds (nan: not known) to ``take``.

        It may refuse them with ValueError.
        """
        path = str(self.file.path)
        try:
            self._count_load(await self._restore(take, path))
        except TimeoutError:
            reason = f"the disk has not answered for {self._load_s:g} s"
            _log.warning("saved state cannot be read: starting cold", file=path, reason=reason)
            self._count_load("refused")

    async def _restore(self, take: Callable[[T, float], None], path: str) -> str:
        try:
            await self._in_time(self.file.prepare)
        except OSError as error:
            if isinstance(error, TimeoutError):
                raise
            self._say_failed(error.strerror or str(error))
        try:
            saved = await self._in_time(self.file.read)
            if saved is None:
                _log.info("no saved state: starting cold", file=path)
                return "absent"
            age_s = self._age_s(saved.saved_s)
            take(saved.state, age_s)
        except StateError as error:
            reason = str(error)
        except ValueError as error:
            reason = f"does not fit this configuration: {error}"
        except OSError as error:
            if isinstance(error, TimeoutError):
                raise
            _log.warning("saved state cannot be read: starting cold", file=path, reason=error.strerror)
            return "refused"
        else:
            _log.info("state restored", file=path, **({"age_s": round(age_s, 1)} if isfinite(age_s) else {}))
            return "restored"
        _log.warning("saved state of no use: starting cold", file=path, reason=reason, kept=await self._kept())
        return "refused"

    def _age_s(self, saved_s: float) -> float:
        age_s = self._realtime() - saved_s
        if age_s < -MAX_AHEAD_S:
            days = f"{-age_s / 86400.0:.0f} days"
            raise StateError(f"was saved {days} ahead of this machine's clock: is the clock right?")
        return max(age_s, 0.0) if isfinite(age_s) else nan  # A clock that was set back a little is no news.

    async def save(self) -> None:
        """Save now. The disk is waited for in a thread, so that a slow one delays nothing else."""
        if self._saving is not None:  # One that was begun before, and whose caller has not waited for its end.
            await asyncio.wait((self._saving,), timeout=self._save_s)
        if self._saving is None or self._saving.done():
            work = partial(self._write, self._state(), self._realtime())
            self._saving = asyncio.get_running_loop().run_in_executor(self._disk, work)
        saving = self._saving
        await asyncio.wait((saving,), timeout=self._save_s)
        if not saving.done():
            self._count_save("failed")
            self._say_failed(f"the disk has not answered for {self._save_s:g} s")
            return
        self._saving = None
        error = saving.exception()
        if error is not None:
            self._count_save("failed")
            self._say_failed((error.strerror if isinstance(error, OSError) else None) or str(error))
            return
        self._count_save("saved")
        if self._fails:
            self._fails = False
            _log.info("the state is saved again", file=str(self.file.path))

    def _write(self, state: T, saved_s: float) -> None:
        """Replace the file, but not by what would be set aside when it is read again."""
        self.file.check(state)
        self.file.write(self.file.encode(state, saved_s))

    async def keep_saving(self, period_s: float) -> None:
        """Save once a period until cancelled."""
        while True:
            await asyncio.sleep(period_s)
            await self.save()

    def close(self) -> None:
        """No more saves; one that hangs is left behind."""
        self._disk.shutdown(wait=False)

    async def _in_time(self, work: Callable[[], R]) -> R:
        """What ``work`` gives, in the thread that waits for the disk.

        Raises:
            TimeoutError: it takes too long; it goes on, but nobody waits for it.
        """
        working = asyncio.get_running_loop().run_in_executor(self._disk, work)
        return await asyncio.wait_for(working, self._load_s)

    async def _kept(self) -> str:
        try:
            return str(await self._in_time(self.file.set_aside))
        except OSError as error:
            return f"nowhere ({error.strerror or 'the disk does not answer'})"

    def _say_failed(self, reason: str) -> None:
        if not self._fails:
            hint = "free some room, or correct [state] directory and its permissions; going on without"
            _log.warning("the state cannot be saved", file=str(self.file.path), reason=reason, hint=hint)
        self._fails = True
