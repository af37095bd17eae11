"""A law in other programs' formats: MAT, HDF5, CSV, foton, FMU, CMake."""
