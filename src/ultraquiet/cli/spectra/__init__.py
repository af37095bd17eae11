"""The command `spectra` and what it shows."""
