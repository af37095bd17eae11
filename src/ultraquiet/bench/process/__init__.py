"""A plant in another process: the bench, the line protocol and the pipe or socket it runs over."""
