"""Pure estimators: numpy and scipy only; time, bytes and randomness are arguments. `README.md` says what is where."""
