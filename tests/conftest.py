"""Before numpy is loaded: one BLAS thread, as the daemon runs. Property tests: the same examples every time, and no
deadline, because the machine may be shared."""

import os

from hypothesis import settings

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
settings.register_profile("shared machine", deadline=None, derandomize=True)
settings.load_profile("shared machine")
