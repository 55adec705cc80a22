"""Deformation of the hull between two IMUs."""
