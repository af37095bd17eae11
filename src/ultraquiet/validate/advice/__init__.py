"""What is wrong with a record or a model, and what to do about it: records in one file, models in the other."""
