"""One device on a bus: from the values of a poll, or from the lack of them, to a result. Pure."""

from __future__ import annotations

from math import isnan, nan
from typing import TYPE_CHECKING, Any, Final

import msgspec

from heaved.devices.link import request_wire_s
from heaved.devices.liveness import Contact, LivenessCheck
from heaved.devices.mounting import mounting_of
from heaved.devices.profile import (
    Block,
    BlockCodec,
    DeviceSpec,
    Quantity,
    Role,
    block_registers,
    field_registers,
    role_needs,
    role_quantities,
)
from heaved.devices.timer import Pace
from heaved.samples import CraftSample, CraneSample, Fault, ImuSample, LaserSample, MruSample, RatesSample, Sample

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from heaved.links import Link

KINDS: Final[dict[Role, Callable[..., Sample]]] = {
    "imu": ImuSample,
    "laser": LaserSample,
    "imu2": RatesSample,
    "craft": CraftSample,
    "heave_sensor": CraftSample,
    "pitch_sensor": CraftSample,
    "crane": CraneSample,
    "reference_mru": MruSample,
}
"""The samples by the role of the device."""

_NOT_ASKED_YET: Final = (
    Fault.TIMEOUT,
    "not asked yet: waiting until no answer to an earlier request can be under way",
)


class PollResult(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """What came of one deadline of one device."""

    device: str
    role: Role
    due_s: float
    sent_s: float
    """When the request for the measurement was handed to the line; nan if nothing was asked."""
    duration_s: float
    """From turning to the device to being done with it, timeouts and resynchronising reads included."""
    lateness_s: float
    """From the deadline to turning to the device: the timer's lateness, or a neighbour on the bus."""
    skipped: int
    """Deadlines of this device that passed unserved since its last result."""
    sample: Sample
    """``t_s``: the moment at which the slave had heard the request (on a serial line, its wire time after ``sent_s``),
    plus the device's latency; without a request, the deadline plus the latency. Values only if there is no fault."""
    fault: Fault
    detail: str
    """What, where, what to do; empty when well."""
    extra: dict[Quantity, float]
    """Temperature, signal, device time: what accompanies the measurement, SI units."""
    reconnected: bool
    """First good answer over a new connection, after an earlier one was lost."""


class Reading(msgspec.Struct, frozen=True):
    """The values of one device from one poll, or why there are none."""

    sent_s: float = nan
    values: dict[Quantity, float] = {}
    fault: Fault = Fault.NONE
    detail: str = ""


class Station:
    """One device on the bus: its compiled profile and what is remembered of it."""

    def __init__(self, spec: DeviceSpec, link: Link, contact: Contact, start_s: float) -> None:
        self.spec = spec
        self.codecs = [BlockCodec(block) for block in spec.profile.blocks]
        self.pace = Pace(1.0 / spec.rate_hz, start_s)
        self.contact = contact
        self._liveness = LivenessCheck(spec)
        self._mounting = mounting_of(spec)
        self._wanted = frozenset(role_quantities(spec.role))
        self.cuts = [cuts(block) for block in spec.profile.blocks]
        self.main, self.dating = _dated_by(spec)
        self._place = f"{spec.name} ({link}, id {spec.device_id})"
        self.timeout_s = spec.timeout_ms * 1e-3
        self._latency_s = spec.latency_ms * 1e-3
        self._wire_s = request_wire_s(link)
        self._skipped = 0
        self._connection_number = 0
        """Of the last good answer."""
        self.last_fault, self.last_detail = _NOT_ASKED_YET

    def reopened(self) -> None:
        """The line is new: what was said of the device is of the past."""
        self.last_fault, self.last_detail = _NOT_ASKED_YET

    def failed(self, sent_s: float, fault: Fault, detail: str) -> Reading:
        """The reading after a read that failed; while the device is left alone, the same is said of it."""
        if fault is not Fault.DISCONNECTED:  # then there will be a new line, of which it says nothing
            self.last_fault, self.last_detail = fault, detail
        return Reading(sent_s, fault=fault, detail=detail)

    def result(
        self, reading: Reading, due_s: float, turned_s: float, done_s: float, connection_number: int
    ) -> PollResult:
        """Judges one poll, and goes on to the next deadline.

        Args:
            due_s: the deadline.
            turned_s: when the bus turned to the device.
            done_s: when it was done with it.
            connection_number: counts the connections that the bus has had.
        """
        skipped, self._skipped = self._skipped, self.pace.advance(done_s)
        heard_s = due_s if isnan(reading.sent_s) else reading.sent_s + self._wire_s
        t_s = heard_s + self._latency_s
        fault, detail = reading.fault, reading.detail
        if fault is Fault.NONE:
            fault, detail = self._liveness.judge(reading.values, t_s)
        reconnected = False
        if fault is Fault.NONE:
            reconnected = 0 < self._connection_number < connection_number
            self._connection_number = connection_number
        return PollResult(
            device=self.spec.name,
            role=self.spec.role,
            due_s=due_s,
            sent_s=reading.sent_s,
            duration_s=done_s - turned_s,
            lateness_s=turned_s - due_s,
            skipped=skipped,
            sample=self._sample(t_s, reading.values, fault),
            fault=fault,
            detail=f"{self._place}: {detail}" if detail else "",
            extra={name: value for name, value in reading.values.items() if name not in self._wanted},
            reconnected=reconnected,
        )

    def _sample(self, t_s: float, values: Mapping[Quantity, float], fault: Fault) -> Sample:
        kind = KINDS[self.spec.role]
        if fault is not Fault.NONE:
            return kind(t_s=t_s, fault=fault)
        if self._mounting is not None:
            values = self._mounting.turn(values)
        measured: dict[str, Any] = {name: value for name, value in values.items() if name in self._wanted}
        return kind(t_s=t_s, **measured)


def _dated_by(spec: DeviceSpec) -> tuple[int, int]:
    """The block whose request dates the sample, and the register in it: of what the role needs first (the vertical
    acceleration, the laser, a rate), else of the first that is anything of the device's role.
    """
    for names in (set(role_needs(spec.role)[:1]), set(role_quantities(spec.role))):
        for number, block in enumerate(spec.profile.blocks):
            offsets = [field.offset for field in block.fields if field.quantity in names]
            if offsets:
                return number, offsets[0]
    raise ValueError(f"device {spec.name}: profile {spec.profile.name} carries nothing for the role {spec.role}")


def cuts(block: Block) -> tuple[int, ...]:
    """Where a block may be divided into reads of its own without tearing a value apart, in order."""
    inside = {field.offset + part for field in block.fields for part in range(1, field_registers(field))}
    return tuple(cut for cut in range(1, block_registers(block)) if cut not in inside)
