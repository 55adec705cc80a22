"""The recorder: a process of its own that keeps what was polled and what came of it, and the reading of its files."""
