"""What heaved is made of: of the environment that is named, and never "nothing is known" where nobody was asked."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

SBOM = Path(__file__).resolve().parents[2] / "tools" / "sbom"
Judge = Callable[[list[dict[str, Any]]], "subprocess.CompletedProcess[str]"]


def test_what_is_no_python_is_named() -> None:
    done = subprocess.run([SBOM, "/bin/false"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "/bin/false is no Python" in done.stderr


def test_without_a_network_nobody_knows(tmp_path: Path) -> None:
    """That the programs cannot be had is not that something is known against a package."""
    python = tmp_path / "python"
    python.write_text(
        "#!/bin/sh\n"
        'case "$1 $2" in\n'
        '"-m venv") mkdir -p "$3/bin" && cp "$0" "$3/bin/python" ;;\n'
        '"-m pip") echo "no route to host" >&2; exit 1 ;;\n'
        "esac\n"
    )
    python.chmod(0o755)
    done = subprocess.run(
        [SBOM, sys.executable], capture_output=True, text=True, check=False, env={**os.environ, "PYTHON": str(python)}
    )
    assert done.returncode == 3
    assert "no route to host" in done.stderr
    assert "nothing is listed or audited: cyclonedx-bom>=5 pip-audit>=2.7 cannot be had without" in done.stderr


@pytest.fixture
def judge(tmp_path: Path) -> Judge:
    """Runs what judges the audit on the dependencies that it found."""
    script = re.findall(r"<<'PYTHON'\n(.*?)\nPYTHON\n", SBOM.read_text(), re.DOTALL)[-1]

    def judged(found: list[dict[str, Any]]) -> subprocess.CompletedProcess[str]:
        file = tmp_path / "audit.json"
        file.write_text(json.dumps({"dependencies": found}))
        return subprocess.run([sys.executable, "-c", script, file], capture_output=True, text=True, check=False)

    return judged


SOUND = {"name": "one", "version": "1", "vulns": []}
BAD = {"name": "two", "version": "2", "vulns": [{"id": "CVE-1", "fix_versions": ["2.1"]}]}
UNKNOWN = {"name": "three", "skip_reason": "Dependency not found on PyPI"}


@pytest.mark.parametrize(
    ("found", "code", "said"),
    [
        ([SOUND], 0, "1 audited, 0 with"),
        ([SOUND, BAD], 1, "two 2: CVE-1; mended in: 2.1"),
        ([SOUND, UNKNOWN], 3, "not audited, PyPI did not answer or does not have them: three"),
        ([BAD, UNKNOWN], 1, "1 audited, 1 with"),
    ],
)
def test_what_the_audit_says(judge: Judge, found: list[dict[str, Any]], code: int, said: str) -> None:
    done = judge(found)
    assert done.returncode == code
    assert said in done.stdout + done.stderr
