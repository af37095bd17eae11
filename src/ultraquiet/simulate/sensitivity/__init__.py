"""The sensitivity matrix measured on a bench: one pair of loops a band, and what all bands say."""
