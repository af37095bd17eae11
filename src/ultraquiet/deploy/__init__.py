"""Room 'deploy', being built."""
