"""Pure estimators: numpy and scipy only; time, bytes and randomness are arguments."""
