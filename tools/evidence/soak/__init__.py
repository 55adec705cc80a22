"""The daemon's process under load for hours: what is put on it, what it uses, whether that grows."""
