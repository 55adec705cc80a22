"""What ``heaved probe`` says of adapters, of devices and of what was measured: for people and for scripts. Pure."""

from __future__ import annotations

from math import degrees, inf, isfinite, isnan, pi
from typing import TYPE_CHECKING, Any, Final

import msgspec

from heaved.devices.bandwidth import WAVES_HZ
from heaved.devices.probe import Device, device_lines
from heaved.estimation.heave.params import Params
from heaved.setup import survey as surveying
from heaved.setup.device_table import Table, toml
from heaved.setup.polling import ACCELERATIONS, Channel, Measured
from heaved.setup.sensor_record import folded_hz, record_to_see_s
from heaved.setup.survey import Survey
from heaved.text import printable

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from heaved.setup.adapters import Adapter

INDENT: Final = " " * 8
_USUAL_WALK: Final = Params().sea.bias_walk_mps2_rts
"""Of which the daemon sets out."""
_STANDS_HZ: Final = 0.02
"""What folds to less is no wave but a bias."""


class Examined(msgspec.Struct, frozen=True, kw_only=True):
    """All that was found out of one device."""

    device: Device
    measured: Measured | None = None
    survey: Survey | None = None
    """Of one that no profile fits."""
    table: Table | None = None
    notes: tuple[str, ...] = ()


def adapter_lines(found: Sequence[Adapter]) -> Iterator[str]:
    """The adapters of this machine."""
    for adapter in found:
        told = [adapter.name, f"by {adapter.maker}" if adapter.maker else ""]
        told += [f"serial number {printable(adapter.serial_number)}" if adapter.serial_number else ""]
        yield f"{adapter.path}  {', '.join(filter(None, told)) or 'says nothing of itself'}"
        if adapter.stable_path != adapter.path:
            yield f"    write it as {adapter.stable_path}, which stays"
        if adapter.refusal:
            yield f"    {adapter.refusal}"
        if adapter.held_by:
            yield f"    in use: {', '.join(adapter.held_by)}"


def lines(found: Examined, rate_hz: float) -> Iterator[str]:
    """What was found out of a device. ``rate_hz``: at which it will be polled."""
    yield from device_lines(found.device)
    if found.measured is not None:
        yield from measured_lines(found.measured, rate_hz)
    if found.survey is not None:
        yield from (f"  {note}" for note in surveying.notes(found.survey))
    yield from (f"  {note}" for note in found.notes)
    if found.table is not None:
        yield ""
        yield from toml(found.table).splitlines()


def measured_lines(measured: Measured, rate_hz: float) -> Iterator[str]:
    """What a burst of polls showed."""
    for line in (
        f"measured for {measured.seconds:.3g} s, as fast as the line goes:",
        f"  {_pace(measured)}",
        f"  {_answers(measured)}",
        f"  {_age(measured)}",
        *(f"  {line}" for line in _noise(measured)),
        *(f"  {line}" for line in _vibration(measured, rate_hz)),
    ):
        yield INDENT + line


def _pace(measured: Measured) -> str:
    pace = measured.pace
    if isnan(pace.polls_hz):
        return "too few answers to say how often it measures"
    told = f"{pace.polls_hz:.1f} polls a second, {pace.new_hz:.1f} new values a second: "
    match pace.kind:
        case "every poll":
            return told + "it measures at least so often"
        case "clock":
            return told + f"it measures every {1e3 / pace.new_hz:.3g} ms, and repeats itself in between"
        case "by chance":
            return told + "they repeat by chance, as coarse registers do: how often it measures does not show"
    return told + "too few to say how often it measures: move it, or take longer (--seconds)"


def _answers(measured: Measured) -> str:
    trips = measured.round_trips
    if not trips.answers:
        return f"no answer to any of {trips.lost} polls"
    median, p95, worst, wire = (1e3 * s for s in (trips.median_s, trips.p95_s, trips.worst_s, measured.wire_s))
    told = f"answers after {median:.1f} ms (median), {p95:.1f} (95 %), {worst:.1f} (slowest)"
    told += f", of which the line takes {wire:.1f}" if wire else ""
    lost = f"; {trips.lost} of {trips.answers + trips.lost} lost" if trips.lost else "; none lost"
    return f"{told}{lost}: timeout_ms {trips.timeout_ms:g}"


def _age(measured: Measured) -> str:
    if isnan(measured.age_spread_s):
        return "how old an answer is, no poll can say (the device tells no time): the manual does, or a laser finds it"
    return (
        f"by the device's clock the age of an answer varies by {1e3 * measured.age_spread_s:.1f} ms; what is constant "
        "of it, no poll can say: the manual does, or a laser finds it"
    )


def _noise(measured: Measured) -> Iterator[str]:
    told = [_channel_noise(channel) for channel in measured.channels if not isnan(channel.noise.density)]
    if not measured.channels:
        return
    if not told:
        yield "noise: too few or too slow values to say"
        return
    yield f"white noise: {', '.join(told)}"
    rounded = [
        _short(c.quantity) for c in measured.channels if c.noise.steps > 0.7 * c.noise.density and c.noise.density > 0.0
    ]
    if rounded:
        yield f"  of {', '.join(rounded)} that is the rounding of the register: its own is less"
    accelerations = [channel.noise for channel in measured.channels if channel.quantity in ACCELERATIONS]
    if not accelerations:
        return
    densities = [noise.density for noise in accelerations if noise.density > 0.0]
    needs_s = record_to_see_s(_USUAL_WALK, max(densities)) if densities else inf
    longer = f"to see the usual {_USUAL_WALK:g} takes {_long(needs_s)} of a sensor that lies still (--seconds)"
    walks = [noise.walk for noise in accelerations if not isnan(noise.walk)]
    if any(noise.is_moved for noise in accelerations):
        yield f"walk of the bias: does not show, for the sensor is moved; {longer}"
    elif walks:
        yield f"walk of the bias: up to {max(walks):.2g} m/s2/sqrt(s), if nothing moved it meanwhile"
    else:
        limits = [noise.walk_limit for noise in accelerations if not isnan(noise.walk_limit)]
        if limits:
            yield f"walk of the bias: not seen; above {max(limits):.2g} m/s2/sqrt(s) it would have been; {longer}"


def _channel_noise(channel: Channel) -> str:
    if channel.quantity in ACCELERATIONS:
        return f"{_short(channel.quantity)} {1e3 * channel.noise.density:.3g} mm/s2/sqrt(Hz)"
    return f"{_short(channel.quantity)} {degrees(channel.noise.density):.2g} deg/s/sqrt(Hz)"


def _short(quantity: str) -> str:
    return quantity.partition("_")[0]


def _long(seconds: float) -> str:
    if not isfinite(seconds):
        return "a record of unknown length"
    return f"{seconds:.0f} s" if seconds < 120.0 else f"{seconds / 60.0:.0f} min"


def _vibration(measured: Measured, rate_hz: float) -> Iterator[str]:
    accelerations = [channel for channel in measured.channels if channel.quantity in ACCELERATIONS]
    if not accelerations:
        return
    half_hz = 0.5 * measured.pace.new_hz
    found = [(channel, line) for channel in accelerations for line in channel.lines]
    if not found:
        if not isnan(half_hz) and half_hz > 2.0:
            yield f"vibration: no line up to {half_hz:.3g} Hz"
        return
    for channel, line in sorted(found, key=lambda pair: -pair[1].amplitude):
        yield (
            f"vibration: {_short(channel.quantity)} {line.amplitude:.2g} m/s2 at {line.frequency_hz:.2f} Hz; "
            f"polled at {rate_hz:g} Hz {folded_text(line.frequency_hz, line.amplitude, rate_hz)}"
        )
    yield f"  (what is faster than {half_hz:.3g} Hz, half the new values a second, shows here at another frequency)"


def folded_text(frequency_hz: float, amplitude_mps2: float, rate_hz: float) -> str:
    """What a line becomes of when it is polled ``rate_hz`` times a second."""
    at_hz = folded_hz(frequency_hz, rate_hz)
    if at_hz >= WAVES_HZ:
        return f"it shows at {at_hz:.2f} Hz, above the waves"
    if at_hz < _STANDS_HZ:
        return f"it reads as a bias that wanders (of {at_hz:.3f} Hz): take another rate"
    height_m = amplitude_mps2 / (2.0 * pi * at_hz) ** 2
    return f"it reads as a wave of {1.0 / at_hz:.2g} s and {height_m:.2g} m: take another rate"


# ---- for scripts -----------------------------------------------------------------------------------------------------


def tree(found: Examined) -> dict[str, Any]:
    """The same as an object of JSON; what is not known is left out."""
    device = found.device
    told: dict[str, Any] = {
        "device_id": device.device_id,
        "verdict": device.verdict,
        "profiles": [
            {
                "profile": finding.variant.profile.name,
                "changes": finding.variant.describe().removeprefix(finding.variant.profile.name).strip(),
                "score": finding.score,
                "doubt": finding.doubt,
                "values": finding.values,
                "registers": finding.registers,
            }
            for finding in device.proved or device.findings
        ],
    }
    if device.bandwidth is not None:
        told["bandwidth_hz"] = device.bandwidth.hertz
        told["bandwidth_is_read"] = device.bandwidth.is_read
    if found.measured is not None:
        trips = found.measured.round_trips
        told["measured"] = msgspec.to_builtins(found.measured) | {
            "round_trips": msgspec.to_builtins(trips) | {"timeout_ms": trips.timeout_ms}
        }
    if found.survey is not None:
        told["registers"] = [
            {"function": one.function, "address": one.address, "raw": list(one.raw), "moves": one.moves}
            for one in found.survey.seen
        ]
    told["notes"] = [*found.notes, *(surveying.notes(found.survey) if found.survey is not None else ())]
    if found.table is not None:
        told["device"] = msgspec.to_builtins(found.table.device)
        told["toml"] = toml(found.table)
    known = known_only(told)
    assert isinstance(known, dict)
    return known


def known_only(value: Any) -> Any:
    """Without the numbers that are not known, of which JSON has none."""
    if isinstance(value, dict):
        return {key: known_only(one) for key, one in value.items() if not _is_unknown(one)}
    if isinstance(value, list | tuple):
        return [known_only(one) for one in value if not _is_unknown(one)]
    return value


def _is_unknown(value: Any) -> bool:
    return value is None or (isinstance(value, float) and not isfinite(value))
