"""Signals, taken by a thread of their own: what asks the process to end is obeyed whatever the loop waits for."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import threading
from typing import TYPE_CHECKING, Final, Self

import structlog

if TYPE_CHECKING:
    from types import FrameType, TracebackType

_STOP: Final = (signal.SIGTERM, signal.SIGINT)
_AGAIN: Final = signal.SIGHUP
_LAST_WORDS_S: Final = 0.1
"""Between saying that the process does not stop, and its end."""

_log = structlog.get_logger(__name__)


class Signals:
    """A context manager; enter it in the main thread, before anything that may hang.

    From the first SIGTERM or SIGINT on the process has ``exit_s``: then it ends, with exit code 0, unless
    :meth:`call_off` was called meanwhile.

    Attributes:
        stop: set, on the loop, with SIGTERM and SIGINT.
        again: likewise with SIGHUP.
    """

    def __init__(self, exit_s: float) -> None:
        self.stop = asyncio.Event()
        self.again = asyncio.Event()
        self._exit_s = exit_s
        self._loop: asyncio.AbstractEventLoop | None = None
        self._seen: set[int] = set()
        self._lock = threading.Lock()
        self._is_over = threading.Event()
        # The interpreter writes the number of a signal into one end, at once, whatever the main thread is doing.
        self._ours, self._theirs = socket.socketpair()
        self._theirs.setblocking(False)

    def __enter__(self) -> Self:
        self._handlers = {number: signal.signal(number, _nothing) for number in (*_STOP, _AGAIN)}
        self._wakeup_fd = signal.set_wakeup_fd(self._theirs.fileno(), warn_on_full_buffer=False)
        threading.Thread(target=self._listen, name="signals", daemon=True).start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        signal.set_wakeup_fd(self._wakeup_fd)
        for number, handler in self._handlers.items():
            # Whoever asks again while the interpreter ends is obeyed already: that is no error to be shown.
            is_obeyed = number in _STOP and not self._seen.isdisjoint(_STOP)
            signal.signal(number, signal.SIG_IGN if is_obeyed else handler)
        self._theirs.close()  # The thread reads its end, and ends.

    def tell(self, loop: asyncio.AbstractEventLoop) -> None:
        """From now on set the events, which is done on ``loop``; what has come before is not lost."""
        with self._lock:
            self._loop = loop
            for number in self._seen:
                self._event(number).set()

    def call_off(self) -> None:
        """Everything has stopped as it should: the process will end by itself."""
        self._is_over.set()

    def _listen(self) -> None:
        with self._ours:
            while self._seen.isdisjoint(_STOP):
                numbers = self._ours.recv(64)
                if not numbers:
                    return
                numbers = bytes(number for number in numbers if number in self._handlers)  # Others are not ours.
                with self._lock:
                    self._seen.update(numbers)
                    if self._loop is not None and not self._loop.is_closed():
                        for number in numbers:
                            self._loop.call_soon_threadsafe(self._event(number).set)
            # While the signal is told to somebody, it may come again: Ctrl-C, twice.
            if not self._is_over.wait(self._exit_s - _LAST_WORDS_S):
                # In a thread of its own, for it may be standard error that hangs.
                words = "not everything has stopped in time: ended all the same"
                threading.Thread(target=_log.error, args=(words,), name="last words", daemon=True).start()
                if not self._is_over.wait(_LAST_WORDS_S):
                    os._exit(0)

    def _event(self, number: int) -> asyncio.Event:
        return self.again if number == _AGAIN else self.stop


def _nothing(_number: int, _frame: FrameType | None) -> None:
    """A handler must be there for the signal not to end the process."""
