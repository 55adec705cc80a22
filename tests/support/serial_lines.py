"""A serial line without hardware: two pseudo-terminals and what carries bytes between them."""

from __future__ import annotations

import asyncio
import os
import tty
from contextlib import suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


class NullModem:
    """Two ports in ``directory``, ``ours`` and ``theirs``: what is written into one comes out of the other."""

    def __init__(self, directory: Path) -> None:
        self.ours, self.theirs = directory / "ours", directory / "theirs"
        self._masters: list[int] = []
        self._slaves: list[int] = []

    def plug_in(self) -> None:
        """The ports are there."""
        for path in (self.ours, self.theirs):
            master, slave = os.openpty()
            tty.setraw(slave)
            os.set_blocking(master, False)
            path.symlink_to(os.ttyname(slave))
            # Our hold on the slave's end keeps the line up while nobody has opened it.
            self._masters.append(master)
            self._slaves.append(slave)
        one, other = self._masters
        loop = asyncio.get_running_loop()
        loop.add_reader(one, self._carry, one, other)
        loop.add_reader(other, self._carry, other, one)

    def unplug(self) -> None:
        """They go, and whoever has one open is hung up on."""
        for master in self._masters:
            asyncio.get_running_loop().remove_reader(master)
        for end in (*self._masters, *self._slaves):
            os.close(end)
        self._masters.clear()
        self._slaves.clear()
        for path in (self.ours, self.theirs):
            path.unlink(missing_ok=True)

    @staticmethod
    def _carry(source: int, target: int) -> None:
        # A line does not wait: what nobody takes is lost.
        with suppress(BlockingIOError):
            os.write(target, os.read(source, 4096))
