"""``python -m heaved.training``: the trainer process."""

import sys

from heaved.samples import TrainingWindow
from heaved.training.fit import fit
from heaved.training.worker import serve

if __name__ == "__main__":
    sys.exit(serve("trainer", TrainingWindow, fit))
