"""The import rules of pyproject.toml hold, and no module is free of them."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
CONTRACTS: list[dict[str, Any]] = PROJECT["tool"]["importlinter"]["contracts"]


def lint(root: Path) -> subprocess.CompletedProcess[str]:
    """In a process of its own: import-linter configures logging for the whole process, and keeps modules loaded."""
    script = (
        "import sys; sys.path.insert(0, '.'); from importlinter.cli import lint_imports; "
        "sys.exit(lint_imports(no_cache=True))"
    )
    return subprocess.run([sys.executable, "-c", script], cwd=root, capture_output=True, text=True, check=False)


def test_import_contracts_hold() -> None:
    done = lint(ROOT)
    assert done.returncode == 0, done.stdout


NEWCOMERS = [
    ("newcomer.py", "", "heaved.newcomer"),
    ("newcomers/__init__.py", "", "heaved.newcomers"),
    ("samples_too.py", "import heaved.pipeline\n", "heaved.samples_too"),
    ("estimation/clock.py", "import time\n", "heaved.estimation.clock -> time"),
    ("estimation/heave/sea/torch_fit.py", "import torch\n", "heaved.estimation.heave.sea.torch_fit -> torch"),
    ("devices/heave_sensor.py", "import heaved.estimation.stages\n", "heaved.devices.heave_sensor"),
    ("outputs/learner.py", "import torch\n", "heaved.outputs.learner -> torch"),
    ("workers/poller.py", "import pymodbus\n", "heaved.workers.poller -> pymodbus"),
    ("outputs/gauges.py", "import prometheus_client\n", "heaved.outputs.gauges -> prometheus_client"),
    ("workers/columns.py", "import pyarrow\n", "heaved.workers.columns -> pyarrow"),
    ("daemon/columns.py", "import heaved.recorder.tables\n", "heaved.daemon.columns -> heaved.recorder.tables"),
    ("client/plots.py", "import matplotlib\n", "heaved.client.plots -> matplotlib"),
    ("replay/cluster.py", "import dask\n", "heaved.replay.cluster -> dask"),
    ("config/outlook.py", "import heaved.daemon.daemon\n", "heaved.config.outlook"),
]
"""Modules that stand in no layer, and one in each room that imports what that room may not; what is said of each."""


def test_a_new_module_is_covered_the_day_it_is_made(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "heaved", tmp_path / "heaved", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    assert lint(tmp_path).returncode == 0
    for module, content, _ in NEWCOMERS:
        path = tmp_path / "heaved" / module
        path.parent.mkdir(exist_ok=True)
        path.write_text(content)
    done = lint(tmp_path)
    assert done.returncode == 1
    assert [said for _, _, said in NEWCOMERS if not re.search(rf"{re.escape(said)}\b(?!\.)", done.stdout)] == []


def test_every_room_has_its_layer() -> None:
    """What a forbidden-contract is about is a whole package: its modules are not listed one by one."""
    for contract in CONTRACTS:
        for name in contract.get("source_modules", ()):
            assert (ROOT / name.replace(".", "/")).is_dir(), name
    (layers,) = (contract for contract in CONTRACTS if contract["type"] == "layers")
    assert layers["exhaustive"]
    assert layers["containers"] == ["heaved"]


def test_every_file_of_tests_tests_something() -> None:
    """A merge once emptied three of them, and nothing was red."""
    files = sorted((ROOT / "tests").rglob("test_*.py"))
    assert [str(file) for file in files if "def test_" not in file.read_text(encoding="utf-8")] == []
