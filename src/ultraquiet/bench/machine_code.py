"""How a kernel calls machine code that it was not compiled with, by its address. Import where it is used.

An address is an argument like any other, so that a kernel is compiled once for all laws.
"""

from importlib import import_module
from typing import Any

from ultraquiet._base.compiled import compiled

types: Any = import_module("numba.core.types")
ir: Any = import_module("llvmlite.ir")
intrinsic: Any = import_module("numba.core.extending").intrinsic


@intrinsic
def _called(_: Any, function: Any, state: Any, readings: Any, commands: Any) -> Any:
    """Emit a call of `void function(void *, const void *, void *)`; all four are addresses."""

    def emit(__: Any, builder: Any, signature: Any, words: Any) -> Any:
        place = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [place] * 3)
        step = builder.inttoptr(words[0], kind.as_pointer())
        builder.call(step, [builder.inttoptr(word, place) for word in words[1:]])
        return words[0]

    return types.intp(*[types.intp] * 4), emit


@compiled
def call_step(function: int, state: int, readings: int, commands: int) -> None:
    """Call `void step(void *state, const real *readings, real *commands)` at the address `function`."""
    _called(function, state, readings, commands)
