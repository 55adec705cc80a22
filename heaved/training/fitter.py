"""``python -m heaved.training.fitter``: the process that fits the sea. No torch here: it starts at once, and small."""

import sys

from heaved.estimation.sea_window import SeaWindow, look
from heaved.training.worker import serve

if __name__ == "__main__":
    sys.exit(serve("fitter", SeaWindow, look))
