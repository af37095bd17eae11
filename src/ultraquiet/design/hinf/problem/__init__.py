"""The H-infinity problem before it is solved: its units, its hidden states, the weights that it lacks."""
