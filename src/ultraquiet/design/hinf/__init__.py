"""H-infinity synthesis: levels, Riccati equations, bounds, and the methods that stand on them."""
