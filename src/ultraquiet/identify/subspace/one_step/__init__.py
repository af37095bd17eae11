"""The least one-step error: its states from the past alone, its other starts, the method."""
