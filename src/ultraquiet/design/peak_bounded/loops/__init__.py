"""Loops of a search: plants on lines, how a law stands on them, and what stands between the lines."""
