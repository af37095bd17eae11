"""Work beside the pages, in a process of its own: progress, cancel, and what a kill leaves."""
