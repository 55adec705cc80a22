"""The whole chain on one machine, with a simulated sea."""
