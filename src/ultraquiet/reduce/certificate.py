"""The certificate of a reduction: the loop closed again with the finished controller, and what that cost."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ultraquiet._base.constraints import FloatArray, same_rate
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet._base.shown.line import counted
from ultraquiet.analyse.norms import h2_norm, hinf_norm
from ultraquiet.linalg.cost import multiply_adds
from ultraquiet.reduce._abstract import ReductionResult, Weights
from ultraquiet.reduce.promises import Judge, Promise
from ultraquiet.values.generalised import four_block, full, output_shaping
from ultraquiet.values.interconnect import feedback, gain, lft
from ultraquiet.values.joined.wires import unswapped
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

NORMS = ("peak", "mean-square")


def judging_plant(plant: StateSpace, weights: Weights) -> StateSpace:
    """Return the generalised plant by which a loop is judged.

    Args:
        plant: G.
        weights: the mapping `details["weights"]` of a design (`performance`, `control` and perhaps `complementary`);
            one weight on the plant's outputs; a whole generalised plant; or None for the bare four-block cost.
    """
    ny, nu = plant.D.shape
    one = gain(np.eye(1), plant.rate_hz)
    if isinstance(weights, Mapping):
        third = weights.get("complementary")
        return output_shaping(
            plant,
            full(weights.get("performance", one), ny, "performance"),
            full(weights.get("control", one), nu, "control"),
            None if third is None else full(third, ny, "complementary"),
        )
    if weights is not None and weights.D.shape[0] > ny and weights.D.shape[1] > nu:
        return weights
    on_output = full(weights if weights is not None else one, ny, "weights")
    return four_block(plant, on_output, full(one, nu, "control"), np.eye(nu), np.eye(ny))


def fits(who: str, controller: StateSpace, plant: StateSpace) -> None:
    """Refuse a controller that cannot close the loop round the plant."""
    same_rate(who, "the controller", controller.rate_hz, "the plant", plant.rate_hz)
    if controller.D.shape != plant.D.shape[::-1]:
        raise InputError(
            f"{who}: the controller is {controller.D.shape[0]} x {controller.D.shape[1]} (outputs x inputs), the plant "
            f"{plant.D.shape[0]} x {plant.D.shape[1]}; u = K y needs {plant.D.shape[1]} x {plant.D.shape[0]}."
        )
    unswapped(who, controller, plant)


def loop_norm(loop: StateSpace, norm: str) -> float:
    """Return the H-infinity (`peak`) or H2 (`mean-square`) norm; infinite for an unstable loop."""
    return h2_norm(loop) if norm == "mean-square" else hinf_norm(loop)[0]


def certified(
    controller: StateSpace,
    small: StateSpace,
    hankel: FloatArray,
    *,
    P: StateSpace | None,
    norm: str = "peak",
    before: float | None = None,
    allowed: float | None = None,
    budget: int | None = None,
    details: Mapping[str, Any] | None = None,
) -> ReductionResult:
    """Close the loop P with the full and with the reduced controller and word the verdict.

    Args:
        controller: the full one.
        small: the reduced one, its provenance that of the result.
        hankel: the values by which states were kept.
        P: generalised plant by which the loop is judged; None for a reduction without a loop.
        norm: `peak` or `mean-square`.
        before: norm with the full controller, when it is known already.
        allowed: largest relative growth of the norm.
        budget: multiply-adds a step may cost.
        details: what else the method has to say.
    """
    after, poles = float("nan"), np.zeros(0, dtype=np.complex128)
    if P is None:
        before = float("nan")
    else:
        loop = lft(P, small)
        poles, after = loop.poles(), loop_norm(loop, norm)
        before = loop_norm(lft(P, controller), norm) if before is None else before
    nu, ny = small.D.shape
    loss = after / before - 1 if before else 0.0
    proof = {
        "stable": None if P is None else bool(np.isfinite(after)),
        "norm": norm,
        "before": before,
        "after": after,
        "loss_percent": 100 * loss,
        "allowed_percent": None if allowed is None else 100 * allowed,
        "states": small.states,
        "multiply_adds": multiply_adds(small.states, ny, nu),
        "budget": budget,
    }
    more = {**(details or {}), "poles": poles, "certificate": proof}
    status = _verdict(controller, proof, more.get("bound"))
    return ReductionResult(status, small, hankel, before, after, more, provenance=small.provenance or Provenance())


def held(
    result: ReductionResult,
    controller: StateSpace,
    plant: StateSpace,
    promise: Promise,
    judge: Judge | None = None,
) -> ReductionResult:
    """Return a reduction judged by what the full law did for its loop; as it is where there is no loop, or none left.

    Args:
        result: of a reduction; its status becomes `loss` where a promise is broken.
        controller: the full law.
        plant: G.
        promise: what must be left.
        judge: of this promise, where there is one already.
    """
    if result.status.word is StatusWord.UNSTABLE or not feedback(plant, controller).is_stable():
        return result
    judge = judge or Judge(plant, controller, promise)
    after = judge.of(result.controller)
    broken = judge.broken(after)
    status = result.status
    if broken:
        sentence = f"{status.sentence} More than {promise.loss_db:g} dB of what was promised is lost: "
        status = Status(StatusWord.LOSS, f"{sentence}{'; '.join(broken)}. Keep more states.")
    return replace(result, status=status, before=judge.before, after=after, broken=broken)


def kept_promise(result: ReductionResult, controller: StateSpace, plant: StateSpace | None) -> ReductionResult:
    """Return a reduction judged by all that the full law did for the plant's loop; as it is where no plant is given."""
    return result if plant is None else held(result, controller, plant, Promise.of(controller))


def _verdict(controller: StateSpace, proof: Mapping[str, Any], bound: float | None) -> Status:
    cost = f"{proof['multiply_adds']} multiply-adds a step"
    kept = f"{proof['states']} of {counted(controller.states, 'state')} kept, {cost}"
    if bound is not None:
        kept += f"; the error is at most {bound:.3g}"
    if proof["stable"] is None:
        return Status(StatusWord.OK, f"{kept}.")
    if not proof["stable"]:
        return Status(StatusWord.UNSTABLE, f"{kept}; the loop is unstable with so few, keep more or weigh by the loop.")
    moved = (
        f"{kept}; the loop is stable, its {proof['norm']} norm moves from {proof['before']:.4g} to {proof['after']:.4g}"
    )
    allowed, budget = proof["allowed_percent"], proof["budget"]
    if budget is not None and proof["multiply_adds"] > budget:
        return Status(StatusWord.LOSS, f"{moved}, but the budget is {budget}; allow more loss or a larger budget.")
    if allowed is not None and proof["loss_percent"] > allowed:
        within = "" if budget is None else f" within {budget} multiply-adds"
        return Status(
            StatusWord.LOSS,
            f"{moved}, {proof['loss_percent']:.1f} % where {allowed:g} % are allowed{within}; keep more states.",
        )
    return Status(StatusWord.OK, f"{moved} ({proof['loss_percent']:+.2f} %).")
