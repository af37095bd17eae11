"""A law in whole numbers: bounds, twin, deployment, word lengths."""
