"""Results for people and for machines: a line of JSON for each, and a section of RESULTS.md for each command.

A section has the command as its heading, then what made it (date, commit, seeds, versions, machine, time taken), then
what the command prints. Run again, a command replaces its own section and leaves the others alone: every figure of the
file can be made again by the line above it.
"""

from __future__ import annotations

import os
import platform
import re
import subprocess
import time
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

if TYPE_CHECKING:
    from collections.abc import Sequence

CHECKOUT: Final = Path(__file__).resolve().parents[2]
RESULTS: Final = CHECKOUT / "tools" / "RESULTS.md"
LINES: Final = "results.jsonl"
PACKAGES: Final = ("heaved", "numpy", "scipy", "torch")
UNRECORDED: Final = {"--record": 0, "--no-figures": 0, "--jobs": 1, "--out": 1, "--data": 1}
"""Options that change no figure, and how many words follow each: they are not part of a heading."""
HEAD: Final = """# Results

What commands printed with `--record`, each under its own line, for the README to quote from.
`tools/accuracy.py results` runs all that it quotes, `--list` says which and how long they take; what has no section
here yet is to be run again. "+" after a commit: with changes that were not committed. Times and costs depend on the
machine; errors do not.
"""


class Provenance(msgspec.Struct, frozen=True):
    """What the figures were made with."""

    commit: str
    """"+" at its end: with changes that are not committed."""
    versions: dict[str, str]


class Report(msgspec.Struct, frozen=True):
    """What a command has to say to people."""

    text: str
    """Markdown."""
    seeds: tuple[int, ...] = ()
    """Records or runs it is made of."""


def provenance() -> Provenance:
    """Of the checkout that runs."""
    versions = {"python": platform.python_version()} | {name: version(name) for name in PACKAGES}
    git = ("git", "--no-optional-locks", "-C", str(CHECKOUT))
    try:
        # What a command records is no change of what made it.
        commit, changes = (
            subprocess.run([*git, *words], check=True, capture_output=True, text=True).stdout.strip()
            for words in (("rev-parse", "HEAD"), ("status", "--porcelain", "--", ".", ":!tools/RESULTS.md"))
        )
    except (OSError, subprocess.CalledProcessError):
        return Provenance("unknown", versions)
    return Provenance(commit + ("+" if changes else ""), versions)


def json_line(kind: str, result: msgspec.Struct, made_with: Provenance) -> bytes:
    """One result as a line of JSON: its fields, what kind it is, and what it was made with. null: does not apply."""
    fields = {"kind": kind} | msgspec.to_builtins(result) | msgspec.to_builtins(made_with)
    return msgspec.json.encode(fields) + b"\n"


class Output:
    """A folder for results and figures."""

    def __init__(self, folder: Path, figures: bool) -> None:
        """
        Raises:
            OSError: the folder cannot be made.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.figures = folder, figures
        self.made_with = provenance()

    def write(self, kind: str, results: Sequence[msgspec.Struct]) -> None:
        """Add a line for each.

        Raises:
            OSError: the file cannot be written to.
        """
        with (self.folder / LINES).open("ab") as file:
            file.writelines(json_line(kind, result, self.made_with) for result in results)


# --- the sections of RESULTS.md --------------------------------------------------------------------------------------


def command_line(program: str, words: Sequence[str]) -> str:
    """The command as a person would type it to get the same figures again."""
    kept, left_out = [f"tools/{Path(program).name}"], 0
    for word in words:
        name = word.partition("=")[0]
        if left_out:
            left_out -= 1
        elif name in UNRECORDED:
            left_out = UNRECORDED[name] if "=" not in word else 0
        else:
            kept.append(word if re.fullmatch(r"[\w./%+:,=-]+", word) else f"'{word}'")
    return " ".join(kept)


def section(command: str, report: Report, made_with: Provenance, day: str, took_s: float) -> str:
    """One section, headings of the report two levels down."""
    versions = ", ".join(f"{name} {number}" for name, number in made_with.versions.items())
    made = [day, f"commit {made_with.commit[:12]}{'+' * made_with.commit.endswith('+')}"]
    made += [f"seeds {_seeds(report.seeds)}"] if report.seeds else []
    made += [versions, f"{os.cpu_count()} cores", f"{took_s:.0f} s"]
    text = re.sub(r"^(#{1,4} )", r"##\1", report.text.strip(), flags=re.MULTILINE)
    return f"## `{command}`\n\n{'; '.join(made)}.\n\n{text}\n"


def _seeds(seeds: Sequence[int]) -> str:
    first, last = min(seeds), max(seeds)
    if len(seeds) > 1 and sorted(seeds) == list(range(first, last + 1)):
        return f"{first} to {last}"
    return ", ".join(map(str, seeds))


def replaced(document: str, made: str) -> str:
    """The document with this section in the place of the one with the same heading, or at its end."""
    head, *sections = re.split(r"^(?=## `)", document or HEAD, flags=re.MULTILINE)
    heading = made.partition("\n")[0]
    places = [place for place, text in enumerate(sections) if text.partition("\n")[0] == heading]
    if places:
        sections[places[0]] = made
    else:
        sections.append(made)
    return "\n".join(text.rstrip() + "\n" for text in (head, *sections))


def record(program: str, words: Sequence[str], report: Report, made_with: Provenance, took_s: float) -> None:
    """Put what a command has printed into RESULTS.md. ``made_with``: as it was when the command began.

    Raises:
        OSError: the file cannot be read or written.
    """
    day = time.strftime("%Y-%m-%d", time.gmtime())
    made = section(command_line(program, words), report, made_with, day, took_s)
    RESULTS.write_text(replaced(RESULTS.read_text() if RESULTS.exists() else "", made))
