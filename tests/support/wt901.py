"""A WitMotion WT901C485 on its side of the line, by its manual: registers, and the noise of one that lies still."""

from __future__ import annotations

import random
import time
from typing import TYPE_CHECKING

from modbus_slaves import rtu, rtu_answer

if TYPE_CHECKING:
    from collections.abc import Callable


class Wt901:
    """Answers a serial read request; it measures ``measures_hz`` times a second, 0: with each request."""

    def __init__(self, device_id: int = 80, measures_hz: float = 0.0, bandwidth: int = 4) -> None:
        self.device_id, self._measures_hz, self._bandwidth = device_id, measures_hz, bandwidth
        self._chance = random.Random(1)
        self._tick = -1
        self._now: list[int] = []
        self.hears: Callable[[], object] = lambda: None

    def __call__(self, request: bytes) -> bytes:
        """The answer to a whole request of eight bytes."""
        self.hears()
        if request[0] != self.device_id:
            return b""
        first, count = int.from_bytes(request[2:4]), int.from_bytes(request[4:6])
        if request[1] != 3 or first + count > 0x60:
            return rtu(bytes((request[0], request[1] | 0x80, 2 if request[1] == 3 else 1)))
        return rtu_answer(request, self._registers()[first : first + count])

    def _registers(self) -> list[int]:
        """0x34..0x3F: 2048 to the g, 182 to the degree; 0x1F the number of its bandwidth."""
        tick = int(time.monotonic() * self._measures_hz) if self._measures_hz else self._tick + 1
        if tick != self._tick:
            self._tick = tick
            level = (0, 0, 2048, 0, 0, 0, 0, 0, 0, 364, -182, 91)
            noise = [round(self._chance.gauss(0.0, 4.0)) if i < 6 else 0 for i in range(12)]
            self._now = [(value + off) & 0xFFFF for value, off in zip(level, noise, strict=True)]
        registers = [0] * 0x60
        registers[0x1F] = self._bandwidth
        registers[0x34:0x40] = self._now
        return registers
