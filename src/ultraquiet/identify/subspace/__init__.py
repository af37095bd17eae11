"""State-space models: subspaces first, prediction error after."""
