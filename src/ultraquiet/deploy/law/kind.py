"""Is it a law? What gives a plant away that is handed over in place of one."""

import re

from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import methods
from ultraquiet.spectra.motion import LADDERS
from ultraquiet.values import Channel, StateSpace

# Who makes models of plants: the methods of identification, by their registered names, and benches.
MODELS_OF_PLANTS = ("identify.", "bench.")
SYNTHESES = "synthesize_"  # functions that make laws begin so
MOTION = {unit for ladder in LADDERS for unit in ladder} | {"g", "rad", "rad/s", "rad/s²", "rad/s^2", "Pa"}
ACTUATING = re.compile(r"actuator|shaker|exciter|stack|piezo|coil|motor|thruster|force|torque|drive|current", re.I)
SENSING = re.compile(
    r"sensor|geophone|accelerometer|gyro|encoder|gauge|microphone|acceleration|velocity|speed|displacement|position",
    re.I,
)


def require_law(controller: StateSpace, plant: StateSpace | None = None) -> None:
    """Refuse a system that is a plant: made by identification or a bench, or driven by actuators and read by sensors.

    A law made by a design names the sensors as what goes in and the actuators as what comes out. Systems without a
    history and without names that tell are taken for what they are called. Names and units alone give nothing away
    where more is known: forces may be measured and motions commanded, so that what a design made is a law, and so is
    what mirrors the channels of its plant.

    Args:
        controller: what is to become code.
        plant: G of its loop, where it is known: the same system cannot be both.

    Raises:
        InputError: with what gave it away.
    """
    reason, unless = _history(controller) or _same(controller, plant), ""
    if reason is None and not _mirrors(controller, plant):
        reason = _channels(controller)
        if reason is None or _designed(controller):
            return
        unless = " A law whose channels are such is told from a plant by that of its loop: give `plant`."
    if reason is not None:
        raise InputError(
            f"deploy: this is a plant, not a law: {reason}; give what `design` made of it (u = K y: sensors go in,"
            f" commands come out).{unless}"
        )


def swapped(plant: StateSpace, law: StateSpace) -> str | None:
    """Return what gives away that a plant and its law stand in each other's place, None where nothing does.

    Forces may be measured and motions commanded: where the names say so, or a plant was identified or a law designed,
    units give nothing away.

    >>> pushed = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], 10.0, [Channel("f", "N")], [Channel("a", "m/s^2")])
    >>> law = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], 10.0, [Channel("a", "m/s^2")], [Channel("f", "N")])
    >>> swapped(law, pushed), swapped(pushed, law)
    ("'f' in N goes in and 'a' in m/s^2 comes out", None)
    """
    if _history(plant) is not None or _designed(law) or _any(SENSING, law.actuators) or _any(ACTUATING, law.sensors):
        return None
    return _channels(law) if _mirrors(law, plant) else None


def _history(system: StateSpace) -> str | None:
    maker = system.provenance.made_by
    made = maker in methods("identify") or maker.startswith(MODELS_OF_PLANTS)
    return f"it was made by '{maker}'" if made else None


def _designed(system: StateSpace) -> bool:
    maker, kinds = system.provenance.made_by, methods("design")
    return maker in {*kinds, *(kind.__name__ for kind in kinds.values())} or maker.startswith(SYNTHESES)


def _mirrors(controller: StateSpace, plant: StateSpace | None) -> bool:
    """Return whether the plant's sensors go in and its actuators come out, by name and unit.

    A plant mirrors its law as well: what a design made is not the plant.
    """
    if plant is None or _designed(plant):
        return False
    pairs = ((controller.actuators, plant.sensors), (controller.sensors, plant.actuators))
    return all([(c.name, c.unit) for c in a] == [(c.name, c.unit) for c in b] for a, b in pairs)


def _channels(system: StateSpace) -> str | None:
    into, out = system.actuators, system.sensors
    if all(c.unit in MOTION for c in out) and not any(c.unit in MOTION for c in into):
        return f"'{into[0].name}' in {into[0].unit} goes in and '{out[0].name}' in {out[0].unit} comes out"
    if _all(ACTUATING, into) and _all(SENSING, out) and not _any(SENSING, into) and not _any(ACTUATING, out):
        return f"'{into[0].name}' goes in and '{out[0].name}' comes out"
    return None


def _same(controller: StateSpace, plant: StateSpace | None) -> str | None:
    if plant is None:
        return None
    if controller.states and controller.hash == plant.hash:
        return "it is the plant of the loop itself"
    ends = [[c.name for c in wires] for wires in (plant.actuators, plant.sensors)]
    own = [[c.name for c in wires] for wires in (controller.actuators, controller.sensors)]
    numbered = all(
        name == f"{word} {k + 1}"
        for word, end in zip(("input", "output"), ends, strict=True)
        for k, name in enumerate(end)
    )
    if own == ends and ends[0] != ends[1] and not numbered:
        return f"'{own[0][0]}' goes in and '{own[1][0]}' comes out, as of the plant of the loop"
    return None


def _all(words: re.Pattern[str], wires: tuple[Channel, ...]) -> bool:
    return all(words.search(c.name) for c in wires)


def _any(words: re.Pattern[str], wires: tuple[Channel, ...]) -> bool:
    return any(words.search(c.name) for c in wires)
