"""Laws of a few scalar loops: in given directions, by symmetry, by modes."""
