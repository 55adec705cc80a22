"""Heave: every estimator over every scenario, on a hull that shakes, and with a learned correction in use."""
