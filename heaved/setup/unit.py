"""The systemd unit that comes with the program, and what a configuration needs beyond it, as a drop-in.

The unit lets the daemon talk to this machine alone, and gives it ordinary serial ports, its own directory and no port
below 1024. What the configuration names more than that is allowed in a drop-in, each line under the key that asks for
it; nothing else is.
"""

from __future__ import annotations

import ipaddress
import re
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.links import SerialLink, TcpLink, UdpLink, parse_any_link, parse_link, parse_service_link
from heaved.networks import is_loopback_host
from heaved.outputs.influx import PORTS as INFLUX_PORTS
from heaved.outputs.mqtt import PORTS as MQTT_PORTS
from heaved.outputs.register_map import Mode
from heaved.outputs.telegram_output import SCHEMES as OUTPUT_SCHEMES

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from heaved.config import Config
    from heaved.links import AnyLink, ServiceLink

UNIT_PROGRAM: Final = "/opt/heaved/bin/heaved"
"""As the unit that comes with the program has it."""
USUAL_PORTS: Final = re.compile(r"/dev/tty(USB|ACM|S|AMA)\d+|/dev/(serial/|heaved-).*")
"""Ports that the unit's DeviceAllow covers; a name that stays leads to one of them."""
LOW_PORT: Final = (
    "AmbientCapabilities=CAP_NET_BIND_SERVICE",
    "CapabilityBoundingSet=CAP_NET_BIND_SERVICE",
    "PrivateUsers=no",  # In a user namespace of its own it would have the right over no port of the machine.
)
_EVERYTHING: Final = {"any": "every address"}
DEVICE_SCHEMES: Final = ("tcp", "rtu", "serial", "udp-listen")


class Need(msgspec.Struct, frozen=True, kw_only=True):
    """One thing that the configuration asks for and the unit does not give."""

    key: str
    """Path in the configuration."""
    setting: str
    """Of the section Service."""
    said: str
    """The same in words."""


def unit_text() -> str:
    """The unit as it ships. In an installed wheel it lies in the package; in a checkout, beside it."""
    packaged = Path(str(resources.files("heaved"))) / "_systemd" / "heaved.service"
    checkout = Path(__file__).resolve().parents[2] / "systemd" / "heaved.service"
    return (packaged if packaged.is_file() else checkout).read_text(encoding="utf-8")


def links(config: Config) -> Iterator[tuple[str, str, AnyLink | ServiceLink]]:
    """(path, name, link) of devices, outputs and services, and of registers that are no server on TCP."""
    for i, device in enumerate(config.device):
        yield f"device[{i}].link", device.name, parse_any_link(device.link, DEVICE_SCHEMES)
    for i, output in enumerate(config.output):
        yield f"output[{i}].link", output.name, parse_any_link(output.link, OUTPUT_SCHEMES)
    registers = config.registers
    if registers.enabled:
        link = parse_link(registers.link)
        if isinstance(link, SerialLink) or registers.mode is Mode.PUSH:
            yield "registers.link", "registers", link
    for name, table, ports in (("mqtt", config.mqtt, MQTT_PORTS), ("influx", config.influx, INFLUX_PORTS)):
        if table.enabled:
            yield f"{name}.link", name, parse_service_link(table.link, ports)


def serial_ports(config: Config) -> Mapping[str, tuple[str, ...]]:
    """By serial port, the names of what is on it."""
    found: dict[str, tuple[str, ...]] = {}
    for _, name, link in links(config):
        if isinstance(link, SerialLink):
            found[link.path] = (*found.get(link.path, ()), name)
    return found


def needs(config: Config) -> tuple[list[Need], list[str]]:
    """What the drop-in has to give; and what it cannot, in words."""
    found: list[Need] = []
    cautions: list[str] = []
    for path, _, link in links(config):
        if isinstance(link, SerialLink):
            if not USUAL_PORTS.fullmatch(link.path):
                found.append(
                    Need(key=path, setting=f"DeviceAllow={link.path} rw", said=f"the port {link.path} may be opened")
                )
        elif isinstance(link, TcpLink | UdpLink) or hasattr(link, "scheme"):
            _add_host(path, link.host, found, cautions)
    for path, networks in _allowed(config):
        found += [
            Need(
                key=path,
                setting=f"IPAddressAllow={network}",
                said=f"{_EVERYTHING.get(network, network)} may be talked to",
            )
            for network in networks
        ]
    others, more = _other_needs(config)
    first: dict[str, Need] = {}
    for need in (*found, *others):
        first.setdefault(need.setting, need)
    return list(first.values()), cautions + more + _secrets(config)


def _add_host(path: str, host: str, found: list[Need], cautions: list[str]) -> None:
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        if host != "localhost":
            cautions.append(
                f"{path}: {host} is a name, and the unit knows addresses alone: write its address into the link, or "
                "allow its network and that of the name server (systemctl edit heaved: IPAddressAllow=)"
            )
        return
    if not address.is_loopback:
        found.append(Need(key=path, setting=f"IPAddressAllow={address}", said=f"{address} may be talked to"))


def _allowed(config: Config) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Networks that the configuration lets in."""
    for name, table in (("stream", config.stream), ("http", config.http)):
        if name == "stream" or config.http.enabled:
            yield f"{name}.allow", table.allow
            if table.tls and not table.allow and not is_loopback_host(table.host):
                yield f"{name}.tls", ("any",)
    if config.registers.enabled:
        yield "registers.allow", config.registers.allow
    for array in ("device", "output"):
        for i, one in enumerate(getattr(config, array)):
            yield f"{array}[{i}].allow", one.allow


def _other_needs(config: Config) -> tuple[list[Need], list[str]]:
    """Of ports below 1024, directories and priorities, and what has to be done besides."""
    found: list[Need] = []
    cautions: list[str] = []
    for key, port in _low_ports(config):
        said = f"port {port}, below 1024, may be listened on"
        found += [Need(key=key, setting=setting, said=said) for setting in LOW_PORT]
    directories = {"state.directory": config.state.directory}
    if config.recording.enabled:
        directories["recording.directory"] = config.recording.directory
    for key, directory in directories.items():
        if directory:
            found.append(Need(key=key, setting=f"ReadWritePaths=-{directory}", said=f"{directory} may be written"))
            cautions.append(
                f"{key}: {directory} must belong to the service. Make a user that stays, whose name it then takes: "
                f"adduser --system --group --no-create-home heaved; install -d -o heaved -g heaved -m 0750 {directory}"
            )
    priority = config.runtime.fifo_priority
    if priority > 0:
        said = f"real-time scheduling up to priority {priority} may be taken"
        for setting in ("RestrictRealtime=no", f"LimitRTPRIO={priority}", "SystemCallFilter=sched_setscheduler"):
            found.append(Need(key="runtime.fifo_priority", setting=setting, said=said))
    return found, cautions


def _secrets(config: Config) -> list[str]:
    """Files that only root may read, and a service whose user changes cannot."""
    return [
        f"{name}.{key}: {file} must be readable by the service, whose user changes: hand it over as a credential "
        f"(systemctl edit heaved: LoadCredential={name}:{file}), and set {key} to "
        f'"/run/credentials/heaved.service/{name}"'
        for name, table, is_on in (
            ("mqtt", config.mqtt, config.mqtt.enabled),
            ("influx", config.influx, config.influx.enabled),
            ("tls", config.tls, config.wants_tls),
        )
        for key in ("password_file", "token_file", "key_file")
        if is_on and (file := getattr(table, key, "")) and not file.startswith("/run/credentials/")
    ]


def _low_ports(config: Config) -> Iterator[tuple[str, int]]:
    for name, table in (("stream", config.stream), ("http", config.http)):
        if 0 < table.port < 1024 and (name == "stream" or config.http.enabled):
            yield f"{name}.port", table.port
    registers = config.registers
    if registers.enabled and registers.mode is Mode.SERVE:
        link = parse_link(registers.link)
        if isinstance(link, TcpLink) and link.port < 1024:
            yield "registers.link", link.port
    for i, output in enumerate(config.output):
        listens = parse_any_link(output.link, OUTPUT_SCHEMES)
        if output.link.startswith("tcp-listen:") and not isinstance(listens, SerialLink) and listens.port < 1024:
            yield f"output[{i}].link", listens.port
