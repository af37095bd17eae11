"""Values as python-control, SciPy, pandas and xarray have them, and back; each package is loaded when asked for."""
