"""Rational models of a measured frequency response."""
