"""Faults of ``[mqtt]``, ``[influx]`` and ``[tls]`` that no key has alone: links, files of passwords and certificates,
and what would be sent for everyone to read.
"""

from __future__ import annotations

import time
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final

from heaved.links import ServiceLink, parse_service_link
from heaved.networks import is_loopback_host
from heaved.outputs import influx, mqtt
from heaved.outputs.credentials import READ_BY_OTHERS, read_secret, tls_context
from heaved.outputs.tls import Certificates

if TYPE_CHECKING:
    from collections.abc import Mapping

    from heaved.config import Config

_FILES: Final = {
    "mqtt": ("password_file", "ca_file", "certificate_file", "key_file"),
    "influx": ("password_file", "token_file", "ca_file"),
    "tls": ("certificate_file", "key_file", "client_ca_file"),
}
_SERVICES: Final = ("mqtt", "influx")
_SECRETS: Final = ("password_file", "token_file")


def faults(config: Config) -> list[str]:
    """What a file cannot say whatever it is for."""
    found = []
    for table, files in _FILES.items():
        for key, file in _given(config, table, files).items():
            if not Path(file).is_absolute():
                found.append(f"{table}.{key}: must be an absolute path (got {file!r})")
    found += _tls_faults(config)
    found += _mqtt_faults(config.mqtt)
    found += _influx_faults(config.influx)
    return found


def run_faults(config: Config) -> list[str]:
    """What a file must not lack to be run: the library, and files that can be used."""
    found = []
    if config.mqtt.enabled and find_spec("aiomqtt") is None:
        found.append(f"mqtt.enabled: {mqtt.MISSING}")
    for table in _SERVICES:
        if not getattr(config, table).enabled:
            continue
        given = _given(config, table, _FILES[table])
        for key in _SECRETS:
            if key in given:
                try:
                    read_secret(given[key])
                except ValueError as error:
                    found.append(f"{table}.{key}: {error}")
        found += _certificate_faults(table, given)
    given = _given(config, "tls", _FILES["tls"])
    if config.wants_tls and len(given) == len(_FILES["tls"]):
        try:
            Certificates(config.tls)
        except ValueError as error:
            found.append(_at_fault("tls", given, error))
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
        for key, file in _given(config, table, (*_SECRETS, "key_file")).items():
            try:
                is_open = bool(Path(file).stat().st_mode & READ_BY_OTHERS)
            except OSError:
                continue  # A fault, which is told as such.
            if is_open:
                found.append(f"{table}.{key}: others than its owner may read {file}: chmod 600 it")
    return found + _tls_cautions(config)


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
        return [_at_fault(table, given, error)]
    return []


def _at_fault(table: str, given: Mapping[str, str], error: ValueError) -> str:
    """With the key of the file that it is about."""
    key = next((key for key, file in given.items() if file in str(error)), next(iter(given)))
    return f"{table}.{key}: {error}"


def _tls_faults(config: Config) -> list[str]:
    if not config.wants_tls:
        return []
    wanted = " and ".join(f"[{table}]" for table in ("stream", "http") if getattr(config, table).tls)
    return [
        f"tls.{key}: {wanted} with tls = true needs it: give an absolute path"
        for key in _FILES["tls"]
        if not getattr(config.tls, key)
    ]


def _tls_cautions(config: Config) -> list[str]:
    found = []
    given = _given(config, "tls", _FILES["tls"])
    if given and not config.wants_tls:
        found.append(f"tls.{next(iter(given))}: is used by nobody: set tls = true in [stream], [http] or both")
    if config.wants_tls:
        found += Certificates(config.tls).cautions(time.time())
    return found


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
