"""A recording through the very pipeline of the daemon, and its results as a table."""
