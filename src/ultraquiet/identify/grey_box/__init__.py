"""Models with the physics' own parameters: struts, modes, threefold symmetry."""
