"""Long responses held down by a prior fitted to the data."""
