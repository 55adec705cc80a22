"""Loaded by Python itself at the start of a daemon of the campaign, and of its processes: their UTC is that of the
machine plus what stands in a file. So it can be stepped without anybody else noticing.
"""

import mmap
import os
import struct
import time

with open(os.environ["CAMPAIGN_CLOCK"], "rb") as _file:  # noqa: PTH123  # Loaded before anything else is.
    _offset = mmap.mmap(_file.fileno(), 8, access=mmap.ACCESS_READ)
_real, _unpack = time.time, struct.Struct("<d").unpack


def _stepped() -> float:
    (offset_s,) = _unpack(_offset[:8])
    return float(_real() + offset_s)


time.time = _stepped
