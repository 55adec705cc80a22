"""The heave: observers of the vertical acceleration, and what a laser teaches them."""
