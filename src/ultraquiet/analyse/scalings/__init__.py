"""Scalings that prove a bound of the structured singular value, and perturbations that prove the other."""
