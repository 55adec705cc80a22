"""Training of the residual network: torch lives here and only in the trainer process."""
