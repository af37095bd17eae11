"""The command `experiment`: the run, its halt and the watch on its levels."""
