#!/usr/bin/env python
"""Bytes without end for whatever meets bytes from outside, led by the branches that they reach.

    tools/fuzz.py TARGET... [--seconds 60] [--runs N]    one after another, in a process each; ``all``: every one
    tools/fuzz.py --list                                 what there is, and what must hold of each
    tools/fuzz.py TARGET --input FILE                    one input again, as it was kept

The targets are those of tools/evidence/fuzz_targets.py, which the tests share. What breaks one is kept in
``evidence/fuzz/``, and so is what has reached something new: the next run begins there. ``--record`` puts the table
into tools/RESULTS.md. The fuzzer is an extra: ``pip install 'heaved[fuzz]'``.
"""

from __future__ import annotations

import argparse
import importlib.util
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Final

import msgspec
from evidence import results
from evidence.commands import count, positive
from evidence.fuzz_targets import LONGEST_S, TARGETS, run
from evidence.results import CHECKOUT, Report

MEMORY_MB: Final = 1024
"""Of the whole process, interpreter and what it has loaded included."""
HANG_S: Final = 20
"""By the clock; by the processor's, an input has ``LONGEST_S``."""
EXITS: Final = {70: "hang", 71: "memory"}
"""Of libFuzzer; what else is not 0 is a crash."""


class Fuzzed(msgspec.Struct, frozen=True, kw_only=True):
    """What came of one target."""

    target: str
    inputs: int
    took_s: float
    edges: int
    memory_mb: int
    broken: str
    """``crash``, ``hang`` or ``memory``; empty: nothing."""
    said: str
    """What was raised, and where it is kept."""


def fuzz(name: str, folder: Path, seconds: float, runs: int) -> Fuzzed:
    """Run one target until something breaks or the time or the inputs are over."""
    corpus, kept = folder / name, folder / "broken"
    for directory in (corpus, kept):
        directory.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(TARGETS[name].seeds()):
        (corpus / f"seed-{number:02d}").write_bytes(seed)
    words = [
        f"-max_total_time={seconds:.0f}", f"-max_len={TARGETS[name].most_bytes}", f"-timeout={HANG_S}",
        f"-rss_limit_mb={MEMORY_MB}", f"-artifact_prefix={kept}/{name}-", "-print_final_stats=1",
    ]  # fmt: skip
    words += [f"-runs={runs}"] if runs else []
    began_s = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "evidence.fuzz_run", name, ",".join(TARGETS[name].modules), *words, str(corpus)],
        cwd=CHECKOUT / "tools", capture_output=True, text=True, errors="replace", check=False,
    )  # fmt: skip
    said = done.stderr + done.stdout
    broken = "" if done.returncode == 0 else EXITS.get(done.returncode, "crash")
    return Fuzzed(
        target=name,
        inputs=max(_last(said, r"number_of_executed_units: *(\d+)"), _last(said, r"^#(\d+)\t")),
        took_s=time.monotonic() - began_s,
        edges=_last(said, r" cov: (\d+)"),
        memory_mb=max(_last(said, r"peak_rss_mb: *(\d+)"), _last(said, r" rss: (\d+)Mb")),
        broken=broken,
        said=_what_broke(said) if broken else "",
    )


def _last(said: str, pattern: str) -> int:
    found = re.findall(pattern, said, re.MULTILINE)
    return int(found[-1]) if found else 0


def _what_broke(said: str) -> str:
    """The end of the traceback, and the file."""
    traceback = said.partition("Traceback")[2].partition("==")[0].strip().splitlines()
    file = re.findall(r"Test unit written to (\S+)", said)
    return "\n".join([*(traceback or said.strip().splitlines())[-12:], *file[-1:]])


def report(found: list[Fuzzed]) -> Report:
    """The table, and below it what broke."""
    rows = ["| target | inputs | a second | branches | crashes | hangs | memory MB |", "|---|---|---|---|---|---|---|"]
    for one in found:
        hangs = one.broken in EXITS.values()
        rows.append(
            f"| {one.target} | {one.inputs} | {one.inputs / one.took_s:.0f} | {one.edges} "
            f"| {int(bool(one.broken) and not hangs)} | {int(hangs)} | {one.memory_mb} |"
        )
    rows.append(
        f"| **all** | **{sum(one.inputs for one in found)}** | | | **{sum(one.broken == 'crash' for one in found)}** "
        f"| **{sum(one.broken in EXITS.values() for one in found)}** | |"
    )
    rows += ["", f"A hang: {LONGEST_S:g} s of the processor for one input, or {MEMORY_MB} MB."]
    rows += [f"\n{one.target}: {one.broken}\n```\n{one.said}\n```" for one in found if one.broken]
    return Report("\n".join(rows))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("target", nargs="*", choices=[*TARGETS, "all", []], metavar="TARGET")
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--seconds", type=positive, default=60.0, metavar="N", help="for each target (default 60)")
    parser.add_argument("--runs", type=count, default=0, metavar="N", help="inputs for each, at most")
    parser.add_argument("--input", type=Path, metavar="FILE", help="give it this input alone")
    parser.add_argument("--out", type=Path, default=CHECKOUT / "evidence", metavar="DIR", help="default: evidence/")
    parser.add_argument("--record", action="store_true", help="put the table into tools/RESULTS.md")
    options = parser.parse_args()
    if options.list or not options.target:
        for name, target in TARGETS.items():
            print(f"{name:<18} {(target.run.__doc__ or '').strip()}")
        return 0
    names = list(TARGETS) if "all" in options.target else options.target
    if options.input is not None:
        for name in names:
            run(TARGETS[name], options.input.read_bytes())
        return 0
    if importlib.util.find_spec("atheris") is None:
        print("the fuzzer is not installed: pip install 'heaved[fuzz]' (in a checkout: pip install -e '.[fuzz]')")
        return 2
    made_with, began_s = results.provenance(), time.monotonic()
    found = []
    for name in names:
        found.append(fuzz(name, options.out / "fuzz", options.seconds, options.runs))
        print(f"{name}: {found[-1].inputs} inputs, {found[-1].broken or 'nothing broken'}", file=sys.stderr, flush=True)
    made = report(found)
    print(made.text)
    if options.record:
        results.record(sys.argv[0], sys.argv[1:], made, made_with, time.monotonic() - began_s)
    return 1 if any(one.broken for one in found) else 0


if __name__ == "__main__":
    sys.exit(main())
