"""Room 'analyse', being built."""
