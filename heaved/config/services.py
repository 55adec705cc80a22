"""Faults of ``[mqtt]`` and ``[influx]`` that no key has alone: links, files of passwords and certificates, and what
would be sent for everyone to read.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final

from heaved.links import ServiceLink, parse_service_link
from heaved.networks import is_loopback_host
from heaved.outputs import influx, mqtt
from heaved.outputs.credentials import read_secret, tls_context

if TYPE_CHECKING:
    from collections.abc import Mapping

    from heaved.config import Config

_FILES: Final = {
    "mqtt": ("password_file", "ca_file", "certificate_file", "key_file"),
    "influx": ("password_file", "token_file", "ca_file"),
}
_SECRETS: Final = ("password_file", "token_file")
_READ_BY_OTHERS: Final = 0o044
"""Bits of a file's mode."""


def faults(config: Config) -> list[str]:
    """What a file cannot say whatever it is for."""
    found = []
    for table, files in _FILES.items():
        for key, file in _given(config, table, files).items():
            if not Path(file).is_absolute():
                found.append(f"{table}.{key}: must be an absolute path (got {file!r})")
    found += _mqtt_faults(config.mqtt)
    found += _influx_faults(config.influx)
    return found


def run_faults(config: Config) -> list[str]:
    """What a file must not lack to be run: the library, and files that can be used."""
    found = []
    if config.mqtt.enabled and find_spec("aiomqtt") is None:
        found.append(f"mqtt.enabled: {mqtt.MISSING}")
    for table, files in _FILES.items():
        if not getattr(config, table).enabled:
            continue
        given = _given(config, table, files)
        for key in _SECRETS:
            if key in given:
                try:
                    read_secret(given[key])
                except ValueError as error:
                    found.append(f"{table}.{key}: {error}")
        found += _certificate_faults(table, given)
    return found


def cautions(config: Config) -> list[str]:
    """What is no fault but may not be known to whoever wrote the file."""
    found = []
    for table, ports in (("mqtt", mqtt.PORTS), ("influx", influx.PORTS)):
        params = getattr(config, table)
        link = parse_service_link(params.link, ports)
        if not params.enabled:
            continue
        secrets = _given(config, table, _SECRETS)
        if secrets and not link.scheme.endswith("s") and not is_loopback_host(link.host):
            found.append(
                f"{table}.link: password or token go over the network for everyone to read: use {link.scheme}s://"
            )
        for key, file in secrets.items():
            try:
                is_open = bool(Path(file).stat().st_mode & _READ_BY_OTHERS)
            except OSError:
                continue  # A fault, which is told as such.
            if is_open:
                found.append(f"{table}.{key}: others than its owner may read {file}: chmod 600 it")
    return found


def _given(config: Config, table: str, keys: tuple[str, ...]) -> dict[str, str]:
    """The files that are set, by key."""
    params = getattr(config, table)
    return {key: file for key in keys if (file := getattr(params, key, ""))}


def _certificate_faults(table: str, given: Mapping[str, str]) -> list[str]:
    if not given.keys() - _SECRETS:
        return []
    try:
        tls_context(given.get("ca_file", ""), given.get("certificate_file", ""), given.get("key_file", ""))
    except ValueError as error:
        key = next((key for key, file in given.items() if file in str(error)), "ca_file")
        return [f"{table}.{key}: {error}"]
    return []


def _mqtt_faults(params: mqtt.MqttParams) -> list[str]:
    try:
        link = parse_service_link(params.link, mqtt.PORTS)
    except ValueError as error:
        return [f"mqtt.link: {error}"]
    found = [
        f"mqtt.{key}: is for TLS, which {link} is without: use mqtts://"
        for key in ("ca_file", "certificate_file", "key_file")
        if getattr(params, key) and link.scheme != "mqtts"
    ]
    if params.key_file and not params.certificate_file:
        found.append("mqtt.key_file: is the key of a certificate: set certificate_file, too")
    if params.password_file and not params.username:
        found.append("mqtt.password_file: a password needs a username")
    if params.topic.endswith("/"):
        found.append(f"mqtt.topic: must not end with a slash (got {params.topic!r})")
    return found


def _influx_faults(params: influx.InfluxParams) -> list[str]:
    try:
        link = parse_service_link(params.link, influx.PORTS)
    except ValueError as error:
        return [f"influx.link: {error}"]
    found = [f"influx.{key}: {reason}" for key, reason in _unused(params, link).items() if getattr(params, key)]
    if params.password_file and not params.username:
        found.append("influx.password_file: a password needs a username")
    if params.token_file and params.username:
        found.append("influx.token_file: either a token or a username")
    if "time" in params.tags:
        found.append('influx.tags: no tag may be named "time"')
    if "" in params.tags:
        found.append("influx.tags: a tag needs a name")
    return found


def _unused(params: influx.InfluxParams, link: ServiceLink) -> dict[str, str]:
    """Keys that would do nothing, and why."""
    if link.scheme == "udp":
        reason = "goes over HTTP alone: use http:// or https://"
        return dict.fromkeys(("bucket", "org", "token_file", "username", "password_file", "ca_file"), reason)
    unused = {} if params.bucket else {"org": "is of InfluxDB 2: set bucket, too"}
    return unused if link.scheme == "https" else {**unused, "ca_file": f"is for TLS, which {link} is without"}
