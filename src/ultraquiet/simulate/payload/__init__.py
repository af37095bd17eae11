"""What the payload feels of a shaken base and of a force on itself, with the law and without it."""
