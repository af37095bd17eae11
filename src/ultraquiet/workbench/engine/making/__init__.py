"""How items are made: what the pipeline does, called for one item at a time."""
