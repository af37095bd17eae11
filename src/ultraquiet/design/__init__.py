"""Room 'design', being built."""
