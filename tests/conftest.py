"""Before numpy is loaded: one BLAS thread, as the daemon runs."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
