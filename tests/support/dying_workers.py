"""Work for the processes of a backtest that ends them. In a module of its own, which they can load."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING

from heaved.backtest.task import perform

if TYPE_CHECKING:
    from heaved.backtest.task import Result, Task


def killed_once(task: Task) -> Result:
    """The first to take the task of a file with ``victim`` in its name is killed before it has a result; whoever takes
    one with ``deadly``, each time.
    """
    if "victim" in task.name:
        mark = Path(task.results) / "killed"
        try:
            mark.touch(exist_ok=False)
        except FileExistsError:
            return perform(task)
        os.kill(os.getpid(), signal.SIGKILL)
    if "deadly" in task.name:
        os.kill(os.getpid(), signal.SIGKILL)
    return perform(task)
