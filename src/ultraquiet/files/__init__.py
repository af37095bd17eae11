"""Room 'files', being built."""
