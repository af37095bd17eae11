"""Sensors and actuators blended to modes: matrices, wires, and the value that holds both."""
