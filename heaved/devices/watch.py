"""Judging a device by its answers over time: frozen values, a frozen clock, a slave that has fallen silent. Pure."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from enum import Enum
from math import inf

from heaved.devices.profile import DeviceSpec, Quantity, role_quantities, si_step
from heaved.samples import Fault

STALE_AFTER_S = 0.5
"""A device clock that stands for longer than this is a fault, unless its resolution or the poll rate is coarser."""

SILENT_AFTER_POLLS = 3
SILENT_AFTER_S = 0.5
"""A slave is silent when it has missed that many polls and not answered for that long."""

PROBE_S = 0.5
"""A silent slave is asked at most this often; no answer comes later than this after its request."""


class Unchanged:
    """For how long something has been the same."""

    def __init__(self, limit_s: float) -> None:
        self.limit_s = limit_s
        self._content: Hashable = None
        self._since_s = inf

    def too_long(self, content: Hashable, t_s: float) -> float:
        """Seconds without a change once they exceed the limit, else 0."""
        if content != self._content:
            self._content = content
            self._since_s = t_s
        stood_s = t_s - self._since_s
        return stood_s if stood_s > self.limit_s else 0.0


class DeviceWatch:
    """Whether what a device says is alive.

    Measurements that stay identical to the last bit for longer than ``stuck_after_s`` are stuck (0: never judged): a
    living sensor has noise. A device that sends its own clock is stale when that clock stands. Neither is forgotten
    over a lost connection: a gateway that serves its memory is found out at once.
    """

    def __init__(self, device: DeviceSpec) -> None:
        wanted = role_quantities(device.role)
        fields = [field for block in device.profile.blocks for field in block.fields]
        self._blocks = [
            tuple(field.quantity for field in block.fields if field.quantity in wanted)
            for block in device.profile.blocks
        ]
        self._values = [Unchanged(device.stuck_after_s or inf) for _ in self._blocks]
        step_s = max((si_step(field) for field in fields if field.quantity == "device_time_s"), default=0.0)
        # Two steps and a half: a clock that ticks as coarsely as it is read may show the same time twice.
        self._clock = Unchanged(max(STALE_AFTER_S, 2.5 / device.rate_hz, 2.5 * step_s))

    def judge(self, values: Mapping[Quantity, float], t_s: float) -> tuple[Fault, str]:
        """``values``: of all blocks of one poll, SI units. Returns the fault and what to say about it."""
        device_time_s = values.get("device_time_s")
        if device_time_s is not None and (stood_s := self._clock.too_long(device_time_s, t_s)):
            return Fault.STALE, f"the device's clock has stood at {device_time_s:.6g} s for {stood_s:.1f} s: restart it"
        for names, unchanged in zip(self._blocks, self._values, strict=True):
            if names and (stood_s := unchanged.too_long(tuple(values[name] for name in names), t_s)):
                hint = "restart the sensor, or raise stuck_after_s if it may stand still"
                return Fault.STUCK, f"{', '.join(names)} have not changed for {stood_s:.1f} s: {hint}"
        return Fault.NONE, ""


class Ask(Enum):
    """What may be asked of a slave."""

    READ = 1
    """Its registers."""
    RESYNC = 2
    """First a read of another length, whose answer proves that no older one is under way; then its registers."""
    NOTHING = 3
    """It is left alone for now."""


class Contact:
    """Whether an answer of this slave can be told from a late one, and whether asking it is worth the line's time.

    On a serial line nothing but id, function and length ties an answer to its request. After a request that was not
    answered (and on a line just opened, where somebody else may have asked) an answer may still be under way; it is
    taken for the next one if the next request looks the same. So the slave is first asked for a number of registers
    that no request under way asks for: slaves answer in order, hence nothing older can follow that answer. When no
    such number is left, or the slave refuses it, it is left alone until any late answer must have come.

    A silent slave would take the time of its neighbours with its timeouts, so it is asked rarely until it answers.

    Args:
        numbered: answers carry the number of their request (TCP).
        resync_counts: numbers of registers that tell a resynchronising read from the regular ones; may be empty.
        alone: no other slave on the bus.
        timeout_s: of one read.
        opened_s: when the line was opened.
    """

    def __init__(
        self, *, numbered: bool, resync_counts: Sequence[int], alone: bool, timeout_s: float, opened_s: float
    ) -> None:
        self._resync_counts = resync_counts
        # Not always the same first: the answer to a resynchronising read of an earlier run may be under way.
        self._turn = int(opened_s * 1e3)
        self._pending: set[int] = set()
        """Lengths of the requests that may be under way."""
        self._numbered = numbered
        self._refuses_resync = False
        self._rests = not (numbered and alone)
        self._quiet_s = max(PROBE_S, 2.0 * timeout_s)
        self._misses = 0
        self._certain = numbered
        self._asked_s = opened_s
        self._answered_s = opened_s

    def ask(self, now_s: float) -> Ask:
        quiet = now_s - self._asked_s >= self._quiet_s
        if quiet:
            self._pending.clear()
        elif self._rests and self.silent(now_s):
            return Ask.NOTHING
        if self._certain:
            return Ask.READ
        # Every other probe of a silent slave is a plain read: some slaves answer nothing but their usual length.
        plain = self._refuses_resync or (self.silent(now_s) and self._misses % 2 == 0)
        if self._free() and not plain:
            return Ask.RESYNC
        return Ask.READ if quiet else Ask.NOTHING

    def _free(self) -> list[int]:
        return [count for count in self._resync_counts if count not in self._pending]

    def resync_count(self) -> int:
        """Registers to ask for in the next resynchronising read; call it only when that is what may be asked."""
        free = self._free()
        self._turn += 1
        return free[self._turn % len(free)]

    def silent(self, now_s: float) -> bool:
        return self._misses >= SILENT_AFTER_POLLS and now_s - self._answered_s >= SILENT_AFTER_S

    def answered(self, now_s: float) -> None:
        """The registers came that were asked for last."""
        self._misses = 0
        self._certain = True
        self._refuses_resync = False
        self._pending.clear()
        self._asked_s = self._answered_s = now_s

    def refused(self, now_s: float, count: int) -> None:
        """An exception came. It carries no length: it may answer any request under way, so it proves nothing."""
        self._misses = 0
        self._certain = self._numbered
        self._refuses_resync = count in self._resync_counts
        self._pending.add(count)
        self._asked_s = self._answered_s = now_s

    def missed(self, now_s: float, count: int) -> None:
        """It was asked for ``count`` registers, and no valid answer came in time."""
        self._misses += 1
        self._certain = self._numbered
        self._asked_s = now_s
        self._pending.add(count)

    def reopened(self, now_s: float) -> None:
        """The line is new: somebody else's answer may be under way."""
        self._misses = 0
        self._certain = self._numbered
        self._asked_s = now_s
