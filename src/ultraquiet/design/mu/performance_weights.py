"""What the norm of a scaled loop says of S, T and KS: mu synthesis' weights on the loop itself."""

from collections.abc import Mapping

from ultraquiet.analyse.plant_scale import EvenPlant
from ultraquiet.values.state_space import StateSpace


def on_loop(weights: Mapping[str, StateSpace], channels: tuple[int, ...]) -> dict[str, StateSpace]:
    """Return weights W with ||W M|| <= b for M = S, T and KS, b the norm ||D F(P, K) D^-1|| of the scaled loop.

    F is the loop from (d, w) to (the weighted errors, Wp S w, Wc K S w), and the scaling of its last block, that of
    performance, is one: sigma(Wp S) <= b and sigma(Wc K S) <= b at every frequency, for the model itself. The errors
    Wi K S G and Wo T are scaled channel by channel, so that only the entries on their diagonals keep their sizes and b
    bounds no direction; with one sensor the entry is all of Wo T, and with one actuator besides it is all of Wi T.

    Args:
        weights: `performance` Wp, `on_inputs` Wi, and where there are such `control` Wc and `on_outputs` Wo.
        channels: outputs and inputs of the plant.

    Doyle 1982, doi:10.1049/ip-d.1982.0053.
    """
    found = {"S": weights["performance"]}
    if "control" in weights:
        found["KS"] = weights["control"]
    if channels[0] == 1 and "on_outputs" in weights:
        found["T"] = weights["on_outputs"]
    elif tuple(channels) == (1, 1):
        found["T"] = weights["on_inputs"]
    return found


def in_units(found: Mapping[str, StateSpace], even: EvenPlant) -> dict[str, StateSpace]:
    """Return the same for the plant whose even one Ge = Y G U the loop was designed with.

    Se = Y S Y^-1 and Ke Se = U^-1 K S Y^-1, hence sigma(Wp Y S) <= b max(Y) and sigma(Wc U^-1 K S) <= b max(Y); of one
    sensor T is the same in any unit.

    Args:
        found: weights on the functions of the even plant's loop.
        even: Ge with Y, `outputs`, and U, `inputs`.
    """
    largest = float(even.outputs.max())
    moved = even.weights(found["S"], found.get("KS", found["S"]))
    units = {"S": (1 / largest) * moved["performance"], "KS": (1 / largest) * moved["control"]}
    return {**found, **{name: W for name, W in units.items() if name in found}}
