"""Telegrams on a serial line: whole ones, and of those that wait only the newest.

No write ever waits: the descriptor does not block, and what a line has not taken of a telegram is finished when it
takes more. The system would take some seconds' worth of telegrams ahead for a slow line, and each would come that much
too late; so the next one is given to it when the one before must have left, by the bits that the line carries in a
second. A port that has been unplugged has something to read for ever, which is nothing: the first such read is its end.
"""

from __future__ import annotations

import asyncio
import errno
import os
import time
from math import inf
from typing import TYPE_CHECKING, Final

from heaved.links import character_s
from heaved.outputs.senders.sender import DOWN, FIRST_PAUSE_S, SLOW, STUCK_S, explain, longer
from heaved.serial_port import close_serial, open_serial

if TYPE_CHECKING:
    from collections.abc import Callable

    import serial

    from heaved.links import SerialLink
    from heaved.outputs.output import OutputHealth

_AHEAD_S: Final = 0.002
"""By so much the next telegram may come before the line is free: a timer of the event loop is late by as much."""
_MOST_HEARD_BYTES: Final = 4096


class SerialSender:
    """See :class:`heaved.outputs.senders.sender.Sender`. What comes in (echoes) is thrown away."""

    def __init__(self, link: SerialLink, health: OutputHealth, clock: Callable[[], float] = time.monotonic) -> None:
        self._link, self._health, self._clock = link, health, clock
        self._port: serial.Serial | None = None
        self._begun = b""
        """What the line has not taken yet of a telegram."""
        self._next = b""
        self._free_s = -inf
        """When the line has sent what it was given."""
        self._timer: asyncio.TimerHandle | None = None
        self._has_writer = False
        self._moved_s = -inf
        """When the line last took something, or had nothing to take."""
        self._lost = asyncio.Event()

    @property
    def has_reader(self) -> bool:
        """Whether the port is open."""
        return self._port is not None

    def send(self, data: bytes) -> None:
        """Send a telegram as soon as the line is free, in place of one that still waits for that."""
        if self._port is None:
            self._health.lost[DOWN] += 1
            return
        if self._next:
            self._health.lost[SLOW] += 1
        self._next = data
        if self._timer is None and not self._has_writer:
            self._go_on()
        if self._begun and self._clock() - self._moved_s > STUCK_S:
            path = self._link.path
            self._health.down(f"{path} has taken nothing for {STUCK_S:g} s: plug the adapter out and in")

    async def run(self) -> None:
        """Open the port; when it is unplugged, open it anew."""
        pause_s = FIRST_PAUSE_S
        try:
            while True:
                opened_s = self._clock()
                try:
                    self._open()
                except OSError as error:
                    self._health.down(explain(self._link, error))
                else:
                    await self._lost.wait()
                if self._clock() - opened_s > STUCK_S:
                    pause_s = FIRST_PAUSE_S
                await asyncio.sleep(pause_s)
                pause_s = longer(pause_s)
        finally:
            self._close()

    def _open(self) -> None:
        self._port = open_serial(self._link)
        self._lost.clear()
        self._moved_s, self._free_s = self._clock(), -inf
        asyncio.get_running_loop().add_reader(self._port.fileno(), self._hear)

    def _close(self) -> None:
        port, self._port = self._port, None
        if port is None:
            return
        loop = asyncio.get_running_loop()
        loop.remove_reader(port.fileno())
        self._wait_for_room(port.fileno(), False)
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._begun = self._next = b""
        close_serial(port)

    def _fail(self, error: OSError) -> None:
        reason = error.strerror or str(error)
        self._health.lost.update(DOWN for telegram in (self._begun, self._next) if telegram)
        self._health.down(f"{self._link.path} has gone ({reason}): plug the adapter in, or look at its cable")
        self._close()
        self._lost.set()

    def _go_on(self) -> None:
        """Give the line as much as it takes: the rest of a telegram, then the next one once that has left."""
        self._timer = None
        while (port := self._port) is not None and (self._begun or self._next):
            now_s = self._clock()
            if not self._begun:
                wait_s = self._free_s - now_s - _AHEAD_S
                if wait_s > 0.0:
                    self._timer = asyncio.get_running_loop().call_later(wait_s, self._go_on)
                    return
                self._begun, self._next, self._moved_s = self._next, b"", now_s
                self._free_s = max(self._free_s, now_s) + len(self._begun) * character_s(self._link)
            try:
                taken = os.write(port.fileno(), self._begun)
            except (BlockingIOError, InterruptedError):
                taken = 0
            except OSError as error:
                self._fail(error)
                return
            self._begun = self._begun[taken:]
            if taken:
                self._moved_s = now_s
            if self._begun:
                self._wait_for_room(port.fileno(), True)
                return
            self._wait_for_room(port.fileno(), False)
            self._health.sent += 1
            self._health.up()

    def _wait_for_room(self, descriptor: int, wanted: bool) -> None:
        if wanted == self._has_writer:
            return
        self._has_writer = wanted
        loop = asyncio.get_running_loop()
        if wanted:
            loop.add_writer(descriptor, self._go_on)
        else:
            loop.remove_writer(descriptor)

    def _hear(self) -> None:
        if self._port is None:
            return
        try:
            if os.read(self._port.fileno(), _MOST_HEARD_BYTES):
                return
            error = OSError(errno.ENODEV, "unplugged")
        except (BlockingIOError, InterruptedError):
            return
        except OSError as failed:
            error = failed
        self._fail(error)
