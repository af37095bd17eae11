"""Second-order sections fitted to a response: their start, their search, their realisation."""
