"""Stages that are made beside the walk, and the process that makes them."""
