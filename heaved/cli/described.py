"""The commands and exit codes, described for the manual from what the command line itself knows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer.main

from heaved.manual.tables import TABLES

if TYPE_CHECKING:
    from collections.abc import Callable


def tables() -> dict[str, Callable[[], str]]:
    """All that topics may ask for."""
    return TABLES | {"commands": commands}


def commands() -> str:
    """Each command with its arguments and options."""
    from heaved.cli import app  # It has the command that asks.

    group: Any = typer.main.get_command(app)
    parts = []
    for name, command in group.commands.items():
        context = command.make_context(name, [], resilient_parsing=True)
        records = [param.get_help_record(context) for param in command.params]
        lines = [f"- `{names}`{_told(told)}" for names, told in filter(None, records)]
        usage = " ".join(["heaved", name, *command.collect_usage_pieces(context)])
        told = " ".join((command.help or "").split())
        parts.append("\n".join([f"### {name}", "", f"`{usage}`", "", told, "", *lines, ""]))
    return "\n".join(parts)


def _told(help_text: str) -> str:
    words = " ".join(help_text.split())
    return f": {words}" if words else ""
