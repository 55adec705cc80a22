"""What a daemon uses at one moment, as the system and its own metrics say."""

from __future__ import annotations

import os
import re
import urllib.request
from contextlib import suppress
from math import inf, nan
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

if TYPE_CHECKING:
    from collections.abc import Mapping

_KINDS: Final = {
    "recorder": b"heaved.recorder.serve",
    "fitter": b"heaved.workers.fit_sea",
    "trainer": b"heaved.workers.train_correction",
    "hull fitter": b"heaved.workers.refit_hull",
}
LATENESS: Final = "heaved_tick_lateness_seconds"
_BUCKET: Final = re.compile(r'(\w+)_bucket\{le="([^"]+)"\}')


class Use(msgspec.Struct, frozen=True):
    """Of the daemon, and of its processes by name.

    cpu_s: processor time used so far, the daemon's own and that of the processes it has now.
    """

    rss_mb: float
    descriptors: int
    threads: int
    cpu_s: float
    workers_pss_mb: dict[str, float]
    workers_cpu_s: float


def _status(pid: int) -> dict[str, str]:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return dict(line.split(":", 1) for line in lines if ":" in line)


def cpu_s(pid: int) -> float:
    """Processor time of a process without its children.

    Raises:
        OSError: it is gone.
    """
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def pss_mb(pid: int) -> float:
    """Memory of a process, what it shares with others divided by their number.

    Raises:
        OSError: it is gone.
    """
    found = re.search(r"^Pss:\s+(\d+) kB", Path(f"/proc/{pid}/smaps_rollup").read_text(), re.MULTILINE)
    return int(found[1]) / 1024.0 if found else nan


def children(pid: int) -> dict[str, int]:
    """Its processes that are of the product: their number by what they are."""
    found = {}
    with suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            for text in (task / "children").read_text().split():
                with suppress(OSError):
                    command = Path(f"/proc/{text}/cmdline").read_bytes()
                    found.update({name: int(text) for name, module in _KINDS.items() if module in command})
    return found


def use(pid: int) -> Use:
    """Of a daemon now. The memory of the daemon itself is its resident one: to add up what is shared, the system would
    hold up the very process that is timed.

    Raises:
        OSError: it is gone.
    """
    status = _status(pid)
    workers_mb, workers_s = {}, 0.0
    for name, child in children(pid).items():
        with suppress(OSError):
            workers_mb[name] = pss_mb(child)
            workers_s += cpu_s(child)
    return Use(
        rss_mb=int(status["VmRSS"].split()[0]) / 1024.0,
        descriptors=sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir()),
        threads=int(status["Threads"]),
        cpu_s=cpu_s(pid),
        workers_pss_mb=workers_mb,
        workers_cpu_s=workers_s,
    )


def metrics(address: tuple[str, int]) -> dict[str, float]:
    """What the daemon says of itself.

    Raises:
        OSError: it does not answer.
    """
    with urllib.request.urlopen(f"http://{address[0]}:{address[1]}/metrics", timeout=10.0) as answer:
        text = answer.read().decode()
    pairs = (line.rpartition(" ") for line in text.splitlines() if not line.startswith("#"))
    return {name: float(value) for name, _, value in pairs}


def grown(before: Mapping[str, float], after: Mapping[str, float], prefix: str, *parts: str) -> float:
    """By how much counters of that name have grown, all together; ``parts``: what else must stand in the name."""
    return sum(
        value - before.get(name, 0.0)
        for name, value in after.items()
        if name.startswith(prefix) and all(part in name for part in parts)
    )


def percentile_s(before: Mapping[str, float], after: Mapping[str, float], histogram: str, share: float) -> float:
    """Of what a histogram got between two readings, straight within a bucket; inf: beyond its last bound."""
    counts = sorted(
        (float(found[2]), after[name] - before.get(name, 0.0))
        for name in after
        if (found := _BUCKET.fullmatch(name)) and found[1] == histogram
    )
    if not counts or not counts[-1][1]:
        return nan
    wanted = share * counts[-1][1]
    low_s, below = 0.0, 0.0
    for bound_s, count in counts:
        if count >= wanted:
            return inf if bound_s == inf else low_s + (bound_s - low_s) * (wanted - below) / max(count - below, 1e-9)
        low_s, below = bound_s, count
    return inf
