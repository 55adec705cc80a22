"""Backtest: an archive of recordings through the pipeline, with each of some configurations, on many processors.

``units`` says what is one piece of work, ``task`` does one, ``distribute`` has them done by Dask, ``compare`` sets
configurations beside each other, ``table`` and ``page`` write what came of it; ``backtest`` is the whole, in order.
"""
