"""What a laser gauge teaches: lag, scale, what is left, and how sure all of it is."""
