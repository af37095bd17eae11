"""The command `deploy` and what it prints."""
