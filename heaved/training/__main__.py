"""``python -m heaved.training``: the trainer process."""

import sys

from heaved.training.worker import main

if __name__ == "__main__":
    sys.exit(main())
