"""Laws of a given structure, tuned on the loop."""
