"""Faults of ``[[output]]``: links, rates, options and points that do not go together, or with the rest of a file."""

from __future__ import annotations

import ipaddress
from math import ceil, floor
from typing import TYPE_CHECKING, Any, Final

from heaved.devices.link import BAUD_RATES
from heaved.links import AnyLink, SerialLink, TcpListenLink, character_s, parse_any_link
from heaved.outputs.motion import Lead
from heaved.outputs.telegram_output import SCHEMES
from heaved.outputs.telegrams.formats import FORMATS

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from heaved.outputs.telegrams.spec import Format, OutputSpec, Telegram

_OPTIONS: Final = ("talker", "settling", "ins_good", "transducers")
"""Keys that mean something to some formats alone."""
_TAKEN: Final = ("registers", "mqtt", "influx")


def output_faults(
    listed: Sequence[Any],
    known: Mapping[int, OutputSpec],
    *,
    imu_hz: float | None,
    points: Collection[object] | None,
) -> list[str]:
    """``listed``: the tables as they are written; ``known``: those of which the telegram is known, by index, with
    defaults in place of what is wrong. ``imu_hz``: its rate; ``points``: names of the points; None: not known.
    """
    faults: list[str] = []
    links: dict[int, AnyLink] = {}
    for i, table in enumerate(listed):
        path = f"output[{i}]"
        if isinstance(table, dict) and isinstance(table.get("link"), str):
            try:
                links[i] = parse_any_link(table["link"], SCHEMES)
            except ValueError as error:
                faults.append(f"{path}.link: {error}")
        if isinstance(table, dict) and table.get("name") in _TAKEN:
            faults.append(
                f"{path}.name: {table['name']!r} is that of the table [{table['name']}] in status and metrics"
            )
        if i in known:
            form = FORMATS[known[i].telegram]
            faults += _option_faults(path, table, known[i].telegram)
            faults += _point_faults(path, known[i].point, points)
            faults += _rate_faults(path, known[i], form, imu_hz)
            if i in links:
                faults += _line_faults(path, known[i], form, links[i])
                faults += _allow_faults(path, known[i].allow, links[i])
    return faults


def output_cautions(outputs: Sequence[OutputSpec], compensation_lead_s: float) -> list[str]:
    """What is no fault but may not be what is meant."""
    found = []
    for i, spec in enumerate(outputs):
        if spec.lead is Lead.NONE and FORMATS[spec.telegram].lead is not Lead.NONE:
            found.append(
                f'output[{i}].lead: "none", but {spec.telegram} tells no time: its reader takes the motion for that of '
                'the moment at which it comes; leave lead out, or set "transmission"'
            )
        if spec.lead is Lead.COMPENSATION and compensation_lead_s == 0.0:
            found.append(f'output[{i}].lead: "compensation" without [compensation] lead_s is "transmission": set it')
    return found


# ---- each by itself --------------------------------------------------------------------------------------------------


def _option_faults(path: str, table: Mapping[str, Any], telegram: Telegram) -> Iterator[str]:
    for key in _OPTIONS:
        if key in table and key not in FORMATS[telegram].options:
            having = ", ".join(name for name, form in FORMATS.items() if key in form.options)
            yield f"{path}.{key}: {telegram} has none; it is for {having}: take it out"


def _point_faults(path: str, point: str, points: Collection[object] | None) -> Iterator[str]:
    if point and points is not None and point not in points:
        yield f"{path}.point: no [[point]] is named {point!r}"


def _rate_faults(path: str, spec: OutputSpec, form: Format, imu_hz: float | None) -> Iterator[str]:
    if imu_hz is not None and spec.rate_hz > imu_hz:
        yield (
            f"{path}.rate_hz: {spec.rate_hz:g} Hz, but the IMU is polled at {imu_hz:g}, and each sample gives one "
            "telegram at the most: lower it, or raise that of the device"
        )
    if form.most_hz is not None and spec.rate_hz > form.most_hz:
        yield f"{path}.rate_hz: {spec.rate_hz:g} Hz, but readers of {spec.telegram} take {form.most_hz:g} at the most"


def _line_faults(path: str, spec: OutputSpec, form: Format, link: AnyLink) -> Iterator[str]:
    """A serial line that is too slow: what it takes, what can be reached, which baud rate is enough."""
    if not isinstance(link, SerialLink):
        return
    telegram_s = form.longest_bytes * character_s(link)
    load = spec.rate_hz * telegram_s
    if load <= 1.0:
        return
    enough = [baud for baud in BAUD_RATES if baud >= load * link.baudrate]
    remedy = f"set {enough[0]} baud on the line and in the reader, or lower" if enough else "no baud rate helps: lower"
    yield (
        f"{path}.rate_hz: {spec.telegram} has up to {form.longest_bytes} bytes, {telegram_s * 1e3:.1f} ms on {link}: "
        f"{spec.rate_hz:g} Hz would take {ceil(load * 100)} % of the time; reachable: {_reachable_hz(telegram_s)} Hz; "
        f"{remedy} rate_hz"
    )


def _reachable_hz(telegram_s: float) -> str:
    """Rounded down: a rate that is promised must be reachable."""
    return f"{floor(10.0 / telegram_s) / 10.0:g}"


def _allow_faults(path: str, allow: Sequence[str], link: AnyLink) -> Iterator[str]:
    if not isinstance(link, TcpListenLink):
        if allow:
            yield f"{path}.allow: says who may connect, and nobody connects to {link}: take it out"
        return
    for i, network in enumerate(allow):
        try:
            ipaddress.ip_network(network)
        except ValueError as error:
            yield f"{path}.allow[{i}]: {error}"
    try:
        host = ipaddress.ip_address("127.0.0.1" if link.host == "localhost" else link.host)
    except ValueError:
        yield f"{path}.link: {link.host!r} is no IP address; give the address to listen on, e.g. 127.0.0.1"
        return
    if not host.is_loopback and not allow:
        yield f"{path}.link: {link} listens beyond this machine; name who may connect in {path}.allow"
