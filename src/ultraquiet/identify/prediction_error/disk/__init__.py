"""Records longer than memory: the same minimum, one pass over the file an iteration."""
