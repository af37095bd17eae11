"""Room 'signals', being built."""
