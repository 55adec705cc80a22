"""The sea observer, the default: a filter on the measured spectrum of the sea."""
