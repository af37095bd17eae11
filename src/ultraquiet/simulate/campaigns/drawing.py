"""A bench of its own for every case of a campaign."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ultraquiet._base.constraints import whole
from ultraquiet._base.errors import InputError
from ultraquiet.bench import Bench, Blended, Decimated

WHO = "campaign"


def drawn_bench(bench: Bench, seed: int) -> Bench:
    """Return a bench of the same kind, drawn within its tolerances by a seed, with noise of its own.

    A bench can be drawn when it offers `drawn(seed)`. What stands around a bench is put around the drawn one.

    Raises:
        InputError: the bench does not offer it.

    >>> import ultraquiet as uq
    >>> drawn_bench(uq.bench.Hexapod(unit="flight"), 7).unit_seed
    7
    """
    checked = whole(WHO, "seed", seed, 0)
    if isinstance(bench, Blended | Decimated):
        return replace(bench, bench=drawn_bench(bench.bench, checked))
    draw = getattr(bench, "drawn", None)
    if not callable(draw):
        raise InputError(
            f"{WHO}: a {type(bench).__name__} cannot be drawn; give it a method 'drawn(seed)' that returns a bench of "
            f"its kind with other parameters and other noise."
        )
    return draw(checked)  # type: ignore[no-any-return]


def drawn_parameters(bench: Bench) -> dict[str, float]:
    """Return the parameters of a drawn bench by name, as its `drawn_parameters()` tells them; none where it has none.

    They are for saying what drives a result, never for making one.
    """
    told: Any = getattr(bench, "drawn_parameters", None)
    if not callable(told):
        return {}
    found = told()
    if not isinstance(found, Mapping):
        raise InputError(f"{WHO}: 'drawn_parameters()' must return a mapping of names to numbers.")
    return {str(name): float(value) for name, value in found.items()}
