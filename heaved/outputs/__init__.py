"""Everything that leaves the daemon: the TCP stream, metrics and health over HTTP."""
