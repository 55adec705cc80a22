"""Programs that only read the stream."""
