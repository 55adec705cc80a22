"""The unit, judged by systemd's own tools where they are installed."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

UNIT = Path(__file__).resolve().parents[2] / "systemd" / "heaved.service"
PROGRAM = "/opt/heaved/bin/heaved"

needs_systemd = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")


@pytest.fixture
def unit(tmp_path: Path) -> Path:
    """The unit with a program that exists here."""
    program = tmp_path / "heaved"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    copy = tmp_path / "heaved.service"
    copy.write_text(UNIT.read_text().replace(PROGRAM, str(program)))
    return copy


def analyze(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["systemd-analyze", *arguments], capture_output=True, text=True, check=False, timeout=60)


@needs_systemd
def test_systemd_finds_nothing_wrong(unit: Path) -> None:
    result = analyze("verify", str(unit))
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")


@needs_systemd
def test_exposure(unit: Path) -> None:
    result = analyze("security", "--offline=true", str(unit))
    (exposure,) = re.findall(r"Overall exposure level for \S+: (\d+\.\d)", result.stdout)
    assert float(exposure) <= 1.2


def settings() -> dict[str, list[str]]:
    """Key to values, in order, of the whole unit."""
    found: dict[str, list[str]] = {}
    for line in UNIT.read_text().splitlines():
        if line and not line.startswith(("#", "[")):
            key, _, value = line.partition("=")
            found.setdefault(key, []).append(value)
    return found


def test_what_the_daemon_relies_on() -> None:
    unit = settings()
    assert unit["ExecStart"] == [f"{PROGRAM} run --config /etc/heaved/heaved.toml"]
    assert unit["Type"] == ["notify"]
    assert unit["Restart"] == ["always"]
    assert unit["StateDirectory"] == ["heaved"]
    assert unit["SupplementaryGroups"] == ["dialout"]
    assert float(unit["WatchdogSec"][0].removesuffix("s")) >= 2.0
    # A configuration error is exit code 78, and nothing that a restart could cure.
    assert unit["RestartPreventExitStatus"] == ["78"]
    # The workers are the daemon's to end.
    assert unit["KillMode"] == ["mixed"]
    # The daemon ends within two seconds of SIGTERM.
    assert float(unit["TimeoutStopSec"][0].removesuffix("s")) > 2.0
    assert {"char-ttyUSB rw", "char-ttyACM rw", "char-ttyS rw"} <= set(unit["DeviceAllow"])
    assert unit["RestrictAddressFamilies"] == ["AF_INET AF_INET6 AF_UNIX"]
    assert unit["IPAddressDeny"] == ["any"]
    # Without this call the trainer cannot lower its own priority.
    assert "setpriority" in unit["SystemCallFilter"][-1]
    assert unit["RestrictRealtime"] == ["yes"]
