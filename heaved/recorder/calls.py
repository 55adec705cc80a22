"""Records that go with calls into the pipeline which are no polls."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np

from heaved.estimation.heave.saved_state import SavedState
from heaved.estimation.heave.sea.refit import SeaFit

_DOUBLE: Final = 8
"""Bytes."""
_ARRAYS: Final = ("x", "P", "steady_covariance", "predicted_m", "innovation", "delayed")
"""Of a fit, as bytes of doubles."""


class Restored(msgspec.Struct, frozen=True, kw_only=True):
    """What an earlier run had learned, and its age in seconds (nan: not known)."""

    state: SavedState
    age_s: float


def pack_fit(fit: SeaFit) -> bytes:
    """A fit of the sea, without loss but for what only the next fit begins with.

    One comes twice a minute, and with fifty kilobytes would be a third of a recording. A covariance is told by half of
    it, and the bytes of doubles are sorted by their place, the first ones alike, which halves what compression leaves.
    """
    candidates = tuple(msgspec.structs.replace(one, steady_covariance=b"") for one in fit.candidates)
    arrays = {name: getattr(fit, name) for name in _ARRAYS}
    covariance = np.frombuffer(fit.steady_covariance)
    n = len(fit.x) // _DOUBLE
    if len(covariance) == n * n:
        square = covariance.reshape(n, n)
        if np.array_equal(square.view(np.int64), square.T.copy().view(np.int64)):
            arrays["steady_covariance"] = square[np.triu_indices(n)].tobytes()
    sorted_bytes = {name: _transposed(data, _DOUBLE) for name, data in arrays.items()}
    return msgspec.msgpack.encode(msgspec.structs.replace(fit, candidates=candidates, **sorted_bytes))


def unpack_fit(record: bytes) -> SeaFit:
    """
    Raises:
        msgspec.MsgspecError: it is none.
    """
    fit = msgspec.msgpack.decode(record, type=SeaFit)
    arrays = {}
    for name in _ARRAYS:
        data = getattr(fit, name)
        if len(data) % _DOUBLE:
            raise msgspec.ValidationError(f"{name} has {len(data)} bytes")
        arrays[name] = _transposed(data, len(data) // _DOUBLE)
    half = np.frombuffer(arrays["steady_covariance"])
    n = len(fit.x) // _DOUBLE
    if n > 1 and len(half) == n * (n + 1) // 2:
        square = np.zeros((n, n))
        square[np.triu_indices(n)] = half
        lower = np.tril_indices(n, -1)
        square[lower] = square.T[lower]
        arrays["steady_covariance"] = square.tobytes()
    return msgspec.structs.replace(fit, **arrays)


def _transposed(data: bytes, width: int) -> bytes:
    """Of rows of ``width`` bytes the columns one after the other."""
    return np.frombuffer(data, np.uint8).reshape(-1, width).T.tobytes() if data else b""
