"""Compilers, and the processors they compile for."""
