"""Plants and laws from files, refused by name where they are something else or do not fit together."""

from pathlib import Path
from typing import TYPE_CHECKING

from ultraquiet._base import registry
from ultraquiet._base.constraints import same_rate
from ultraquiet._base.errors import InputError
from ultraquiet.cli.output.targets import ARCHIVES

if TYPE_CHECKING:
    from ultraquiet.values import StateSpace


def loaded(path: Path, who: str, maker: str) -> object:
    """Return what an archive holds; a file of another kind is refused with who makes an archive of it."""
    from ultraquiet import files

    if path.is_file() and path.suffix.lower() not in ARCHIVES:
        raise InputError(f"{who}: '{path}' is no archive (.h5) of this program; `{maker}` makes one.")
    return files.load(path)


def loaded_plant(path: Path, who: str = "deploy") -> "StateSpace":
    """Return the plant that a file holds, a state space or a model of one."""
    from ultraquiet.values import StateSpace

    model = loaded(path, who, "identify")
    system = model if isinstance(model, StateSpace) else getattr(model, "state_space", lambda: None)()
    if system is None:
        raise InputError(
            f"{who}: '{path}' holds a {type(model).__name__}, not a model of a plant; `identify` makes one of a record."
        )
    if (maker := system.provenance.made_by) in _makers("design"):
        raise InputError(f"{who}: '{path}' holds a controller, made by {maker}; PLANT comes first, its law after it.")
    return system


def loaded_law(path: Path, who: str) -> "StateSpace":
    """Return the controller in state space that a file holds."""
    from ultraquiet.values import StateSpace

    law = loaded(path, who, "design")
    if not isinstance(law, StateSpace):
        raise InputError(
            f"{who}: '{path}' holds a {type(law).__name__}, not a controller in state space; `design` makes one."
        )
    if (maker := law.provenance.made_by) in _makers("identify"):
        raise InputError(f"{who}: '{path}' holds a plant, identified by {maker}; `design` makes a controller for it.")
    return law


def _makers(family: str) -> set[str]:
    """Return what the values that a family's methods made call their maker."""
    kinds = registry.methods(family)
    return {*kinds, *(kind.__name__ for kind in kinds.values())}


def require_fit(who: str, plant: "StateSpace", law: "StateSpace") -> None:
    """Refuse a law of another rate or size than the plant's."""
    same_rate(who, "the law", law.rate_hz, "the plant", plant.rate_hz)
    ny, nu = plant.D.shape
    if law.D.shape == (nu, ny):
        return
    raise InputError(
        f"{who}: the plant has {nu} inputs and {ny} outputs, so a law must take {ny} readings and give {nu} commands; "
        f"this one takes {law.D.shape[1]} and gives {law.D.shape[0]}."
    )


def require_order(path: Path, plant: "StateSpace", law: "StateSpace") -> None:
    """Refuse a plant where its law is to stand, of `analyse PLANT LAW`, where their channels tell."""
    from ultraquiet.deploy.law.kind import swapped

    reason = swapped(plant, law)
    if reason is not None:
        raise InputError(
            f"analyse: '{path}' is the plant: {reason}; PLANT comes first, its law after it. Where motions are "
            f"commanded and forces measured, names say so: 'motion actuator', 'force sensor'."
        )
