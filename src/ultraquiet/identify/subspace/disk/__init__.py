"""Subspace models of records that stay on disk, read in blocks."""
