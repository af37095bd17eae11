"""Textbook kernels of linear algebra: arrays in, arrays out, no values and no policy."""
