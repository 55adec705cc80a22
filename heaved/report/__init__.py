"""A recording as a page that one puts into a sea-trial report: what the sea was, and how well what was known of it.

The recording goes through the very pipeline of the daemon, as in a replay. :mod:`heaved.report.collect` takes down what
comes out of it, in memory that does not grow with the recording; :mod:`heaved.report.findings` is what it comes to, in
numbers; :mod:`heaved.report.figures` draws and :mod:`heaved.report.page` writes.
"""
