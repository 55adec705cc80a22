"""Learning where it falls due, as a replay does it: before the next sample."""

from __future__ import annotations

from typing import TYPE_CHECKING

from heaved.estimation.heave.sea.refit import look

if TYPE_CHECKING:
    from heaved.pipeline import Pipeline


def learn(pipeline: Pipeline) -> None:
    """Do the fit of the sea and the training that are due."""
    if (past := pipeline.fit_due()) is not None:
        pipeline.accept_fit(look(past))
    if (window := pipeline.training_due()) is not None:
        # Loads torch, which takes seconds: only where there is a laser to learn from.
        from heaved.workers.train_correction import fit

        pipeline.accept(fit(window))
