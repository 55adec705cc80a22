"""Heave and pitch of a foil-assisted craft, from several sigma-point filters fused."""
