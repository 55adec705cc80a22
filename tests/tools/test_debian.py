"""What the Debian packages are made with, on a tree of a few files; ``tools/debian/try.sh`` tries the real ones."""

from __future__ import annotations

import re
import runpy
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from heaved.cli.common import SYSTEM_CONFIG
from heaved.setup import service
from heaved.setup.unit import UNIT_PROGRAM

TOOLS = Path(__file__).resolve().parents[2] / "tools"
BUILD: dict[str, Any] = runpy.run_path(str(TOOLS / "debian" / "build.py"))


def test_maintainer_scripts_are_sound() -> None:
    for script in BUILD["SCRIPTS"]:
        path = TOOLS / "debian" / f"heaved.{script}"
        assert path.read_text().startswith("#!/bin/sh\nset -e\n")
        subprocess.run(["sh", "-n", path], check=True)
    purge = (TOOLS / "debian" / "heaved.postrm").read_text()
    # What the program makes beside its package.
    for made in (service.STATE, service.DROP_IN.parent, service.RULES, SYSTEM_CONFIG.parent):
        assert re.search(rf"{re.escape(str(made))}(\s|$)", purge, re.MULTILINE), made


def test_places_are_those_of_the_program() -> None:
    assert BUILD["CONFFILE"] == str(SYSTEM_CONFIG)
    assert f"/{BUILD['PLACE']}/bin/heaved" == UNIT_PROGRAM


@pytest.fixture
def base(tmp_path: Path) -> Path:
    """What would be below the root."""
    path = tmp_path / "base"
    program = path / "opt/heaved/bin/heaved"
    program.parent.mkdir(parents=True)
    program.write_text("#!/opt/heaved/bin/python3\n")
    program.chmod(0o700)
    (path / "etc/heaved").mkdir(parents=True, mode=0o700)
    (path / "etc/heaved/heaved.toml").write_text("# all defaults\n")
    (path / "usr/bin").mkdir(parents=True)
    (path / "usr/bin/heaved").symlink_to("/opt/heaved/bin/heaved")
    return path


@pytest.mark.skipif(shutil.which("dpkg-deb") is None, reason="dpkg-deb is not installed")
def test_a_package(base: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")

    def made(out: str) -> Path:
        path = BUILD["_package"](base, "heaved", "1.2.3", (3, 11), tmp_path / out)
        assert isinstance(path, Path)
        return path

    first = made("first")
    for path in base.rglob("*.toml"):
        path.touch()  # As if it had been put together at another time.
    shutil.rmtree(base / "DEBIAN")
    assert made("again").read_bytes() == first.read_bytes()

    def ask(*words: str) -> str:
        return subprocess.run(["dpkg-deb", *words], check=True, capture_output=True, text=True).stdout

    control = ask("--field", str(first))
    assert "Package: heaved\nVersion: 1.2.3\n" in control
    assert "Depends: python3 (>= 3.11), python3 (<< 3.12)," in control
    assert "Recommends: heaved-torch" in control
    listed = {line.split()[-1]: line for line in ask("--contents", str(first)).splitlines()}
    assert listed["./opt/heaved/bin/heaved"].startswith("-rwxr-xr-x root/root")
    assert listed["./etc/heaved/"].startswith("drwxr-xr-x root/root")
    assert "2023-11-14" in listed["./etc/heaved/heaved.toml"]
    unpacked = tmp_path / "control"
    ask("--control", str(first), str(unpacked))
    assert (unpacked / "conffiles").read_text() == "/etc/heaved/heaved.toml\n"
    assert (unpacked / "postrm").stat().st_mode & 0o111
    summed = {line.split()[1] for line in (unpacked / "md5sums").read_text().splitlines()}
    assert summed == {name.removeprefix("./") for name, line in listed.items() if line.startswith("-")}
