"""Why a plant cannot be stabilised: modes that its inputs do not reach or its outputs do not show."""

from typing import Literal

import numpy as np

from ultraquiet._base.constraints import same_rate
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown.line import counted
from ultraquiet.linalg.even import even_states
from ultraquiet.linalg.ordered import Array
from ultraquiet.values.state_space import StateSpace

RANK = 1e-9  # relative; a pencil with a singular value below it has lost rank
ROUNDS = 4  # of scaling channels and states in turn
ELSEWHERE = 2.7  # of the largest entry of A: where a plant of full rank has no zero but by chance
BORDER = 1e-11  # a pole nearer to the stability boundary than this counts as unstable: integrators in round-off


def lost_modes(who: str, plant: StateSpace, inputs: str = "B", outputs: str = "C") -> str:
    """Return one sentence about the unstable modes that no controller can move, naming B or C; empty when none is lost.

    Hautus: a mode z is out of reach when [A - zI, B] loses rank, unseen when [A' - zI, C'] does.
    """
    plant = _unit(plant)
    poles = plant.poles()
    unstable = poles[poles.real >= -BORDER if plant.rate_hz is None else np.abs(poles) >= 1 - BORDER]
    for lacking, A, B, wires in (
        ("is out of reach of the inputs", plant.A, plant.B, inputs),
        ("does not show in the outputs", plant.A.T, plant.C.T, outputs),
    ):
        lost = [z for z in unstable if loses_rank(np.hstack([A - z * np.eye(len(A)), B]))]
        if lost:
            return (
                f"{who}: an unstable mode of the plant, {place(lost[0], plant.rate_hz)}, {lacking} ({wires}), so no "
                "controller can stabilise it; remove it from the model or act on it."
            )
    return ""


def lost_integrators(who: str, plant: StateSpace, end: Literal["input", "output"], mend: str) -> str:
    """Return one sentence when pure integrators at one end of the plant cannot be stabilised; empty when all is well.

    They can be when [A - I, B; C, D], in continuous time with A, has full rank: behind the plant that of its rows,
    which takes as many inputs as outputs at least, before it that of its columns, and no zero at 0 Hz.

    Args:
        who: opens the sentence.
        plant: G.
        end: where there is one on every channel.
        mend: what to do about it, which closes the sentence.
    """
    ny, nu = plant.D.shape

    def lost(z: float) -> bool:
        pencil = np.block([[plant.A - z * np.eye(plant.states), plant.B], [plant.C, plant.D]])
        return loses_rank(pencil if end == "output" else pencil.T)

    if not lost(0.0 if plant.rate_hz is None else 1.0):
        return ""
    why = "it has a zero at 0 Hz"
    if nu < ny if end == "output" else ny < nu:
        why = f"it has {counted(nu, 'input')} for {counted(ny, 'output')}"
    elif lost(ELSEWHERE * float(np.abs(plant.A).max(initial=1.0))):
        why = "at no frequency does it answer in as many directions as it has channels"
    where = "in every output" if end == "output" else "to every input"
    return (
        f"{who}: the plant does not answer at 0 Hz {where} ({why}), so the pure integrators of 'integral_hz' "
        f"cannot be stabilised; {mend}."
    )


def _unit(plant: StateSpace) -> StateSpace:
    """Return a plant with states evened out and every column of B and row of C of norm one, for its poles alone.

    In far units of a channel or a state what reaches a mode looks like rounding. Each scaling changes the other.
    """
    A, B, C = plant.A, plant.B, plant.C
    for _ in range(ROUNDS):
        B = B / np.maximum(np.linalg.norm(B, axis=0), np.finfo(float).tiny)
        C = C / np.maximum(np.linalg.norm(C, axis=1, keepdims=True), np.finfo(float).tiny)
        A, B, C, _ = even_states(A, B, C)
    return StateSpace(A, B, C, plant.D, plant.rate_hz)


def stable_weight(who: str, name: str, weight: StateSpace, plant: StateSpace) -> StateSpace:
    """Return a weight or shaping filter at the plant's rate, all its poles inside the stability region.

    Raises:
        InputError: a pole lies on the boundary or beyond, which no controller moves, for it stands outside the loop.
    """
    same_rate(who, "the plant", plant.rate_hz, f"'{name}'", weight.rate_hz)
    poles = weight.poles()
    gap = -poles.real if weight.rate_hz is None else 1 - np.abs(poles)
    if gap.size and gap.min() <= BORDER:
        worst = poles[np.argmin(gap)]
        raise InputError(
            f"{who}: '{name}' has a pole on or beyond the stability boundary, {place(worst, weight.rate_hz)}; "
            "move it inside, or ask for integral action in the loop."
        )
    return weight


def loses_rank(pencil: Array) -> bool:
    """Return whether the rows of a matrix are dependent, each taken at unit size."""
    if not pencil.size:
        return False
    s = np.linalg.svd(pencil / np.maximum(np.linalg.norm(pencil, axis=1, keepdims=True), 1e-300), compute_uv=False)
    return bool(len(s) < len(pencil) or not s[-1] > RANK * s[0])


def place(z: complex, rate_hz: float | None) -> str:
    """Return where a pole lies, in words."""
    if rate_hz is None:
        return f"at {z.real:.3g}{z.imag:+.3g}j rad/s"
    return f"at {abs(np.angle(z)) * rate_hz / (2 * np.pi):.4g} Hz with |z| = {abs(z):.6g}"
