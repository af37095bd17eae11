"""Room 'identify', being built."""
