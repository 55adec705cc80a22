"""A soak through time, drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes

    from evidence.soak.judge import Sample

_SHARES = ("p50", "p99", "p99.9")


def draw(samples: Sequence[Sample], path: Path, title: str) -> None:
    """Panels below each other, over minutes; the ending of ``path`` is the format.

    Raises:
        OSError: it cannot be written.
    """
    minutes = [sample.t_s / 60.0 for sample in samples]
    figure = Figure(figsize=(9.0, 13.0), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize="small", wrap=True)
    panels: list[Axes] = list(figure.subplots(7, 1, sharex=True))
    memory, counts, ages, lateness, processor, frames, lost = panels
    memory.plot(minutes, [sample.rss_mb for sample in samples], label="daemon (RSS)")
    for name in sorted({name for sample in samples for name in sample.workers_pss_mb}):
        of_worker = [sample.workers_pss_mb.get(name, float("nan")) for sample in samples]
        memory.plot(minutes, of_worker, label=f"{name} (PSS)")
    counts.plot(minutes, [sample.descriptors for sample in samples], label="descriptors")
    counts.plot(minutes, [sample.threads for sample in samples], label="threads")
    for i, share in enumerate(_SHARES):
        ages.plot(minutes, [sample.ages_ms[i] for sample in samples], label=share, linewidth=0.8)
        lateness.plot(minutes, [sample.lateness_ms[i] for sample in samples], label=share, linewidth=0.8)
    processor.plot(minutes, [sample.cpu_percent for sample in samples], label="daemon")
    processor.plot(minutes, [sample.workers_cpu_percent for sample in samples], label="its processes", linewidth=0.8)
    frames.plot(minutes, [sample.frames_per_s for sample in samples], label="frames per second at a client")
    frames.plot(minutes, [100.0 * sample.valid for sample in samples], label="valid (%)")
    lost.plot(minutes, [sample.missed_polls for sample in samples], label="polls missed")
    lost.plot(minutes, [sample.lost for sample in samples], label="frames lost by clients")
    lost.plot(minutes, [sample.output_lost for sample in samples], label="messages and rows lost")
    ages.set_yscale("log")
    lateness.set_yscale("log")
    for panel, label in zip(
        panels, ("MB", "open", "age at the client (ms)", "lateness of polls (ms)", "% of a core", "", "per 10 s"),
        strict=True,
    ):  # fmt: skip
        panel.set_ylabel(label)
        panel.grid(alpha=0.3)
        panel.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), fontsize="small", ncols=4, frameon=False)
    for panel in (memory, counts, processor, frames, lost):
        panel.set_ylim(bottom=0.0)
    panels[-1].set_xlabel("minutes")
    figure.savefig(path)
