"""The harmonic observer of the paper: an inertial displacement, and a filter on a few lines."""
