"""Sweeps and what a run leaves when it ends."""
