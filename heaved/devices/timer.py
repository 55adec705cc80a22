"""Absolute deadlines on the event loop, by timerfd: the loop's own timers round to whole milliseconds.

Linux only. Times are CLOCK_MONOTONIC seconds, as ``time.monotonic`` gives them.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import os
import struct
import sys
import time
from math import floor, inf
from typing import TYPE_CHECKING, Final, Self

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

LOOP_RESOLUTION_S: Final = 1e-3
"""Of the loop's own timers."""


class Pace:
    """Deadlines ``start + n * period``, counted in whole periods so that rounding never adds up. Pure."""

    def __init__(self, period_s: float, start_s: float) -> None:
        if not period_s > 0.0:
            raise ValueError(f"period must be positive, not {period_s} s")
        self.period_s = period_s
        self.start_s = start_s
        self._number = 0

    @property
    def due_s(self) -> float:
        """The deadline that comes next, or has come."""
        return self.start_s + self._number * self.period_s

    def advance(self, now_s: float) -> int:
        """On to the next deadline; of those that have passed already only the latest is kept.

        Returns how many were skipped, so that a stall is counted and never followed by a burst.
        """
        following = self._number + 1
        self._number = max(following, floor((now_s - self.start_s) / self.period_s))
        return self._number - following


class DeadlineTimer:
    """Waits for absolute deadlines, one at a time. A context manager within a running loop. While the process is out of
    descriptors the loop's own timers do.
    """

    def __init__(self) -> None:
        self._fd = -1
        self._woken: asyncio.Future[None] | None = None

    def __enter__(self) -> Self:
        self._open()
        return self

    def _open(self) -> None:
        with contextlib.suppress(OSError):
            fd = _create()
            asyncio.get_running_loop().add_reader(fd, self._expired)
            self._fd = fd

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._fd >= 0:
            asyncio.get_running_loop().remove_reader(self._fd)
            os.close(self._fd)
            self._fd = -1

    async def wait_until(self, deadline_s: float) -> float:
        """Returns the lateness: now minus the deadline, seconds. A deadline in the past still lets the loop run once.

        Raises:
            RuntimeError: somebody waits already.
        """
        if self._woken is not None:
            raise RuntimeError("this timer is waited for already")
        if self._fd < 0:
            self._open()
        if self._fd < 0:
            await asyncio.sleep(max(deadline_s - time.monotonic(), 0.0))
            return time.monotonic() - deadline_s
        self._woken = asyncio.get_running_loop().create_future()
        _arm(self._fd, deadline_s)
        try:
            await self._woken
        finally:
            self._woken = None
        return time.monotonic() - deadline_s

    def _expired(self) -> None:
        try:
            os.read(self._fd, 8)
        except BlockingIOError:  # A wait that was cancelled and begun anew has re-armed the timer.
            return
        if self._woken is not None and not self._woken.done():
            self._woken.set_result(None)


class TimeLimit:
    """Calls ``reached`` when a time has run out. It may be set for each of many requests, almost all of which are
    answered in time: a timer of the loop is armed again only when one has run out, not with every request.
    """

    def __init__(self, reached: Callable[[], None]) -> None:
        self._reached = reached
        self._limit_s = inf
        self._handle: asyncio.TimerHandle | None = None

    def set(self, duration_s: float) -> None:
        """From now on, in place of what was set before."""
        loop = asyncio.get_running_loop()
        self._limit_s = loop.time() + duration_s
        if self._handle is None or self._handle.when() > self._limit_s:
            self._arm(loop)

    def lift(self) -> None:
        """There is no limit any more."""
        self._limit_s = inf

    def close(self) -> None:
        """Leave nothing behind on the loop."""
        self.lift()
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None

    def _arm(self, loop: asyncio.AbstractEventLoop) -> None:
        if self._handle is not None:
            self._handle.cancel()
        self._handle = loop.call_at(self._limit_s, self._run_out)

    def _run_out(self) -> None:
        loop, self._handle = asyncio.get_running_loop(), None
        if self._limit_s == inf:
            return
        if loop.time() + LOOP_RESOLUTION_S < self._limit_s:
            self._arm(loop)
            return
        self._limit_s = inf
        self._reached()


class Heartbeat:
    """Calls ``beat`` once a period for as long as nobody puts it off. Being put off in time costs no wake-up.

    By the loop's own timers: they may be a millisecond late, which is nothing to speak of here.
    """

    def __init__(self, beat: Callable[[float], None]) -> None:
        """``beat`` is given its lateness, s; it must be quick."""
        self._beat = beat
        self._period_s = 0.0
        self._due_s = 0.0
        self._handle: asyncio.TimerHandle | None = None

    def start(self, period_s: float) -> None:
        """Beat from now on, or from now on with another period."""
        self._period_s = period_s
        self._set(asyncio.get_running_loop().time() + period_s)

    def put_off(self) -> None:
        """The next beat is due when two periods have passed: one that is late by as much is missing."""
        if self._handle is not None:
            self._set(asyncio.get_running_loop().time() + 2.0 * self._period_s)

    def stop(self) -> None:
        """No more beats."""
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None

    def _set(self, due_s: float) -> None:
        if self._handle is not None:
            self._handle.cancel()
        self._due_s = due_s
        self._handle = asyncio.get_running_loop().call_at(due_s, self._expired)

    def _expired(self) -> None:
        late_s = asyncio.get_running_loop().time() - self._due_s
        # Of the beats that have passed already only the latest is kept: a stall is not followed by a burst.
        self._set(self._due_s + self._period_s * max(1, floor(late_s / self._period_s)))
        self._beat(max(late_s - LOOP_RESOLUTION_S, 0.0))


# ---- timerfd ---------------------------------------------------------------------------------------------------------

if sys.version_info >= (3, 13):

    def _create() -> int:
        return os.timerfd_create(time.CLOCK_MONOTONIC, flags=os.TFD_NONBLOCK | os.TFD_CLOEXEC)

    def _arm(fd: int, deadline_s: float) -> None:
        os.timerfd_settime(fd, flags=os.TFD_TIMER_ABSTIME, initial=max(deadline_s, 1e-9))

else:
    _TFD_TIMER_ABSTIME = 1
    _itimerspec = struct.Struct("@4l").pack
    """Interval and first expiry, in seconds and nanoseconds each."""
    _libc = ctypes.CDLL(None, use_errno=True)
    _settime = _libc.timerfd_settime
    _settime.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.c_char_p, ctypes.c_void_p)

    def _create() -> int:
        # The flags of timerfd_create are those of open.
        fd: int = _libc.timerfd_create(time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
        if fd < 0:
            raise OSError(ctypes.get_errno(), "timerfd_create failed")
        return fd

    def _arm(fd: int, deadline_s: float) -> None:
        # A value of zero would disarm the timer.
        seconds, nanoseconds = divmod(max(round(deadline_s * 1e9), 1), 1_000_000_000)
        if _settime(fd, _TFD_TIMER_ABSTIME, _itimerspec(0, 0, seconds, nanoseconds), None) != 0:
            raise OSError(ctypes.get_errno(), "timerfd_settime failed")
