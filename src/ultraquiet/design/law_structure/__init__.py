"""Forms a law can be given, and the plane in which such laws are searched."""
