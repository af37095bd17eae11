"""Several experiments, and ties between channels, in one fit."""
