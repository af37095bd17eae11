"""One page a file, in the order of the data."""
