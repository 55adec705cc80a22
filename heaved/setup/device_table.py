"""The ``[[device]]`` table of a sensor that was found: its keys, and the TOML that says why each is as it is. Pure."""

from __future__ import annotations

import json
from math import inf, isnan
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.devices.bandwidth import LAG, PASSES, WAVES_HZ, folding, lag_ms
from heaved.devices.link import most_rate_hz, request_time_s
from heaved.devices.probe import Variant, changed
from heaved.devices.profile import Block, DeviceSpec, Field, Profile, Role, role_needs
from heaved.links import SerialLink, parse_link
from heaved.setup.sensor_record import folded_hz

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from heaved.links import Link
    from heaved.setup.polling import Measured

RATES_HZ: Final = (100.0, 80.0, 50.0, 40.0, 25.0, 20.0, 16.0, 12.5, 10.0, 8.0, 5.0, 4.0, 2.0, 1.0)
"""Worth writing, the best first."""
MOST_USEFUL_HZ: Final[dict[Role, float]] = {"imu": 100.0, "imu2": 100.0, "craft": 50.0, "crane": 10.0}
"""Polls a second that a device in that role is of use with; others:"""
USEFUL_HZ: Final = 20.0
SPARE: Final = 0.8
"""Share of the time that a line may be taken: a late answer must not cost the next poll."""
_ROLES: Final[tuple[Role, ...]] = ("imu", "laser", "imu2", "heave_sensor", "pitch_sensor")
"""In the order in which they are taken for granted."""
_CRANE: Final = {"slew_rad", "boom_rad", "jib_rad", "line_out_m"}
_MRU: Final = {"heave_m", "roll_rad", "pitch_rad"}
_CRAFT: Final = {"speed_mps", "flap_fore_rad", "flap_aft_rad"}


class Rate(msgspec.Struct, frozen=True):
    """How often to poll, and why."""

    hertz: float
    reason: str


def role_of(profile: Profile) -> Role | None:
    """What a device with such a profile is good for; None: for nothing that is known."""
    measured = {field.quantity for block in profile.blocks for field in block.fields}
    if measured & _CRAFT:
        return "craft"
    if measured & _CRANE:
        return "crane"
    if measured >= _MRU and "az_mps2" not in measured:
        return "reference_mru"
    return next((role for role in _ROLES if measured.issuperset(role_needs(role))), None)


def useful_rate_hz(role: Role) -> float:
    """Polls a second beyond which a device in that role is of no more use."""
    return MOST_USEFUL_HZ.get(role, USEFUL_HZ)


def line_share(link: Link, sharing: Sequence[tuple[Role, Profile]]) -> float:
    """Share of its useful rate that each device on a line can have, so that all together leave it some rest."""
    load = sum(useful_rate_hz(role) * request_time_s(link, profile) for role, profile in sharing)
    return min(1.0, SPARE / load) if load else 1.0


def rate(
    role: Role, link: Link, profile: Profile, bandwidth_hz: float, measured: Measured | None, share: float = 1.0
) -> Rate:
    """What the line carries and the bandwidth wants: the highest rate that is of use and leaves the line some rest, and
    of those that are twice the bandwidth or more one at which no line that was seen reads as waves. ``share``: of
    :func:`line_share`.
    """
    carries_hz = SPARE * most_rate_hz(link, profile)
    if measured is not None and measured.round_trips.answers:
        carries_hz = min(carries_hz, SPARE / measured.round_trips.median_s)
    most_hz = min(carries_hz, share * useful_rate_hz(role))
    within = [hertz for hertz in RATES_HZ if hertz <= most_hz] or [max(round(most_hz, 2), 0.01)]
    seen = seen_lines_hz(measured)
    clean = [hertz for hertz in within if hertz >= PASSES * bandwidth_hz and not reads_as_waves(seen, hertz)]
    hertz = clean[0] if clean else within[0]
    told = f"the line carries {carries_hz:.3g}" if carries_hz < inf else "as often as is of use"
    told += ", and is shared" if share < 1.0 and share * useful_rate_hz(role) < carries_hz else ""
    if hertz != within[0]:
        told += f"; at {within[0]:g} a line that was seen would read as waves"
    elif clashes := reads_as_waves(seen, hertz):
        told += f"; vibration of {', '.join(f'{line:.1f}' for line in clashes)} Hz reads as waves at that rate"
    if folds := folding(hertz, bandwidth_hz):
        told += f"; {folds}"
    return Rate(hertz, told)


def seen_lines_hz(measured: Measured | None) -> list[float]:
    """Frequencies of vibration that was seen."""
    return [line.frequency_hz for channel in measured.channels for line in channel.lines] if measured else []


def reads_as_waves(lines_hz: Sequence[float], rate_hz: float) -> list[float]:
    """Those of some frequencies that fold into the waves at a rate."""
    return [line for line in lines_hz if folded_hz(line, rate_hz) < WAVES_HZ]


def applied(variant: Variant) -> Profile:
    """The profile as the device has it: what was changed in a variant, written down."""
    if not variant.changes:
        return variant.profile
    blocks = tuple(changed(block, variant) for block in variant.profile.blocks)
    return msgspec.structs.replace(
        variant.profile,
        name=f"{variant.profile.name}-changed",
        description=f"as {variant.describe()}",
        blocks=blocks,
        # Its address may be off by one, too: nobody knows.
        bandwidth_register=None,
    )


class Table(msgspec.Struct, frozen=True, kw_only=True):
    """One ``[[device]]``, and what is said beside its keys."""

    device: DeviceSpec
    is_packaged: bool
    """The profile is one that comes with the program, and its name is enough."""
    heading: str
    """What it is, and where it was found."""
    rate_reason: str = ""
    timeout_reason: str = ""
    doubt: str = ""


def table(
    *,
    name: str,
    role: Role,
    link: str,
    device_id: int,
    variant: Variant,
    heading: str,
    doubt: str = "",
    rate_hz: float | None = None,
    set_bandwidth_hz: float = 0.0,
    measured: Measured | None = None,
    share: float = 1.0,
) -> Table:
    """The table of a sensor that was found.

    ``rate_hz``: as the user wants it; None: what suits line and bandwidth. ``set_bandwidth_hz``: what its register
    says, 0: nothing. ``share``: of :func:`line_share`.
    """
    profile = applied(variant)
    bandwidth = set_bandwidth_hz or profile.bandwidth_hz
    chosen = rate(role, parse_link(link), profile, bandwidth, measured, share)
    if rate_hz is not None:
        folds = folding(rate_hz, bandwidth)
        chosen = Rate(rate_hz, f"as asked for; {folds}" if folds else "as asked for")
    trips = measured.round_trips if measured is not None else None
    timeout_ms, told = 50.0, ""
    if trips is not None and not isnan(trips.timeout_ms):
        timeout_ms = trips.timeout_ms
        told = f"answers: median {_ms(trips.median_s)}, 95 % {_ms(trips.p95_s)}, slowest {_ms(trips.worst_s)} ms"
    device = DeviceSpec(
        name=name,
        role=role,
        link=link,
        device_id=device_id,
        profile=profile,
        rate_hz=chosen.hertz,
        timeout_ms=timeout_ms,
        latency_ms=-round(lag_ms(bandwidth), 1) if bandwidth and role in ("imu", "imu2") else 0.0,
        bandwidth_hz=set_bandwidth_hz if set_bandwidth_hz != profile.bandwidth_hz else 0.0,
    )
    return Table(
        device=device,
        is_packaged=not variant.changes,
        heading=heading,
        rate_reason=chosen.reason,
        timeout_reason=told,
        doubt=doubt,
    )


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g}"


# ---- TOML ------------------------------------------------------------------------------------------------------------


def toml(found: Table) -> str:
    """The table as it is written, with a line end after each line."""
    return "".join(f"{line}\n" for line in _lines(found))


def _lines(found: Table) -> Iterator[str]:
    device = found.device
    yield f"# {found.heading}"
    if found.doubt:
        yield f"# Not proved: {found.doubt}."
    yield "[[device]]"
    yield f"name = {_text(device.name)}"
    yield f"role = {_text(device.role)}"
    yield f"link = {_text(device.link)}"
    yield f"device_id = {device.device_id}"
    if found.is_packaged:
        yield f"profile = {_text(device.profile.name)}"
    yield _key("rate_hz", device.rate_hz, found.rate_reason)
    yield _key("timeout_ms", device.timeout_ms, found.timeout_reason)
    if device.latency_ms:
        hertz = device.bandwidth_hz or device.profile.bandwidth_hz
        reason = (
            f"lag of a low-pass of {hertz:g} Hz, {LAG:g} / bandwidth; the laser finds what else is constant of its age"
        )
        yield _key("latency_ms", device.latency_ms, reason)
    if device.bandwidth_hz:
        yield _key("bandwidth_hz", device.bandwidth_hz, "as its register says")
    if not found.is_packaged:
        yield from profile_lines(device.profile)


def _key(name: str, value: float, comment: str) -> str:
    return f"{name} = {float(value)!r}" + (f"  # {comment}" if comment else "")


def profile_lines(profile: Profile, notes: Sequence[str] = ()) -> Iterator[str]:
    """``[device.profile]`` with all that the profile says; ``notes`` stand above it as comments."""
    yield ""
    yield from (f"# {note}" for note in notes)
    yield "[device.profile]"
    yield f"name = {_text(profile.name)}"
    if profile.description:
        yield f"description = {_text(profile.description)}"
    if profile.bandwidth_hz:
        yield f"bandwidth_hz = {profile.bandwidth_hz!r}"
    if profile.bandwidth_register is not None:
        register = profile.bandwidth_register
        choices = ", ".join(f"{float(choice)!r}" for choice in register.choices_hz)
        yield f"bandwidth_register = {{ address = 0x{register.address:02X}, choices_hz = [{choices}] }}"
    for block in profile.blocks:
        yield from _block_lines(block)


def _block_lines(block: Block) -> Iterator[str]:
    yield ""
    yield "[[device.profile.blocks]]"
    yield f"function = {_text(block.function)}"
    yield f"start = 0x{block.start:02X}"
    yield "fields = ["
    yield from (f"  {field_toml(field)}," for field in block.fields)
    yield "]"


def field_toml(field: Field) -> str:
    """One field as an inline table: quantity, offset and type, and what differs from the defaults."""
    usual = Field(quantity=field.quantity, offset=field.offset)
    keys = {name: getattr(field, name) for name in Field.__struct_fields__}
    kept = {
        name: value
        for name, value in keys.items()
        if name in ("quantity", "offset", "type", "unit") or value != getattr(usual, name)
    }
    return "{ " + ", ".join(f"{name} = {_value(value)}" for name, value in kept.items()) + " }"


def _value(value: object) -> str:
    return _text(value) if isinstance(value, str) else repr(value)


def _text(text: str) -> str:
    """A basic string of TOML, whose escapes are those of JSON."""
    return json.dumps(text, ensure_ascii=False)


def link_text(link: Link, path: str = "") -> str:
    """A link as a configuration has it. ``path``: what the port is called for good."""
    if not isinstance(link, SerialLink):
        return str(link)
    options = f"?baudrate={link.baudrate}&parity={link.parity}"
    if link.stopbits != SerialLink("").stopbits:
        options += f"&stopbits={link.stopbits}"
    lasting = f"rtu://{path or link.path}{options}"
    try:
        is_sound = parse_link(lasting) == msgspec.structs.replace(link, path=path or link.path)
    except ValueError:
        is_sound = False
    return lasting if is_sound else f"rtu://{link.path}{options}"
