"""Roll and pitch ahead: the published method, the direct predictor, a hull that shakes, quiet windows."""
