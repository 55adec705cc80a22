"""``heaved probe`` as a new user meets it: what is printed where, exit codes, and a message for all that fails."""

from __future__ import annotations

import json
import subprocess
import sys
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import msgspec
import pytest
import typer
from lines_in_background import in_background
from picky_slaves import PickySlave
from serial.tools import list_ports
from wt901 import Wt901

from heaved.cli import main
from heaved.cli.probe import _write
from heaved.config.read import data_directory, load
from heaved.devices import probe as probing
from heaved.setup import scan as scanning
from heaved.setup.device_table import Table
from heaved.setup.probe_report import Examined

if TYPE_CHECKING:
    from pathlib import Path

    from heaved.devices.probe import Device

SETTINGS = ((9600, "N"), (115200, "N"))


@pytest.fixture(autouse=True)
def few_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scanning, "SETTINGS", SETTINGS)
    monkeypatch.setattr(scanning, "LISTEN_S", 0.005)
    monkeypatch.setattr(probing, "READ_PAUSE_S", 0.02)
    monkeypatch.setattr(probing, "LATEST_S", 0.0)


def plugged_in(monkeypatch: pytest.MonkeyPatch, *paths: str) -> None:
    ports = [
        SimpleNamespace(
            device=path,
            vid=1,
            pid=2,
            location="1-2",
            product="FT232R",
            description="x",
            manufacturer="FTDI",
            serial_number="A1",
        )
        for path in paths
    ]
    monkeypatch.setattr(list_ports, "comports", lambda: ports)


def test_without_a_link_the_adapters_are_listed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plugged_in(monkeypatch, "/dev/null")
    assert main(["probe"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("/dev/null  FT232R, by FTDI, serial number A1\n")
    assert "heaved probe --scan" in out
    assert main(["probe", "--json"]) == 0
    (adapter,) = json.loads(capsys.readouterr().out)["adapters"]
    assert (adapter["path"], adapter["serial_number"]) == ("/dev/null", "A1")
    plugged_in(monkeypatch)
    assert main(["probe"]) == 69
    assert "no serial adapter is plugged in" in capsys.readouterr().err
    assert main(["probe", "--json"]) == 69
    assert json.loads(capsys.readouterr().out) == {"adapters": []}


def test_from_an_adapter_to_a_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "heaved.toml"
    with in_background(lambda: PickySlave(115200, Wt901())) as slave:
        plugged_in(monkeypatch, slave.path)
        arguments = ["probe", "--scan", "--ids", "80", "--timeout", "0.1", "--seconds", "0.2"]
        assert main([*arguments, "--write", str(file), "--yes"]) == 0
        first = capsys.readouterr()
        known = ["probe", f"rtu://{slave.path}?baudrate=115200", "--ids", "80", "--timeout", "0.5", "--seconds", "0"]
        assert main([*known, "--write", str(file), "--yes"]) == 78
        again = capsys.readouterr()
        assert {request[1] for request in slave.requests} == {3, 4}
    assert f"{slave.path}: 2 settings, " in first.err
    assert " requests: at most " in first.err
    assert f"{slave.path}: id 80 at {slave.path} (115200 8N1)" in first.err
    assert f"{file}: written" in first.err
    assert "id 80: fits\n  100%  witmotion-wt901c485\n" in first.out
    assert f"--- {file}\n" in first.out
    assert '\n+[[device]]\n+name = "imu"\n' in first.out
    (device,) = load(file).device
    assert (device.name, device.role, device.device_id) == ("imu", "imu", 80)
    assert "device imu-2: device_id 80 on" in again.err
    assert "is that of device imu already" in again.err
    assert "was left alone" in again.err
    assert len(load(file).device) == 1


def test_before_it_is_written_it_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "heaved.toml"
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    asked: list[str] = []
    answers = [False, True]

    def confirm(text: str) -> bool:
        asked.append(text)
        return answers.pop(0)

    monkeypatch.setattr(typer, "confirm", confirm)
    with in_background(lambda: PickySlave(115200, Wt901())) as slave:
        arguments = [
            "probe",
            f"rtu://{slave.path}?baudrate=115200",
            "--ids",
            "80",
            "--timeout",
            "0.5",
            "--seconds",
            "0",
        ]
        assert main([*arguments, "--write", str(file)]) == 1
        assert not file.exists()
        assert main([*arguments, "--write", str(file), "--name", "deck", "--rate", "40"]) == 0
    assert asked == [f"Write this to {file}?"] * 2
    (device,) = load(file).device
    assert (device.name, device.rate_hz) == ("deck", 40.0)
    assert "was left alone" in capsys.readouterr().err


def test_a_guess_is_not_written_beside_what_is_proved(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Something else on the line whose registers could be those of a laser, too, keeps nothing from being written."""
    file = tmp_path / "heaved.toml"
    imu, laser = [one for one in load(data_directory() / "heaved.toml").device if one.role in ("imu", "laser")]
    guess = msgspec.structs.replace(laser, name="laser-2", device_id=4)
    tables = [
        Table(device=imu, is_packaged=True, heading="an IMU"),
        Table(device=laser, is_packaged=True, heading="a laser"),
        Table(device=guess, is_packaged=True, heading="perhaps a laser", doubt="such values alone prove nothing"),
    ]
    nobody = cast("Device", None)
    _write(file, [Examined(device=nobody, table=table) for table in tables], yes=True, quiet=True)
    assert [one.name for one in load(file).device] == [imu.name, laser.name]
    said = f"id 4: is not written: id {laser.device_id} is the laser, and this is a guess"
    assert said in capsys.readouterr().err


def test_a_file_that_cannot_be_added_to_is_refused_before_anybody_is_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "heaved.toml"
    file.write_text("[stream]\nport = 99999\n")
    assert main(["probe", "tcp://127.0.0.1:1", "--write", str(file), "--yes"]) == 78
    assert "stream.port" in capsys.readouterr().err
    assert main(["probe", "tcp://127.0.0.1:1", "--write", str(tmp_path / "none" / "x.toml"), "--yes"]) == 78
    assert "nothing can be written into its directory" in capsys.readouterr().err


def test_sensors_on_two_adapters_have_names_of_their_own(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with (
        in_background(lambda: PickySlave(9600, Wt901())) as one,
        in_background(lambda: PickySlave(115200, Wt901())) as other,
    ):
        plugged_in(monkeypatch, one.path, other.path)
        assert main(["probe", "--scan", "--ids", "80", "--timeout", "0.1", "--seconds", "0", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [device["device"]["name"] for device in told["devices"]] == ["imu", "imu-2"]
    assert [device["link"] for device in told["devices"]] == [
        f"rtu://{one.path}?baudrate=9600&parity=N", f"rtu://{other.path}?baudrate=115200&parity=N",
    ]  # fmt: skip


def test_a_script_gets_one_object(capsys: pytest.CaptureFixture[str]) -> None:
    with in_background(lambda: PickySlave(115200, Wt901())) as slave:
        link = f"rtu://{slave.path}?baudrate=115200"
        assert main(["probe", link, "--ids", "80", "--timeout", "0.5", "--seconds", "0.5", "--json"]) == 0
    captured = capsys.readouterr()
    told = json.loads(captured.out, parse_constant=pytest.fail)
    (device,) = told["devices"]
    assert device["verdict"] == "fits"
    assert device["profiles"][0]["profile"] == "witmotion-wt901c485"
    assert device["device"]["device_id"] == 80
    assert device["measured"]["round_trips"]["timeout_ms"] >= 20.0
    assert "[[device]]" in device["toml"]
    assert "null" not in captured.out


def test_nobody_answers_and_what_was_heard_instead(capsys: pytest.CaptureFixture[str]) -> None:
    with in_background(lambda: PickySlave(2400, lambda request: b"", lambda data: b"\xf8\x80")) as slave:
        assert main(["probe", f"rtu://{slave.path}", "--ids", "3-5", "--timeout", "0.05", "--json"]) == 69
        out, scanned = capsys.readouterr()
        link = f"rtu://{slave.path}?baudrate=9600"
        assert main(["probe", link, "--ids", "3-5", "--timeout", "0.05", "--json"]) == 69
        captured = capsys.readouterr()
    assert json.loads(out)["devices"] == []
    assert "bytes that are no frame came when id 3 was asked at 9600 8N1 (f8 80)" in scanned
    assert "nobody answers at any usual baud rate" in scanned
    assert "2 bytes that are no valid frame" in captured.err
    assert "check baudrate" in captured.err
    assert json.loads(captured.out)["devices"] == []


def test_an_adapter_that_echoes_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    with in_background(lambda: PickySlave(9600, lambda request: request, lambda data: data)) as slave:
        assert main(["probe", f"rtu://{slave.path}", "--ids", "3-5", "--timeout", "0.05"]) == 69
    assert "the adapter hears its own requests" in capsys.readouterr().err


@pytest.mark.parametrize("query", ["", "?baudrate=9600"])
def test_a_port_that_the_daemon_holds(query: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    daemon = tmp_path / "heaved"
    daemon.write_text(
        "import fcntl, sys\nheld = open(sys.argv[2], 'r+b', buffering=0)\nfcntl.flock(held, fcntl.LOCK_EX)\n"
        "print(flush=True)\nsys.stdin.read()\n"
    )
    with (
        in_background(lambda: PickySlave(9600, Wt901())) as slave,
        subprocess.Popen(
            [sys.executable, str(daemon), "run", slave.path], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        ) as holder,
    ):
        assert holder.stdout is not None
        holder.stdout.readline()
        assert main(["probe", f"rtu://{slave.path}{query}", "--ids", "80"]) == 69
        said = capsys.readouterr().err
        holder.communicate(b"")
    assert f"(process {holder.pid}) has it open: stop it; the daemon: systemctl stop heaved" in said


def test_a_port_that_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for query in ("", "?baudrate=9600"):
        assert main(["probe", f"rtu://{tmp_path}/none{query}"]) == 69
        assert f"{tmp_path}/none is not there: plug the adapter in" in capsys.readouterr().err


def test_adapters_in_use_are_left_out(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    plugged_in(monkeypatch, "/dev/null")
    monkeypatch.setattr("heaved.setup.adapters.holders", lambda path: ["heaved run (process 7)"])
    assert main(["probe", "--scan"]) == 69
    err = capsys.readouterr().err
    assert "/dev/null: left out: in use: heaved run (process 7)" in err
    assert "no serial adapter that could be asked" in err


ODD = {
    "live into a file": (["tcp://127.0.0.1:1", "--live"], "needs a terminal"),
    "live for a script": (["tcp://127.0.0.1:1", "--live", "--json"], "neither writes nor speaks JSON"),
    "yes to nothing": (["tcp://127.0.0.1:1", "--yes"], "Name the configuration"),
    "writing with nobody to ask": (["tcp://127.0.0.1:1", "--write", "x.toml"], "add --yes"),
    "a baud rate over TCP": (["tcp://127.0.0.1:1", "--scan"], "has no baud rate"),
    "a role that is none": (["tcp://127.0.0.1:1", "--role", "radar"], "must be one of imu, laser"),
    "registers that are none": (["tcp://127.0.0.1:1", "--registers", "9-3"], "write two numbers"),
    "ids that are none": (["tcp://127.0.0.1:1", "--ids", "0-300"], "ids "),
    "a link that is none": (["usb://x"], "unknown scheme"),
}


@pytest.mark.parametrize("name", ODD)
def test_what_makes_no_sense_is_refused_at_once(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    arguments, reason = ODD[name]
    assert main(["probe", *arguments]) == 1
    captured = capsys.readouterr()
    assert reason in captured.err
    assert captured.out == ""
