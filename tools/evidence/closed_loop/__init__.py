"""A hook under a winch that the stream drives: live through sockets, or replayed."""
