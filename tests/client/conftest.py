"""Publishers and peers of the stream, started and ended for a test."""

from stream_peers import connect, serve

__all__ = ["connect", "serve"]
