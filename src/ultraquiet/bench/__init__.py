"""Room 'bench', being built."""
