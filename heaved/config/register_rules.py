"""Faults of ``[registers]`` beside the rest of a file: its link, points and horizons, whom it would disturb. Pure."""

from __future__ import annotations

import ipaddress
from typing import TYPE_CHECKING

from heaved.links import SerialLink, TcpLink, parse_link
from heaved.networks import is_loopback_host, parse_networks
from heaved.outputs.register_map import Mode, RegistersParams, table, write_time_s

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from heaved.config import Config

_REGISTERS = 65536
_ALWAYS_S = (0.05, 0.1, 0.15)
"""Horizons at which roll and pitch are predicted whatever the configuration says."""


def register_faults(config: Config, points: Sequence[str], wrong: Collection[str]) -> list[str]:
    """``points``: names of all monitoring points; ``wrong``: paths of keys that have a fault already."""
    params = config.registers
    try:
        link = parse_link(params.link)
    except ValueError as error:
        return [f"registers.link: {error}"] if params.enabled else []
    if not params.enabled:
        return []
    faults = [*_content_faults(config, points), *_size_faults(params, points)]
    if params.mode is Mode.SERVE and isinstance(link, TcpLink):
        faults += _listen_faults(params, link)
    if isinstance(link, SerialLink):
        faults += _line_faults(params, link)
    return [fault for fault in faults if fault.partition(":")[0] not in wrong]


def _content_faults(config: Config, points: Sequence[str]) -> Iterable[str]:
    """What it would tell and nobody estimates."""
    params = config.registers
    if params.point and params.point not in points:
        yield f"registers.point: no [[point]] is named {params.point!r}"
    if len({f"{horizon_s:g}" for horizon_s in params.horizons_s}) < len(params.horizons_s):
        yield "registers.horizons_s: names a horizon twice"
    estimated = (
        ("heave.forecast_horizons_s", config.heave.forecast_horizons_s),
        ("rock.horizons_s", (*_ALWAYS_S, *config.rock.horizons_s)),
    )
    for path, horizons_s in estimated:
        lacking = [f"{horizon_s:g}" for horizon_s in params.horizons_s if horizon_s not in horizons_s]
        if lacking:
            names = ", ".join(lacking)
            yield f"registers.horizons_s: {names} s is not among {path}: add it there, or leave it out here"


def _size_faults(params: RegistersParams, points: Sequence[str]) -> Iterable[str]:
    words = sum(register.kind.words for register in table(params.horizons_s, points))
    is_push = params.mode is Mode.PUSH
    if is_push and params.count > words:
        yield f"registers.count: the map has {words} registers, not {params.count}"
    used = params.count if is_push else words
    if params.start + used > _REGISTERS:
        yield (
            f"registers.start: {params.start} and the {used} registers of the map end beyond register "
            f"{_REGISTERS - 1}: start at {_REGISTERS - used} or below"
        )


def _listen_faults(params: RegistersParams, link: TcpLink) -> Iterable[str]:
    for i, network in enumerate(params.allow):
        try:
            parse_networks((network,))
        except ValueError as error:
            yield f"registers.allow[{i}]: {str(error).removeprefix('allow: ')}"
    try:
        ipaddress.ip_address(link.host)
    except ValueError:
        if not is_loopback_host(link.host):
            yield f"registers.link: {link.host!r} is no IP address; give the address to listen on, e.g. 127.0.0.1"
            return
    if not is_loopback_host(link.host) and not params.allow:
        yield (
            f"registers.link: {link.host} listens beyond this machine; name who may connect in registers.allow, for "
            'example ["192.168.10.0/24"]'
        )


def _line_faults(params: RegistersParams, link: SerialLink) -> Iterable[str]:
    if not 1 <= params.device_id <= 247:
        yield f"registers.device_id: {params.device_id} is no address on a serial line: 1 to 247"
    write_s = write_time_s(link, params.count)
    if params.mode is Mode.PUSH and params.rate_hz * write_s > 1.0:
        yield (
            f"registers.rate_hz: {params.rate_hz:g} is too high for {link}: a write of {params.count} registers takes "
            f"{write_s * 1e3:.1f} ms there, so {int(10.0 / write_s) / 10.0:g} Hz at most: lower it, or raise the "
            "baudrate on both sides"
        )
