"""What several estimators use: buffers, sigma points, spectra, rotations, rates of samples, physical bounds."""
