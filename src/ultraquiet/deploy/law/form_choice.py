"""Which form to generate: the cheapest whose rounded coefficients still do what the controller did."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet.analyse.loop_response import loop_response
from ultraquiet.deploy.law.law import Law, loop_coupling
from ultraquiet.deploy.law.realisation import FORMS
from ultraquiet.linalg.modes.boundary import on_boundary
from ultraquiet.values.state_space import StateSpace

# 0.5 % of the response or of the loop's sensitivity: 0.04 dB, a tenth of what identification resolves.
TOLERANCE = 5e-3
# Where the response lies 60 dB under its peak the controller does nothing; errors are not magnified beyond that.
FLOOR = 1e-3
GRID = 160
DECADES = 4.0  # below half the sampling rate


@dataclass(frozen=True)
class FormChoice:
    """A rounded law, its error against the original, and what was measured for every form tried."""

    law: Law
    error: float
    tried: dict[str, float]
    condition: float


def choose(
    controller: StateSpace,
    make: Callable[[str], tuple[Law, float]],
    cost: Callable[[Law], int],
    plant: StateSpace | None = None,
    tolerance: float = TOLERANCE,
) -> FormChoice:
    """Return the cheapest form whose error stays within `tolerance`, else the most exact one.

    Args:
        controller: the law as designed.
        make: form -> rounded law and condition number of the eigenvectors.
        cost: rounded law -> instructions of a step.
        plant: when given, the error is that of the loop's sensitivity, else of the law's own response.
        tolerance: largest relative error.

    Raises:
        InputError: no form can be rounded to this precision.
    """
    laws: dict[str, tuple[Law, float, float]] = {}
    sentence = ""
    for form in FORMS:
        try:
            law, condition = make(form)
        except InputError as refusal:
            sentence = str(refusal)
            continue
        laws[form] = (law, error_of(law.state_space(), controller, plant), condition)
    if not laws:
        raise InputError(sentence)
    good = [form for form, (_, error, _) in laws.items() if error <= tolerance]
    best = min(good, key=lambda f: cost(laws[f][0])) if good else min(laws, key=lambda f: laws[f][1])
    law, error, condition = laws[best]
    return FormChoice(law, error, {form: attempt[1] for form, attempt in laws.items()}, condition)


def error_of(rounded: StateSpace, controller: StateSpace, plant: StateSpace | None = None) -> float:
    """Return the largest relative change over frequency from the controller to what rounding left of it.

    Without a plant max_f ||K_r - K|| / ||K||; with one max_f ||S_r - S|| / ||S||, S = (I - G K)^-1; infinity when law
    or loop was stable and no longer is. Spectral norms; ||K|| counts at least 0.1 % of its peak.
    """
    if controller.is_stable() and not rounded.is_stable():
        return float("inf")
    if plant is None:
        f_hz = _grid(controller.poles(), controller.rate_hz or 0.0)
        exact, coarse = (_points_first(k.frequency_response(f_hz)) for k in (controller, rounded))
    elif loop_radius(plant, controller) < 1.0 <= loop_radius(plant, rounded):
        return float("inf")
    else:
        exact, coarse = sensitivities(controller, rounded, plant)
    size = np.linalg.norm(exact, 2, axis=(1, 2))
    change = np.linalg.norm(coarse - exact, 2, axis=(1, 2))
    floor = max(FLOOR * float(size.max()), np.finfo(float).tiny)
    return float((change / np.maximum(size, floor)).max())


def require_stable(
    rounded: StateSpace, controller: StateSpace, plant: StateSpace | None, what: str, advice: str
) -> None:
    """Refuse a rounded law that upsets the loop with a plant, or is unstable where the law as designed is stable.

    `advice` is what there is to take instead, for the end of the sentence.

    Raises:
        NumericalError: with the largest pole of loop or law, as designed and rounded.
    """
    if plant is not None and (radius := loop_radius(plant, rounded)) >= 1.0:
        before = loop_radius(plant, controller)
        how = "as designed already" if before >= 1.0 else "rounded, not as designed"
        raise NumericalError(
            f"deploy: the loop of this plant and the law is unstable, {how}: its largest pole is {before:.9f} as"
            f" designed, {radius:.9f} with {what}; nothing was written."
        )
    if controller.is_stable() and not rounded.is_stable():
        before, after = (float(np.abs(law.poles()).max()) for law in (controller, rounded))
        raise NumericalError(
            f"deploy: the law is stable, not so its {what}: its largest pole is {before:.9f} as designed, {after:.9f}"
            f" rounded; nothing was written, take {advice}."
        )


def sensitivities(controller: StateSpace, rounded: StateSpace, plant: StateSpace) -> tuple[ComplexArray, ComplexArray]:
    """Return S = (I - G K)^-1 `(nf, ny, ny)` with either law, on a grid that misses no pole of the loop or the law."""
    poles = np.concatenate([controller.poles(), _loop_poles(plant, controller)])
    f_hz = _grid(poles, controller.rate_hz or 0.0)
    before, after = (loop_response(plant, law, f_hz)[0] for law in (controller, rounded))
    return before, after


def loop_radius(plant: StateSpace, controller: StateSpace) -> float:
    """Return the largest pole magnitude of y = G u, u = K y; one at least where rounding decides that it is inside."""
    A = _closed(plant, controller)
    poles = _poles(A)
    radius = float(np.abs(poles).max(initial=0.0))
    return max(radius, 1.0) if on_boundary(A, poles, discrete=True).size else radius


def _loop_poles(plant: StateSpace, controller: StateSpace) -> ComplexArray:
    return _poles(_closed(plant, controller))


def _poles(A: FloatArray) -> ComplexArray:
    return np.linalg.eigvals(A).astype(np.complex128) if A.size else np.zeros(0, dtype=np.complex128)


def _closed(plant: StateSpace, controller: StateSpace) -> FloatArray:
    coupling = loop_coupling(plant, controller)
    y_g, y_k = coupling @ plant.C, coupling @ plant.D @ controller.C
    u_g, u_k = controller.D @ y_g, controller.C + controller.D @ y_k
    return np.block([[plant.A + plant.B @ u_g, plant.B @ u_k], [controller.B @ y_g, controller.A + controller.B @ y_k]])


def _grid(poles: ComplexArray, rate_hz: float) -> FloatArray:
    """Return log-spaced frequencies, with every pole's own frequency and its half-power points."""
    top = rate_hz / 2
    poles = poles[np.abs(poles) > 1e-6]  # so near z = 0 a pole is a delay, flat in gain
    centre = np.abs(np.angle(poles)) * rate_hz / (2 * np.pi)
    half = np.abs(np.log(np.abs(poles))) * rate_hz / (2 * np.pi)
    marks = np.concatenate([centre, centre - half, centre + half])
    base = np.geomspace(top / 10**DECADES, top, GRID)
    return np.unique(np.concatenate([base, marks[(marks > 0) & (marks <= top)]]))


def _points_first(response: ComplexArray) -> ComplexArray:
    return np.moveaxis(response, 2, 0)
