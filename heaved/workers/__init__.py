"""Processes that learn for the daemon: fits, and training, the only place of torch."""
