"""Stages that are made beside the walk, the process that makes them, and the code of a law."""
