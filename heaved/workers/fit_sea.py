"""``python -m heaved.workers.fit_sea``: the process that fits the sea. No torch here: it starts at once, and small."""

import sys

from heaved.estimation.heave.sea.refit import SeaWindow, look
from heaved.workers.serve import serve

if __name__ == "__main__":
    sys.exit(serve("fitter", SeaWindow, look))
