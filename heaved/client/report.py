"""What ``heaved status`` prints: for a person, for a program, for a monitoring system. Pure.

What a daemon says may come from anywhere: no character of it reaches a terminal that would obey it.
"""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.client.stream_client import Snapshot, Trouble, UnreachableError
from heaved.samples import Fault, HeaveState, vibration_in_words
from heaved.text import printable

if TYPE_CHECKING:
    from collections.abc import Iterator

    from heaved.outputs.records import (
        DeviceStatus,
        MotionRecord,
        ObserverStatus,
        OutputStatus,
        QuietStatus,
        ReferenceStatus,
        RockRecord,
        RockStatus,
        StatusRecord,
    )

_FRESH_S: Final = 1.0
"""A frame older than this is no real-time heave."""
_WORSE: Final = (HeaveState.VALID, HeaveState.DEGRADED, HeaveState.SETTLING, HeaveState.INVALID)
"""From the best to the worst."""


class CheckState(IntEnum):
    """Exit codes of the monitoring-plugin convention."""

    OK = 0
    WARNING = 1
    CRITICAL = 2
    UNKNOWN = 3


# --- for a program ---------------------------------------------------------------------------------------------------


def json_text(result: Snapshot | UnreachableError) -> str:
    """One JSON object: ``reachable``, and either ``version``, ``status``, ``motion`` or ``trouble`` and ``message``."""
    if isinstance(result, UnreachableError):
        body = {"reachable": False, "trouble": result.trouble.name.lower(), "message": str(result)}
    else:
        body = {"reachable": True, **msgspec.to_builtins(result)}
    text = msgspec.json.format(msgspec.json.encode(body), indent=2).decode()
    return "\n".join([_ascii(line) for line in text.split("\n")])


def _ascii(line: str) -> str:
    """A line of JSON with JSON's own escapes for what cannot be printed, which stands within its texts alone."""
    if line.isprintable():
        return line
    return "".join([letter if letter.isprintable() else _escaped(letter) for letter in line])


def _escaped(letter: str) -> str:
    units = letter.encode("utf-16-be", "surrogatepass").hex()
    return "".join([f"\\u{units[i : i + 4]}" for i in range(0, len(units), 4)])


# --- for a monitoring system -----------------------------------------------------------------------------------------


def check_line(result: Snapshot | UnreachableError) -> tuple[CheckState, str]:
    """Exit code and the one line ``STATE - text | performance data``.

    CRITICAL: no daemon, no fresh frame, heave invalid. WARNING: heave degraded or settling, a device or an output down,
    a reference MRU that diverges.
    UNKNOWN: what answers is no daemon of ours, or the host has no address, so the check itself is set up wrongly.
    """
    if isinstance(result, UnreachableError):
        is_misdirected = result.trouble in (Trouble.NOT_HEAVED, Trouble.NO_ADDRESS)
        state = CheckState.UNKNOWN if is_misdirected else CheckState.CRITICAL
        return state, f"{state.name} - {_plain(str(result))}"
    status = result.status
    state, text = _judge(status, result.motion, _age_s(result))
    heave, std = status.heave.heave_m, status.heave.heave_std_m
    values = (
        ("age", _age_s(result), "s"),
        ("heave", heave, "m"),
        ("heave_std", std, "m"),
        ("rate", status.rate_hz, ""),
        ("clients", status.clients, ""),
        ("dropped", status.dropped, "c"),
    )
    performance = " ".join(f"{name}={value:.6g}{unit};;;;" for name, value, unit in values if value is not None)
    return state, f"{state.name} - {_plain(text)} | {performance}"


def _judge(status: StatusRecord, motion: MotionRecord | None, age_s: float | None) -> tuple[CheckState, str]:
    """By the worse of what the status says and the frame that was seen."""
    quality = status.quality
    if motion is not None and _WORSE.index(motion.quality.heave) > _WORSE.index(quality.heave):
        quality = motion.quality
    heave_m = status.heave.heave_m if motion is None else motion.heave_m
    reasons = f" ({', '.join(quality.reasons)})" if quality.reasons else ""
    if age_s is None:
        return CheckState.CRITICAL, "no frame yet"
    if not age_s <= _FRESH_S:
        return CheckState.CRITICAL, f"last frame is {duration(age_s)} old"
    if quality.heave is HeaveState.INVALID:
        return CheckState.CRITICAL, f"heave invalid{reasons}"
    if heave_m is None and quality.heave is not HeaveState.SETTLING:
        return CheckState.CRITICAL, f"heave {quality.heave.value}, but there is none{reasons}"
    text = f"heave {quality.heave.value}{reasons}, age {duration(age_s)}"
    down = [device.name for device in status.devices if not device.up]
    down += [f"output {output.name}" for output in status.outputs if not output.up]
    amiss = [f"down: {', '.join(down)}"] if down else []
    amiss += status.reference_mru.warnings if status.reference_mru is not None else ()
    if amiss:
        return CheckState.WARNING, f"{text}, {'; '.join(amiss)}"
    return (CheckState.OK if quality.heave is HeaveState.VALID else CheckState.WARNING), text


def _age_s(snapshot: Snapshot) -> float | None:
    return snapshot.status.heave.age_s if snapshot.motion is None else snapshot.motion.age_s


def _plain(text: str) -> str:
    """``|`` and line ends mean something to a monitoring system."""
    return printable(" ".join(text.replace("|", "/").split()))


# --- for a person ----------------------------------------------------------------------------------------------------


def table(snapshot: Snapshot) -> str:
    """Several lines, no terminal control."""
    status, motion = snapshot.status, snapshot.motion
    lines = [f"heaved {status.release}, up {duration(status.uptime_s)}"]
    if status.config_file is not None:
        lines.append(_row("config", status.config_file))
    if status.state_file is not None:
        lines.append(_row("state", status.state_file))
    lines += _heave_rows(status, motion, _age_s(snapshot))
    lines += _correction_rows(status)
    lines += _laser_rows(status)
    lines += _stage_rows(status)
    lines += _reference_rows(status)
    if motion is not None and motion.rock:
        lines += _titled("rock", _columns([("in", "roll", "pitch", "yaw"), *map(_rock_cells, motion.rock)]))
    if status.rock:
        lines += _titled("rock error", _columns(_score_rows(status.rock)))
    if status.quiet is not None:
        lines.append(_row("quiet", _quiet_text(status.quiet)))
    if motion is not None and motion.forecast:
        cells = [(_ms(f.horizon_s), signed(f.heave_m, " m", 3), spread(f.std_m, " m", 3)) for f in motion.forecast]
        lines += _titled("forecast", _columns([("in", "heave", "std"), *cells]))
    heads = ("device", "role", "state", "rate", "good", "faults", "last fault")
    lines += ["", *_columns([heads, *map(_device_cells, status.devices)])]
    for device in status.devices:
        if device.detail:
            is_named = device.detail.startswith(f"{device.name} (")
            lines.append(f"  {device.detail}" if is_named else f"  {device.name}: {device.detail}")
    lines += _output_rows(status)
    lines += ["", _row("clients", f"{status.clients} connected, {status.dropped} lines dropped for slow ones")]
    if status.clock is not None:
        lines.append(_row("clock", f"UTC stepped {status.clock.steps} times since the start"))
    return "\n".join(map(printable, lines))


def duration(seconds: float) -> str:
    """A time span with the units that a person would use."""
    if abs(seconds) < 1.0:
        return f"{seconds * 1e3:.1f} ms"
    if seconds < 120.0:
        return f"{seconds:.1f} s"
    minutes = int(seconds // 60)
    if minutes < 120:
        return f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60} min" if minutes < 2880 else f"{minutes // 1440} d {minutes // 60 % 24} h"


def signed(value: float | None, unit: str, decimals: int) -> str:
    """``+1.234 m`` for the unit `` m``, or a dash for what is not known."""
    return "-" if value is None else f"{value:+.{decimals}f}{unit}"


def spread(std: float | None, unit: str, decimals: int) -> str:
    """``±0.012 m`` for a standard deviation, or nothing when it is not known."""
    return "" if std is None else f"±{std:.{decimals}f}{unit}"


def _heave_rows(status: StatusRecord, motion: MotionRecord | None, age_s: float | None) -> Iterator[str]:
    heave, quality = status.heave, status.quality
    rate = "" if status.rate_hz is None else f"   {status.rate_hz:.1f} frames/s"
    age = "no frame yet" if age_s is None else f"age {duration(age_s)}"
    yield _row("heave", f"{signed(heave.heave_m, ' m', 3)} {spread(heave.heave_std_m, ' m', 3)}   {age}{rate}")
    yield _row("quality", f"{quality.heave.value}   laser {quality.laser.value}")
    for reason in quality.reasons:
        yield _row("", reason)
    if motion is None:
        yield _row("", "no frame came while waiting")
    else:
        attitude = (("roll", motion.roll_deg), ("pitch", motion.pitch_deg), ("yaw", motion.yaw_deg))
        yield _row("attitude", "   ".join(f"{name} {signed(value, '°', 2)}" for name, value in attitude))
    if status.observer is not None:
        lines = ", ".join(f"{frequency:.3f}" for frequency in status.observer.frequencies_hz)
        fitted = "" if status.observer.fit_age_s is None else f", fitted {duration(status.observer.fit_age_s)} ago"
        resets = f", started afresh {status.observer.resets} times" if status.observer.resets else ""
        sea = f" at {lines} Hz" if lines else ", no sea fitted yet"
        beside = ", with roll and pitch" if status.observer.roll_pitch_weight else ""
        yield _row("observer", f"{status.observer.name}{sea}{beside}{fitted}{resets}")
        if told := accelerometer_text(status.observer):
            yield _row("sensor", told)
    if status.lead_s is not None:
        yield _row("lead", f"{status.lead_s * 1e3:+.1f} ms")


def accelerometer_text(observer: ObserverStatus) -> str:
    """What the observer has found out about the accelerometer and what shakes it; empty: nothing yet."""
    noise, walk = observer.noise_mps2_rthz, observer.bias_walk_mps2_rts
    told = [f"noise {noise:.1e} m/s2/√Hz"] if noise is not None else []
    told += [f"bias walk {walk:.1e} m/s2/√s"] if walk is not None else []
    told += [words] if (words := vibration_in_words(observer.vibration)) else []
    return "   ".join(told)


def _laser_rows(status: StatusRecord) -> Iterator[str]:
    """Where it is found to be, once its readings show it."""
    laser = status.laser
    if laser is None or laser.ahead_m is None or laser.port_m is None:
        return
    along, across = "ahead" if laser.ahead_m >= 0.0 else "aft", "port" if laser.port_m >= 0.0 else "starboard"
    ahead_m = f"{abs(laser.ahead_m):.2f} m {spread(laser.ahead_std_m, ' m', 2)}"
    port_m = f"{abs(laser.port_m):.2f} m {spread(laser.port_std_m, ' m', 2)}"
    at = f"{ahead_m} {along}, {port_m} to {across}"
    yield _row("laser", f"{'elsewhere: ' if laser.is_elsewhere else ''}{at} of where it is configured")


def _correction_rows(status: StatusRecord) -> Iterator[str]:
    correction = status.correction
    if correction is None:
        return
    last = "" if correction.last_result is None else f", the last {correction.last_result}"
    spared = f", {correction.nothing_to_learn} times nothing to learn" if correction.nothing_to_learn else ""
    age = "" if correction.age_s is None else f", network in use since {duration(correction.age_s)}"
    yield _row("correction", f"{correction.state.value}, {correction.runs} trainings{last}{spared}{age}")


def _stage_rows(status: StatusRecord) -> Iterator[str]:
    if (hull := status.hull) is not None:
        z = f"   z {signed(hull.z_deg, '°', 4)} {spread(hull.std_arcsec, '″', 1)}" if hull.z_deg is not None else ""
        yield _row("hull", f"{hull.state}{z}{_noted(hull.warnings, hull.resets)}")
    if (motion := status.attitude) is not None:
        if motion.age_s is None:
            yield _row("craft", "no reading yet")
            return
        heave = f"heave {signed(motion.heave_m, ' m', 3)} {spread(motion.heave_std_m, ' m', 3)}"
        pitch = f"pitch {signed(motion.pitch_deg, '°', 2)} {spread(motion.pitch_std_deg, '°', 2)}"
        age = f"   age {duration(motion.age_s)}"
        yield _row("craft", f"{heave}   {pitch}{age}{_noted(motion.cautions, motion.resets)}")


def _reference_rows(status: StatusRecord) -> Iterator[str]:
    """An existing MRU beside ours."""
    mru = status.reference_mru
    if mru is None:
        return
    yield _row("reference", reference_text(mru))
    angles = [
        f"{axis} {signed(mean, '°', 2)} {spread(std, '°', 2)}"
        for axis, mean, std in (
            ("roll", mru.roll_mean_difference_deg, mru.roll_std_difference_deg),
            ("pitch", mru.pitch_mean_difference_deg, mru.pitch_std_difference_deg),
        )
        if mean is not None
    ]
    if angles:
        yield _row("", f"minus ours, in the mean: {'   '.join(angles)}")
    for warning in mru.warnings:
        yield _row("", warning)


def reference_text(mru: ReferenceStatus) -> str:
    """How the heave of an existing MRU stands to ours."""
    if mru.age_s is None:
        return "nothing to compare yet"
    if mru.compared_s is None:
        return f"nothing to compare for {duration(mru.age_s)}"
    told = [f"heave {signed(mru.heave_difference_m, ' m', 3)} from ours"] if mru.heave_difference_m is not None else []
    if mru.heave_std_difference_m is not None:
        both = "" if mru.heave_explained_m is None else f", both explain {mru.heave_explained_m:.3f} m"
        told.append(f"{mru.heave_std_difference_m:.3f} m RMS over {mru.compared_s:.0f} s{both}")
    if mru.heave_correlation is not None:
        delay = "" if mru.heave_delay_s is None else f", {mru.heave_delay_s * 1e3:+.0f} ms late"
        scale = "" if mru.heave_scale is None else f", {mru.heave_scale:.3f} times ours"
        told.append(f"correlation {mru.heave_correlation:.3f}{delay}{scale}")
    return "   ".join([*told, f"age {duration(mru.age_s)}"])


def _noted(notes: tuple[str, ...], resets: int) -> str:
    again = f"   started afresh {resets} times" if resets else ""
    return (f"   {', '.join(notes)}" if notes else "") + again


def _rock_cells(rock: RockRecord) -> tuple[str, ...]:
    pairs = (
        (rock.roll_deg, rock.roll_std_deg),
        (rock.pitch_deg, rock.pitch_std_deg),
        (rock.yaw_deg, rock.yaw_std_deg),
    )
    return (_ms(rock.horizon_s), *(_with_std(value, std) for value, std in pairs))


def _score_rows(scores: tuple[RockStatus, ...]) -> list[tuple[str, ...]]:
    """RMS of the last minutes, and the share that fell within the 95 % interval."""
    axes = list(dict.fromkeys(score.axis for score in scores))
    rows: list[tuple[str, ...]] = [("in", *axes)]
    for horizon_s in dict.fromkeys(score.horizon_s for score in scores):
        of_axis = {score.axis: score for score in scores if score.horizon_s == horizon_s}
        rows.append((_ms(horizon_s), *(_score_cell(of_axis[axis]) for axis in axes)))
    return rows


def _score_cell(score: RockStatus) -> str:
    if score.error_deg is None or score.coverage is None:
        return "-"
    return f"{score.error_deg:.3f}° ({100.0 * score.coverage:.0f} % within 95 %)"


def _quiet_text(quiet: QuietStatus) -> str:
    if quiet.start_s is not None and quiet.length_s is not None and quiet.confidence is not None:
        when = "now" if quiet.start_s < 1.0 else f"in {quiet.start_s:.0f} s"
        return f"{when} for {quiet.length_s:.0f} s, {100.0 * quiet.confidence:.0f} % sure"
    if quiet.best_confidence is None:
        return "not known yet"
    return f"none is sure enough, the best {100.0 * quiet.best_confidence:.0f} %"


def _with_std(value: float | None, std: float | None) -> str:
    return f"{signed(value, '°', 3)} {spread(std, '°', 3)}".rstrip()


def _device_cells(device: DeviceStatus) -> tuple[str, ...]:
    wanted = "" if device.wanted_rate_hz is None else f" of {device.wanted_rate_hz:g}"
    rate = "-" if device.rate_hz is None else f"{device.rate_hz:.1f}{wanted} Hz"
    good = Fault.NONE.value
    faults = ", ".join(f"{name} {count}" for name, count in device.results.items() if name != good and count)
    ago = "" if device.last_fault_age_s is None else f" {duration(device.last_fault_age_s)} ago"
    last = "-" if device.last_fault is None else device.last_fault + ago
    state = "up" if device.up else "DOWN"
    return device.name, device.role, state, rate, str(device.results.get(good, 0)), faults or "-", last


def _output_rows(status: StatusRecord) -> list[str]:
    if not status.outputs:
        return []
    heads = ("output", "speaks", "link", "state", "sent", "lost")
    rows = ["", *_columns([heads, *map(_output_cells, status.outputs)])]
    return rows + [f"  {output.name}: {output.detail}" for output in status.outputs if output.detail]


def _output_cells(output: OutputStatus) -> tuple[str, ...]:
    lost = ", ".join(f"{reason} {count}" for reason, count in output.lost.items() if count)
    return output.name, output.kind, output.link, "up" if output.up else "DOWN", str(output.sent), lost or "-"


def _row(name: str, text: str) -> str:
    return f"{name:<11} {text}"


def _titled(name: str, rows: list[str]) -> list[str]:
    return [_row(name if index == 0 else "", row) for index, row in enumerate(rows)]


def _columns(rows: list[tuple[str, ...]]) -> list[str]:
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    padded = ([f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)] for row in rows)
    return ["  ".join(cells).rstrip() for cells in padded]


def _ms(horizon_s: float) -> str:
    return f"{horizon_s * 1e3:g} ms" if horizon_s < 1.0 else f"{horizon_s:g} s"
