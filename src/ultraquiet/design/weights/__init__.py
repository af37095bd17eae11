"""Weights of a design: filters, and how they are given."""
