"""What every room stands on: errors, argument checks, the registry of methods, provenance and progress."""
