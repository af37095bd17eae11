"""Room 'reduce', being built."""
