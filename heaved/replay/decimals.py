"""Tables of numbers as text with six decimals, a block of rows at a time.

A table of a replay is mostly digits, and ``"%.6f"`` works out one number at a time what is the same for all of them:
with the unit of the last decimal counted as an integer, a number is three groups of three digits, and each group is
looked up. The text is that of ``"%.6f"`` to the byte; numbers of which that is not certain (four digits before the
point, or halfway between two texts) are left to it.
"""

from __future__ import annotations

from math import isfinite
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Words = NDArray[np.uint32]

UNITS: Final = 1e6
"""Of the last decimal, in one."""
TOO_LARGE: Final = 1e3
"""A fourth digit before the point."""
HALFWAY: Final = 0.5 - 1e-6
"""From here on, a unit's rounding in the product (6e-8 at most) could decide between two texts."""


def _words(texts: list[str]) -> Words:
    """Texts of up to four characters, in four bytes each; zero bytes stand for nothing."""
    return np.frombuffer(b"".join(text.encode().ljust(4, b"\0") for text in texts), np.uint32)


_WHOLE: Final = _words([f"{sign}{i}" for sign in ("", "-") for i in range(1000)])
_FIRST: Final = _words([f".{i:03d}" for i in range(1000)])
_LAST: Final = _words([f"{i:03d}," for i in range(1000)])
_BLANK: Final = np.frombuffer(b",".rjust(12, b"\0"), np.uint32)
"""The comma where each number has it."""


def lines(numbers: Array) -> list[str]:
    """Rows of ``numbers`` (n, k), k >= 1, as lines without their ends: commas between, blank what is not finite."""
    is_finite = np.isfinite(numbers)
    scaled = np.minimum(np.abs(np.where(is_finite, numbers, 0.0)), TOO_LARGE) * UNITS
    rounded = np.rint(scaled)
    is_certain = (rounded < TOO_LARGE * UNITS) & (np.abs(scaled - rounded) < HALFWAY)
    units = np.where(is_certain, rounded, 0.0).astype(np.int32)
    thousands = units // 1000
    whole = thousands // 1000
    words = np.empty((*numbers.shape, 3), np.uint32)
    words[..., 0] = _WHOLE[whole + 1000 * np.signbit(numbers)]
    words[..., 1] = _FIRST[thousands - 1000 * whole]
    words[..., 2] = _LAST[units - 1000 * thousands]
    words[~is_finite] = _BLANK
    words.view(np.uint8)[:, -1, -1] = ord("\n")
    found = words.tobytes().translate(None, b"\0").decode("ascii").split("\n")[:-1]
    for i in np.flatnonzero(~is_certain.all(axis=1)).tolist():
        found[i] = ",".join([cell(value) for value in numbers[i].tolist()])
    return found


def cell(value: float) -> str:
    """One number; blank if not finite."""
    return f"{value:.6f}" if isfinite(value) else ""
