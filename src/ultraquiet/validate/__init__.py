"""Room 'validate', being built."""
