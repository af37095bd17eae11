"""Room `limits`: what no linear controller can exceed on a given plant.

May be changed here: the limits that are computed and how. Nothing here designs a controller.
"""

__all__: list[str] = []
