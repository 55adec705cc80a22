"""``python -m heaved``"""

import sys

from heaved.cli import main

if __name__ == "__main__":
    sys.exit(main())
