"""Mu synthesis: D-K iteration and its scalings."""
