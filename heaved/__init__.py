"""heaved: real-time heave and rock prediction for crane vessels."""

__version__ = "0.1.0"
