"""Benchmarks: each module measures one promise and says whether it is kept. Run with `make bench`."""
