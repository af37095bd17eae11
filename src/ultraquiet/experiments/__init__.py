"""Room 'experiments', being built."""
