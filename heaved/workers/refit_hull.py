"""``python -m heaved.workers.refit_hull``: the process that fits the flexure of the hull. No torch here.

A job holds a filter, arrays in objects in arrays; it travels pickled within its frame. That is no risk: both ends are
this program, and the pipe between them is nobody else's.
"""

from __future__ import annotations

import pickle
import sys

import msgspec

from heaved.estimation.hull.refit import RefitJob, RefitResult, refit
from heaved.workers.serve import serve


class HullJob(msgspec.Struct, frozen=True, kw_only=True):
    """A request: a :class:`RefitJob`, pickled."""

    number: int
    body: bytes


class HullFit(msgspec.Struct, frozen=True, kw_only=True):
    """The answer: a :class:`RefitResult` or None, pickled."""

    number: int
    body: bytes


def pack(number: int, job: RefitJob) -> HullJob:
    """``number`` tells the job from others; the answer carries it back."""
    return HullJob(number=number, body=pickle.dumps(job))


def work(job: HullJob) -> HullFit:
    """Refit."""
    return HullFit(number=job.number, body=pickle.dumps(refit(pickle.loads(job.body))))


def unpack(fit: HullFit) -> RefitResult | None:
    """None: the refit was in vain."""
    result = pickle.loads(fit.body)
    assert result is None or isinstance(result, RefitResult)
    return result


if __name__ == "__main__":
    sys.exit(serve("hull fitter", HullJob, work))
