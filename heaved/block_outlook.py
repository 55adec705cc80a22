"""Predictions of the samples of a block, from what its beginning and its samples so far have shown.

All samples of a block (:mod:`heaved.estimation.rock.blocks`) have the curve in common that was predicted when it began;
what is predicted from one of them is linear in that and in what was not expected of the samples up to it. So it is kept
as that, and worked out for whoever asks: at once for a publisher, many blocks at a time for a replay.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import msgspec
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class BlockMaps(msgspec.Struct, frozen=True, eq=False):
    """How predictions follow from a :class:`BlockOutlook`: for S places, H horizons, n channels; never written to."""

    weights: Array
    """(n, S, H, nodes + S - 1): by places, of a channel's [curve | innovations]."""
    slopes: Array
    """(S, H, nodes): what a place more adds, of the curve."""
    gates: Array
    """(S - 1, n): largest innovation of each place but the first that is believed."""

    def believed(self, innovations: Array) -> Array:
        """(..., S - 1, n): those that are no spikes; what is not known (nan) is nothing."""
        return np.where(np.abs(innovations) <= self.gates, innovations, 0.0)


class BlockOutlook:
    """Where a block's predictions come from; they are linear in it, and worked out when somebody asks for them.

    ``curve`` (nodes, n): predicted when the block began; nobody writes to it. ``innovations``: what was not expected of
    the samples since, S - 1 times n; nan: not there. Each is put in once, and none but those up to its place matters to
    a prediction: so it is the same whenever it is worked out.
    """

    __slots__ = ("curve", "innovations", "maps")

    def __init__(self, curve: Array, innovations: list[float], maps: BlockMaps) -> None:
        self.curve, self.innovations, self.maps = curve, innovations, maps

    def at(self, place: int, off: float) -> Array:
        """Predictions (H, n) of the sample at a place, which came ``off`` places later than it should."""
        maps = self.maps
        believed = maps.believed(np.array(self.innovations).reshape(maps.gates.shape))
        state = np.concatenate((self.curve, believed))
        found: Array = (maps.weights[:, place] @ state.T[:, :, None])[:, :, 0].T
        return found + off * (maps.slopes[place] @ self.curve) if off else found


Moment = tuple[BlockOutlook, int, float]
"""A sample of a block: which it is of those that it should have, and how many places later than that it came."""


def worked_out(asked: Sequence[Moment | Array]) -> Array:
    """Predictions (N, H, n) of N moments; those that are known (H, n) are taken as they are.

    At once, which is much less work than one after the other.
    """
    found: list[Array] = []
    for maps, alike in groupby(asked, key=lambda one: one[0].maps if isinstance(one, tuple) else None):
        same = list(alike)
        found.append(np.array(same) if maps is None else _mapped(maps, same))
    return found[0] if len(found) == 1 else np.concatenate(found)


def _mapped(maps: BlockMaps, moments: Sequence[Moment | Array]) -> Array:
    """Of moments that have the same maps, (N, H, n)."""
    blocks, places, late = zip(*moments, strict=True)
    outlooks = list(dict.fromkeys(blocks))
    index = dict(zip(outlooks, range(len(outlooks)), strict=True))
    place, block = list(places), [index[outlook] for outlook in blocks]
    curves = np.array([outlook.curve for outlook in outlooks])  # (B, nodes, n)
    innovations = np.array([outlook.innovations for outlook in outlooks])
    believed = maps.believed(innovations.reshape(-1, *maps.gates.shape))
    state = np.concatenate((curves, believed), axis=1).transpose(2, 1, 0)
    n, count, horizons, width = maps.weights.shape
    made = maps.weights.reshape(n, -1, width) @ state
    found: Array = made.reshape(n, count, horizons, -1)[:, place, :, block].transpose(0, 2, 1)
    if any(late):
        nodes = curves.shape[1]
        slopes = maps.slopes.reshape(-1, nodes) @ curves.transpose(1, 0, 2).reshape(nodes, -1)
        found += np.array(late)[:, None, None] * slopes.reshape(count, horizons, -1, n)[place, :, block]
    return found
