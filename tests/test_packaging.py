"""The wheel is whole: installed elsewhere, with the checkout out of sight, it finds its data and its commands."""

from __future__ import annotations

import os
import re
import stat
import subprocess
import sys
import venv
import zipfile
from email import message_from_bytes
from pathlib import Path

import msgspec
import pytest

from heaved import __version__

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("dist")
    done = subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-index", "--no-deps",
         "--no-build-isolation", "--wheel-dir", str(out), str(ROOT)],
        capture_output=True, text=True, check=False, cwd=out,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    (found,) = out.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh environment with the wheel in it; dependencies come from the environment of the tests."""
    directory = tmp_path_factory.mktemp("elsewhere") / "env"
    venv.create(directory, with_pip=False, symlinks=True)
    python = str(directory / "bin" / "python")
    subprocess.run(
        [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "--python", python,
         "install", "--no-index", "--no-deps", str(wheel)],
        check=True, capture_output=True,
    )  # fmt: skip
    return directory


def run(installed: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    # Behind the environment's own packages, and without the .pth file that makes the checkout importable.
    dependencies = str(Path(msgspec.__file__).parent.parent)
    return subprocess.run(
        arguments,
        capture_output=True, text=True, check=False, cwd=installed.parent, env=clean | {"PYTHONPATH": dependencies},
    )  # fmt: skip


def test_the_wheel_holds_the_package_and_its_data_and_nothing_else(wheel: Path) -> None:
    assert wheel.name == f"heaved-{__version__}-py3-none-any.whl"
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names} == {"heaved", f"heaved-{__version__}.dist-info"}
    for path in (path for path in (ROOT / "config").rglob("*") if path.is_file()):
        assert f"heaved/_config/{path.relative_to(ROOT / 'config')}" in names
    assert "heaved/_systemd/heaved.service" in names
    for path in (ROOT / "heaved/manual").glob("*.md"):
        assert f"heaved/manual/{path.name}" in names
    for path in (ROOT / "heaved/page/static").iterdir():
        assert f"heaved/page/static/{path.name}" in names
    modules = {str(path.relative_to(ROOT)) for path in (ROOT / "heaved").rglob("*.py")}
    assert {name for name in names if name.endswith(".py")} == modules


def test_the_installed_command_finds_its_data_inside_the_package(installed: Path) -> None:
    python, heaved = str(installed / "bin/python"), str(installed / "bin/heaved")
    where = run(installed, python, "-c", "import heaved.config.read as c; print(c.__file__); print(c.data_directory())")
    module, data = where.stdout.splitlines()
    assert module.startswith(str(installed))
    assert data == str(Path(module).parents[1] / "_config")
    helped = run(installed, heaved, "--help")
    assert (helped.returncode, helped.stderr) == (0, "")
    for name in ("heaved.toml", "demo.toml", "sensors.toml"):
        checked = run(installed, heaved, "check-config", f"{data}/{name}")
        assert checked.returncode == 0, checked.stderr
        assert checked.stdout.startswith(f"{data}/{name}: well\n")


def test_the_scripts_of_the_checkout_can_be_run() -> None:
    for name in ("tools/test", "tools/demo", "tools/deb", "tools/sbom", "tools/debian/try.sh", ".ci/run"):
        path = ROOT / name
        assert path.stat().st_mode & stat.S_IXUSR, f"{name} is not executable"
        assert path.read_text().startswith("#!/usr/bin/env bash\n")
        subprocess.run(["bash", "-n", str(path)], check=True)
    subprocess.run(["bash", "-n", str(ROOT / "tools/setup.sh")], check=True)


def test_the_wheel_says_what_it_is_and_under_which_licence(wheel: Path) -> None:
    archive = zipfile.ZipFile(wheel)
    information = f"heaved-{__version__}.dist-info"
    metadata = message_from_bytes(archive.read(f"{information}/METADATA"))
    assert (metadata["Name"], metadata["Version"], metadata["License-Expression"]) == (
        "heaved",
        __version__,
        "Apache-2.0",
    )
    assert metadata.get_all("License-File") == ["LICENSE"]
    assert archive.read(f"{information}/licenses/LICENSE") == (ROOT / "LICENSE").read_bytes()
    assert b"Version 2.0, January 2004" in (ROOT / "LICENSE").read_bytes()
    assert {"heave", "Modbus"} <= set(metadata["Keywords"].split(","))
    assert {"Operating System :: POSIX :: Linux", "Typing :: Typed"} <= set(metadata.get_all("Classifier", []))
    assert metadata["Requires-Python"] == ">=3.11"
    assert archive.read(f"{information}/entry_points.txt").decode().split() == [
        "[console_scripts]", "heaved", "=", "heaved.cli:main",
    ]  # fmt: skip
    assert "heaved/py.typed" in archive.namelist()


def test_what_is_checked_before_a_commit_is_what_tools_test_checks() -> None:
    """Without network: every hook is a program of the checkout's own environment."""
    hooks = re.findall(r"entry: \.venv/bin/(.*)", (ROOT / ".pre-commit-config.yaml").read_text())
    checks = re.findall(r"^\$bin/(.*)", (ROOT / "tools/test").read_text(), re.MULTILINE)
    assert "repo: local" in (ROOT / ".pre-commit-config.yaml").read_text()
    assert {hook.replace(" --quiet", "") for hook in hooks} == {
        check.replace(" --quiet", "") for check in checks if "pytest" not in check
    }
