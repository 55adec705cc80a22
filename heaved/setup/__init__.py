"""From a box to a service: what is found, measured and written before a daemon can run."""
