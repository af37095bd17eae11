"""The compiler of this machine, and the processors that the code is built for and run on by an emulator.

A folder here is a family of processors: `processors.py` with its `Family` and its table `TARGETS`, and the templates of
what it puts around the code (`harness.c.j2`, `memory.ld.j2`, `rules.mk.j2`, `toolchain.cmake.j2`).
"""
