"""[mqtt] and [influx]: what is wrong with links, files and secrets is found before going to sea."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from far_ends import certificates, needs_openssl
from tls_keys import make_keys

from heaved.config.read import ConfigError, parse
from heaved.config.rules import cautions

if TYPE_CHECKING:
    from heaved.config import Config


def read(text: str, *, to_run: bool = False) -> Config:
    return parse(tomllib.loads(text), file="test.toml", directory=Path("/nonexistent"), to_run=to_run)


def faults_of(text: str, *, to_run: bool = False) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        read(text, to_run=to_run)
    return caught.value.faults


FAULTS = {
    "no scheme of MQTT": ("mqtt", 'link = "tcp://h:1"', "it must be mqtt://host:1883 or mqtts://host:8883"),
    "no host": ("mqtt", 'link = "mqtt://:1"', "mqtt.link: link 'mqtt://:1': the host is missing"),
    "no port": ("mqtt", 'link = "mqtt://h:0"', "the port must be a number from 1 to 65535"),
    "a password in the link": ("mqtt", 'link = "mqtt://a:b@h:1883"', "no password may stand in it; they have keys"),
    "a wildcard": ("mqtt", 'topic = "ship/#"', "mqtt.topic: "),
    "a slash at the beginning": ("mqtt", 'topic = "/ship"', "mqtt.topic: "),
    "a slash at the end": ("mqtt", 'topic = "ship/"', "mqtt.topic: must not end with a slash"),
    "a quality beyond": ("mqtt", "qos = 3", "mqtt.qos: "),
    "a protocol of old": ("mqtt", 'protocol = "3.1"', "mqtt.protocol: "),
    "TLS keys without TLS": ("mqtt", 'ca_file = "/ca"', "mqtt.ca_file: is for TLS, which mqtt://127.0.0.1:1883 is"),
    "a key of nothing": ("mqtt", 'link = "mqtts://h"\nkey_file = "/k"', "mqtt.key_file: is the key of a certificate"),
    "a path of somewhere": ("mqtt", 'username = "u"\npassword_file = "p"', "mqtt.password_file: must be an absolute"),
    "a password of nobody": ("mqtt", 'password_file = "/pw"', "mqtt.password_file: a password needs a username"),
    "no scheme of Influx": ("influx", 'link = "mqtt://h"', "http://host:8086, https://host:8086 or udp://host:8089"),
    "a path in the link": ("influx", 'link = "http://h:1/api"', "nothing may stand beside http://host:port"),
    "a token over UDP": ("influx", 'link = "udp://h"\ntoken_file = "/t"', "influx.token_file: goes over HTTP alone"),
    "TLS of HTTP": ("influx", 'ca_file = "/ca"', "influx.ca_file: is for TLS, which http://127.0.0.1:8086 is without"),
    "an org alone": ("influx", 'org = "me"', "influx.org: is of InfluxDB 2: set bucket, too"),
    "two ways in": ("influx", 'token_file = "/t"\nusername = "u"', "influx.token_file: either a token or a username"),
    "a tag called time": ("influx", 'tags = { time = "now" }', 'influx.tags: no tag may be named "time"'),
    "a tag with a line break": ("influx", 'tags = { a = "x\\ny" }', "influx.tags: "),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_are_named(name: str) -> None:
    table, text, words = FAULTS[name]
    assert any(words in fault for fault in faults_of(f"[{table}]\n{text}")), faults_of(f"[{table}]\n{text}")


def test_ports_may_be_left_out() -> None:
    config = read('[mqtt]\nlink = "mqtts://broker"\n[influx]\nlink = "udp://[fd00::7]"')
    assert (config.mqtt.link, config.influx.link) == ("mqtts://broker", "udp://[fd00::7]")


def test_files_must_be_usable_where_they_are_used(tmp_path: Path) -> None:
    (tmp_path / "empty").write_text("\n")
    (tmp_path / "long").write_text("one\ntwo\n")
    files = f'username = "u"\npassword_file = "{tmp_path}/none"'
    influx = f'[influx]\nenabled = true\ntoken_file = "{tmp_path}/empty"'
    assert read(f"[mqtt]\n{files}", to_run=True).mqtt.username == "u"  # It is not enabled.
    faults = faults_of(f"[mqtt]\nenabled = true\n{files}\n{influx}", to_run=True)
    assert faults == [
        f"mqtt.password_file: {tmp_path}/none cannot be read (No such file or directory): check the path, and that the "
        "daemon's user may read it",
        f"influx.token_file: {tmp_path}/empty must hold one line, the secret and nothing else",
    ]
    (fault,) = faults_of(influx.replace("empty", "long"), to_run=True)
    assert "must hold one line" in fault


@needs_openssl
def test_certificates_must_be_such(tmp_path: Path) -> None:
    certificates(tmp_path)
    tls = '[mqtt]\nenabled = true\nlink = "mqtts://broker"\n'
    read(f'{tls}ca_file = "{tmp_path}/ca.pem"', to_run=True)
    for text, words in {
        f'ca_file = "{tmp_path}/none.pem"': "mqtt.ca_file: ",
        f'ca_file = "{tmp_path}/ca.key"': f"mqtt.ca_file: {tmp_path}/ca.key cannot be used",
        f'certificate_file = "{tmp_path}/client.pem"\nkey_file = "{tmp_path}/server.key"': "(key values mismatch)",
        f'certificate_file = "{tmp_path}/ca.pem"\nkey_file = "{tmp_path}/locked.key"': "the key without a password",
    }.items():
        (fault,) = faults_of(tls + text, to_run=True)
        assert words in fault


def test_without_the_library_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "aiomqtt", raising=False)
    monkeypatch.setattr(sys, "path", [])
    monkeypatch.setattr(sys, "meta_path", sys.meta_path[:2])
    sys.path_importer_cache.clear()
    assert faults_of("[mqtt]\nenabled = true", to_run=True) == [
        "mqtt.enabled: the library for MQTT is not installed: pip install 'heaved[mqtt]'"
    ]


def test_a_password_that_everyone_can_read_is_no_fault_but_said(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("s")
    secret.chmod(0o644)
    named = f'enabled = true\nusername = "u"\npassword_file = "{secret}"\n'
    assert cautions(read(f'[mqtt]\n{named}link = "mqtt://broker"')) == [
        "mqtt.link: password or token go over the network for everyone to read: use mqtts://",
        f"mqtt.password_file: others than its owner may read {secret}: chmod 600 it",
    ]
    secret.chmod(0o600)
    for link in ("mqtts://broker", "mqtt://127.0.0.1", "mqtt://localhost", "mqtt://[::1]"):
        assert cautions(read(f'[mqtt]\n{named}link = "{link}"')) == []
    assert cautions(read(f'[influx]\n{named}link = "http://db"')) == [
        "influx.link: password or token go over the network for everyone to read: use https://"
    ]


# ---- TLS of our own servers ------------------------------------------------------------------------------------------


def tls_of(keys: Path, **changes: str) -> str:
    files = {"certificate_file": "server.pem", "key_file": "server.key", "client_ca_file": "ca.pem"} | changes
    return "[tls]\n" + "".join(f'{key} = "{keys / name}"\n' for key, name in files.items())


def test_tls_takes_all_three_files() -> None:
    assert faults_of("[stream]\ntls = true\n[tls]\nkey_file = 'key'") == [
        "tls.key_file: must be an absolute path (got 'key')",
        "tls.certificate_file: [stream] with tls = true needs it: give an absolute path",
        "tls.client_ca_file: [stream] with tls = true needs it: give an absolute path",
    ]
    assert "[stream] and [http] with tls = true" in faults_of("[stream]\ntls = true\n[http]\ntls = true")[0]
    assert read("[http]\nenabled = false\ntls = true").http.tls  # Nobody listens.


def test_beyond_this_machine_with_networks_or_certificates() -> None:
    for table in ("stream", "http"):
        (fault,) = faults_of(f'[{table}]\nhost = "0.0.0.0"')
        assert fault == (
            f"{table}.host: 0.0.0.0 listens beyond this machine; name who may connect in {table}.allow, or want "
            f"certificates of them: {table}.tls = true, with [tls]"
        )
        read(f'[{table}]\nhost = "0.0.0.0"\nallow = ["10.0.0.0/8"]')
        read(f'[{table}]\nhost = "0.0.0.0"\ntls = true\n{tls_of(Path("/keys"))}')


@needs_openssl
def test_files_of_tls_are_looked_at_before_it_runs(tmp_path: Path) -> None:
    make_keys(tmp_path)
    on = "[stream]\ntls = true\n"
    config = read(on + tls_of(tmp_path), to_run=True)
    assert cautions(config) == []
    for changes, words in {
        ("key_file", "none.key"): "tls.key_file: ",
        ("key_file", "display.key"): "tls.certificate_file: ",
        ("client_ca_file", "display.key"): "tls.client_ca_file: ",
        ("certificate_file", "server.csr"): "tls.certificate_file: ",
    }.items():
        (fault,) = faults_of(on + tls_of(tmp_path, **dict([changes])), to_run=True)
        assert fault.startswith(words)
    assert "has ended on" in cautions(read(on + tls_of(tmp_path, certificate_file="ended.pem"), to_run=True))[0]
    (tmp_path / "server.key").chmod(0o644)
    assert cautions(config) == [f"tls.key_file: others than its owner may read {tmp_path}/server.key: chmod 600 it"]
    assert cautions(read(tls_of(tmp_path), to_run=True)) == [
        "tls.certificate_file: is used by nobody: set tls = true in [stream], [http] or both"
    ]
