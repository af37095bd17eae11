"""What was done by hand, written down: as Python, as a study file."""
