"""What a command's exit code says."""
