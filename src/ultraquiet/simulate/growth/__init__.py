"""Several records of a loop judged together, and what one says: how its slowest modes grow or decay."""
