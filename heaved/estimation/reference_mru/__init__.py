"""An existing motion reference unit beside ours."""
