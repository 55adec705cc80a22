"""The daemon: which parts there are, how they start and stop, what is said of them."""
