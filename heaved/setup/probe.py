"""From a line of which little is known to a ``[[device]]`` table: who is there, what it is, how well it measures."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Sequence
from math import inf
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.devices.probe import Device, ReopenedLine, Variant, probe
from heaved.devices.profile import Block, Field, Profile, Role
from heaved.devices.timer import DeadlineTimer
from heaved.links import Link, SerialLink
from heaved.setup.adapters import explain, stable_path
from heaved.setup.device_table import Table, applied, line_share, link_text, role_of, table
from heaved.setup.polling import Measured, Polls, measured, poll
from heaved.setup.probe_report import Examined
from heaved.setup.survey import Survey, skeleton, survey

if TYPE_CHECKING:
    from heaved.setup.live import View

_FEWEST_POLLS: Final = 2

Tell = Callable[[float, float, str], None]
"""Told how far it is, of how far at the most, and what is done now."""


class Wishes(msgspec.Struct, frozen=True, kw_only=True):
    """What the user wants."""

    ids: tuple[int, ...]
    timeout_s: float
    seconds: float
    """Of measuring; 0: none."""
    rate_hz: float | None = None
    """At which to poll later; None: what suits."""
    name: str = ""
    """Of the device; empty: its role."""
    role: Role | None = None
    """None: what its profile is good for."""
    registers: tuple[int, int] = (0, 255)
    """First and last that are looked for of a device that no profile fits."""


async def examine_line(
    link: Link,
    wishes: Wishes,
    profiles: Sequence[Profile],
    taken_names: Collection[str],
    tell: Tell,
    found: Callable[[Examined], None],
) -> list[str]:
    """Everybody on a line; ``found`` is told of each as soon as all is known of it. Returns hints: why there may be
    more, and how to find it.

    Raises:
        ConnectionError: the line cannot be opened, or was lost before anybody answered; says why and what to do.
    """
    asked = 0

    def asking(device_id: int) -> None:
        nonlocal asked
        tell(asked, len(wishes.ids), f"asking id {device_id}")
        asked += 1

    try:
        report = await probe(link, wishes.ids, profiles, wishes.timeout_s, asking)
    except ConnectionError as error:
        raise ConnectionError(explain(link, str(error))) from error
    hints, names = report.hints, set(taken_names)  # Its own: the caller's may grow meanwhile.
    share = _share(link, report.devices)
    for device in report.devices:
        examined = await _examine(device, link, wishes, names, share, tell)
        if examined.table is not None:
            names.add(examined.table.device.name)
        found(examined)
    return hints


def _share(link: Link, devices: Sequence[Device]) -> float:
    """Of its useful rate that each of those that are known can have."""
    profiles = [applied(device.findings[0].variant) for device in devices if device.findings]
    return line_share(link, [(role, profile) for profile in profiles if (role := role_of(profile)) is not None])


async def _examine(
    device: Device, link: Link, wishes: Wishes, names: Collection[str], share: float, tell: Tell
) -> Examined:
    if not device.findings:
        return await _examine_unknown(device, link, wishes, names, tell)
    best = device.findings[0]
    profile = applied(best.variant)
    bandwidth_hz = device.bandwidth.hertz if device.bandwidth is not None else 0.0
    told: tuple[str, ...] = ()
    shown: Measured | None = None
    if wishes.seconds > 0.0:
        polls, told = await _measure(device, link, profile, wishes, tell)
        if len(polls.sent_s) >= _FEWEST_POLLS:
            shown = measured(polls, profile, link, bandwidth_hz)
    role = wishes.role or role_of(profile)
    if role is None:
        return Examined(
            device=device, measured=shown, notes=(*told, "no role suits what it measures: give one (--role)")
        )
    is_read = device.bandwidth is not None and device.bandwidth.is_read
    return Examined(
        device=device,
        measured=shown,
        notes=told,
        table=_table(
            device, link, wishes, names, role, best.variant, doubt=best.doubt, shown=shown,
            set_bandwidth_hz=bandwidth_hz if is_read else 0.0, share=share,
        ),
    )  # fmt: skip


async def _measure(
    device: Device, link: Link, profile: Profile, wishes: Wishes, tell: Tell
) -> tuple[Polls, tuple[str, ...]]:
    """A burst of polls; the user may cut it short, and the line may fail: what there is is told."""
    polls, what = Polls(), f"measuring id {device.device_id} ({profile.name})"
    try:
        await poll(
            polls, link, device.device_id, profile.blocks, seconds=wishes.seconds, timeout_s=wishes.timeout_s,
            progress=lambda done_s: tell(done_s, wishes.seconds, what),
        )  # fmt: skip
    except asyncio.CancelledError:
        _go_on()
        return polls, ("cut short by Ctrl-C",)
    except ConnectionError as error:
        return polls, (f"the measuring ended early: {explain(link, str(error))}",)
    return polls, ()


def _go_on() -> None:
    """Ctrl-C has ended what was being done, not what comes after it."""
    task = asyncio.current_task()
    if task is not None:
        task.uncancel()


async def _examine_unknown(device: Device, link: Link, wishes: Wishes, names: Collection[str], tell: Tell) -> Examined:
    try:
        seen = await _survey(device.device_id, link, wishes, tell)
    except ConnectionError as error:
        return Examined(device=device, notes=(f"the line was lost: {explain(link, str(error))}",))
    profile = skeleton(seen, f"unknown-id-{device.device_id}")
    if profile is None:
        return Examined(device=device, survey=seen)
    variant = Variant(profile=profile)
    role = wishes.role or role_of(profile)
    if role is None:
        return Examined(device=device, survey=seen)
    doubt = "the profile is guessed from gravity alone; axes, signs and scale are yours to check (--live)"
    found = _table(device, link, wishes, names, role, variant, doubt=doubt, shown=None, set_bandwidth_hz=0.0, share=1.0)
    return Examined(device=device, survey=seen, table=msgspec.structs.replace(found, is_packaged=False))


async def _survey(device_id: int, link: Link, wishes: Wishes, tell: Tell) -> Survey:
    with DeadlineTimer() as timer:
        line = ReopenedLine(link, timer)
        try:
            await line.open()
            first, last = wishes.registers
            return await survey(
                line, device_id, wishes.timeout_s, lambda what: tell(0.0, inf, what), first=first, last=last
            )
        finally:
            line.close()


def _table(
    device: Device,
    link: Link,
    wishes: Wishes,
    names: Collection[str],
    role: Role,
    variant: Variant,
    *,
    doubt: str,
    shown: Measured | None,
    set_bandwidth_hz: float,
    share: float,
) -> Table:
    lasting = stable_path(link.path) if isinstance(link, SerialLink) else ""
    return table(
        name=_free_name(wishes.name or role, names),
        role=role,
        link=link_text(link, lasting),
        device_id=device.device_id,
        variant=variant,
        heading=f"Found by heaved probe: id {device.device_id} on {link}, {variant.describe()}",
        doubt=doubt,
        rate_hz=wishes.rate_hz,
        set_bandwidth_hz=set_bandwidth_hz,
        measured=shown,
        share=share,
    )


def _free_name(wanted: str, taken: Collection[str]) -> str:
    number, name = 1, wanted
    while name in taken:
        number += 1
        name = f"{wanted}-{number}"
    return name


# ---- live ------------------------------------------------------------------------------------------------------------


def live_profile(examined: Examined) -> Profile | None:
    """What is shown live of a device: its profile, or the registers that were found; None: there are none."""
    if examined.device.findings:
        return applied(examined.device.findings[0].variant)
    if examined.survey is None or not examined.survey.seen:
        return None
    if examined.table is not None:
        return examined.table.device.profile
    blocks: list[Block] = []
    for one in examined.survey.seen:
        last = blocks[-1] if blocks else None
        end = last.start + last.fields[0].offset + 1 if last is not None else -1
        if last is not None and last.function == one.function and end == one.address and end - last.start < 100:
            field = Field(quantity="signal", offset=end - last.start, type="uint16")
            blocks[-1] = Block(function=last.function, start=last.start, fields=(field,))
        else:
            field = Field(quantity="signal", offset=0, type="uint16")
            blocks.append(Block(function=one.function, start=one.address, fields=(field,)))
    return Profile(name="unknown", blocks=tuple(blocks))


async def watch(view: View, link: Link, device_id: int, wishes: Wishes, push: Callable[[Polls], None]) -> None:
    """Poll for ever, and hand everything to the screen, until the user ends it.

    Raises:
        ConnectionError: the line was lost; says why and what to do.
    """
    try:
        await poll(
            Polls(), link, device_id, view.profile.blocks, seconds=inf, timeout_s=wishes.timeout_s,
            rate_hz=wishes.rate_hz, each=push, most_lost=inf,
        )  # fmt: skip
    except asyncio.CancelledError:
        _go_on()
    except ConnectionError as error:
        raise ConnectionError(explain(link, str(error))) from error
