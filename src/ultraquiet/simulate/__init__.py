"""Room 'simulate', being built."""
