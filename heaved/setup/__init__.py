"""From a box to a service: what is done once, before the daemon runs."""
