"""The adapters of a machine: their lasting names, who has them open, and why one cannot be opened."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

import pytest
from serial.tools import list_ports

from heaved.links import SerialLink, TcpLink
from heaved.setup.adapters import adapters, beside_us, explain, holders, refusal, stable_path

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture
def port() -> Iterator[str]:
    master, slave = os.openpty()
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


def test_the_name_that_stays_is_found(tmp_path: Path) -> None:
    device, other = tmp_path / "ttyUSB0", tmp_path / "ttyUSB1"
    device.touch()
    other.touch()
    directory = tmp_path / "by-id"
    directory.mkdir()
    (directory / "usb-FTDI_A1-if00-port0").symlink_to("../ttyUSB0")
    assert stable_path(str(device), directory) == str(directory / "usb-FTDI_A1-if00-port0")
    assert stable_path(str(other), directory) == str(other)
    assert stable_path(str(device), tmp_path / "none") == str(device)


def test_adapters_are_told_with_name_maker_and_number(monkeypatch: pytest.MonkeyPatch, port: str) -> None:
    board = SimpleNamespace(
        device="/dev/ttyS0",
        vid=None,
        pid=None,
        location=None,
        product=None,
        description="n/a",
        manufacturer=None,
        serial_number=None,
    )
    usb = SimpleNamespace(
        device=port,
        vid=0x403,
        pid=0x6001,
        location="1-1.2",
        product="FT232R\x1b[2J",
        description="FT232R",
        manufacturer="FTDI",
        serial_number="A1",
    )
    monkeypatch.setattr(list_ports, "comports", lambda: [board, usb])
    first, second = adapters()
    assert (first.path, first.maker, first.serial_number, first.refusal) == (port, "FTDI", "A1", "")
    assert first.name == "FT232R\\x1b[2J"
    assert (first.usb_id, first.socket) == ("0403:6001", "1-1.2")
    assert (second.name, second.usb_id, second.socket) == ("", "", "")


def test_who_holds_a_port_is_named(port: str, tmp_path: Path) -> None:
    assert holders(port) == []
    (other := tmp_path / "ttyUSB7").touch()
    script = "import sys; held = [open(path, 'r+b', buffering=0) for path in sys.argv[1:]]; print(flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", script, port, str(other)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        (holder,) = holders(port)
        told = explain(SerialLink(port), f"{port} is in use by another program, or by this one: stop it")
        warned = beside_us(SerialLink(str(other)))
        process.communicate(b"\n")
    assert holder.startswith(Path(sys.executable).name)
    assert holder.endswith(f"(process {process.pid})")
    assert told.startswith(f"{port} is in use: {holder} has it open: stop it")
    assert warned == f"{holder} has {other} open, too: its bytes and ours will be mixed; end it"
    assert holders(port) == []
    assert beside_us(SerialLink(port)) == ""


def test_a_port_whose_holder_cannot_be_seen(port: str) -> None:
    reason = f"{port} is in use by another program: stop it"
    assert explain(SerialLink(port), reason) == f"{reason} (sudo fuser -v {port} says by whom)"


def test_a_process_that_ends_while_it_is_looked_at_is_nobody(tmp_path: Path) -> None:
    (tmp_path / "4711").mkdir()
    (tmp_path / "self").mkdir()
    assert holders("/dev/null", tmp_path) == []


def test_whose_group_it_is_is_said(monkeypatch: pytest.MonkeyPatch, port: str) -> None:
    monkeypatch.setattr("os.access", lambda path, mode: False)
    monkeypatch.setattr("grp.getgrgid", lambda number: SimpleNamespace(gr_name="dialout"))
    monkeypatch.setattr("getpass.getuser", lambda: "eve")
    assert "sudo usermod -aG dialout eve, log out and in again" in refusal(port)
    assert explain(SerialLink(port), "no permission: ...") == refusal(port)
    monkeypatch.setattr("grp.getgrgid", lambda number: SimpleNamespace(gr_name="root"))
    assert "belongs to root alone" in refusal(port)


def test_what_cannot_be_known_better_stays_as_it_is(tmp_path: Path) -> None:
    assert refusal(str(tmp_path / "none")) == ""
    assert explain(SerialLink(str(tmp_path / "none")), "it is not there") == "it is not there"
    assert explain(TcpLink("127.0.0.1", 1), "refused") == "refused"
    assert beside_us(TcpLink("127.0.0.1", 1)) == ""
