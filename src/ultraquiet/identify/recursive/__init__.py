"""Estimates that follow a drifting plant sample by sample."""
