"""Commands on a loop of a plant and a law: what can be said of it, and what it does."""
