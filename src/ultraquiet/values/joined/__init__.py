"""Systems joined by operators, names and units kept."""
