"""A serial slave that understands only one setting of the line, as real ones do; a pty carries bytes at any.

A pty forgets whether there is parity (the kernel clears PARENB) but not which: E and N look alike here, O does not.
"""

from __future__ import annotations

import asyncio
import os
import termios
import tty
from typing import TYPE_CHECKING

from modbus_slaves import crc

if TYPE_CHECKING:
    from collections.abc import Callable

SPEEDS = {2400: termios.B2400, 9600: termios.B9600, 19200: termios.B19200, 115200: termios.B115200}


class PickySlave:
    """``answer`` gets each whole request that came with the right setting, ``babble`` each piece that came with
    another; both return what to send. Keeps every byte that it was sent.
    """

    def __init__(
        self, baudrate: int, answer: Callable[[bytes], bytes], babble: Callable[[bytes], bytes] = lambda data: b"",
        *, odd: bool = False,
    ) -> None:  # fmt: skip
        self._speed, self._odd = SPEEDS[baudrate], odd
        self._answer, self._babble = answer, babble
        self.requests: list[bytes] = []
        self.all_heard = b""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        asyncio.get_running_loop().add_reader(self._master, self._readable)

    @property
    def is_understood(self) -> bool:
        _, _, flags, _, speed, _, _ = termios.tcgetattr(self._slave)
        return speed == self._speed and bool(flags & termios.PARODD) == self._odd

    def _readable(self) -> None:
        data = os.read(self._master, 4096)
        self.all_heard += data
        if not self.is_understood:
            self.say(self._babble(data))
            return
        for start in range(0, len(data) - 7, 8):
            request = data[start : start + 8]
            assert crc(request[:6]) == request[6:]
            self.requests.append(request)
            self.say(self._answer(request))

    def say(self, data: bytes) -> None:
        if data:
            os.write(self._master, data)

    def unplug(self) -> None:
        """The adapter goes; whoever has it open is hung up on."""
        asyncio.get_running_loop().remove_reader(self._master)
        os.close(self._master)

    def close(self) -> None:
        self.unplug()
        os.close(self._slave)
