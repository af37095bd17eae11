"""Room 'spectra', being built."""
