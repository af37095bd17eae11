"""C99 from a law: rendered, compiled, tested by itself, measured."""
