"""``python -m evidence.fuzz_run TARGET MODULE,... ...``: libFuzzer on one target, in a process of its own, which it
ends. Led by the branches of the modules. What follows is libFuzzer's.
"""

from __future__ import annotations

import os
import sys
from functools import partial

import atheris

with atheris.instrument_imports(include=sys.argv[2].split(",")):
    from evidence.fuzz_targets import TARGETS, run


NICENESS = 10

if __name__ == "__main__":
    os.nice(NICENESS)
    atheris.Setup([sys.argv[0], *sys.argv[3:]], partial(run, TARGETS[sys.argv[1]]))
    atheris.Fuzz()
