"""What every design is judged by: the loop with the design model, closed again from the finished controller."""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from ultraquiet._base.provenance import Provenance, plain, versions
from ultraquiet._base.shown.line import counted, fall, hertz, rounded
from ultraquiet.analyse.disk import EndMargins
from ultraquiet.analyse.margins import peak_sensitivity
from ultraquiet.design.instability import unstable
from ultraquiet.design.result import DesignResult
from ultraquiet.design.robustness import UNSTABLE_LAW, StatedRobustness, both_ends, fragility, keeps, stated
from ultraquiet.design.worst_direction import design_band, worst_direction
from ultraquiet.values.interconnect import feedback
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord


def judged(
    plant: StateSpace,
    controller: StateSpace,
    settings: StatedRobustness,
    gamma: float,
    achieved: float,
    residuals: Mapping[str, float],
    details: Mapping[str, Any],
) -> DesignResult:
    """Close the loop, take its poles, peak sensitivity and margins, and word the verdict.

    It is `ok` where the loop is stable and its disk margin, all channels at once, is at least the one that the settings
    ask for at both ends of the plant; `fragile` where it is stable with less. Either says what becomes of the worst
    direction over the design's own band, and which directions of the sensors the actuators do not reach: on most plants
    with sharp modes a loop that makes the readings quieter is louder in some direction between the modes.
    """
    loop = feedback(plant, controller)
    poles = loop.poles()
    peak_db, peak_hz = peak_sensitivity(plant, controller)
    margins = both_ends(plant, controller)
    peak = f"it amplifies by at most {rounded(peak_db)} dB, at {hertz(peak_hz)}"
    if not loop.is_stable():
        said = unstable(plant, controller, loop, "loop with the design model")
        verdict = Status(StatusWord.UNSTABLE, f"{said}; the controller must not be used.")
    else:
        verdict = _verdict(plant, controller, settings.disk_margin, margins, peak)
        worst = worst_direction(plant, controller, design_band(settings, details))
        verdict = Status(verdict.word, " ".join([verdict.sentence, *_fallen(details), worst.sentences]))
    return DesignResult(
        status=verdict,
        controller=_stamped(controller, plant, settings),
        gamma=gamma,
        achieved=achieved,
        closed_loop_poles=poles,
        peak_sensitivity_db=peak_db,
        margins=margins,
        residuals=residuals,
        details={**details, "peak_sensitivity_hz": peak_hz},
        provenance=_provenance(plant, settings),
    )


def _verdict(
    plant: StateSpace, controller: StateSpace, asked: float, margins: Mapping[str, EndMargins], peak: str
) -> Status:
    own = "stable" if controller.is_stable() else UNSTABLE_LAW
    law = f"the controller has {counted(controller.states, 'state')} and is {own}."
    if keeps(margins, asked):
        return Status(StatusWord.OK, f"The loop is stable; {peak}; {stated(margins)}; {law}")
    return Status(StatusWord.FRAGILE, f"{fragility(plant, margins, asked)} The loop {peak[3:]}; {law}")


def _fallen(details: Mapping[str, Any]) -> list[str]:
    """Return one sentence on the RMS of S G where the design measured it, none elsewhere."""
    if "attenuation_rms_db" not in details:
        return []
    (low, high), quieter = details["band_hz"], details["attenuation_rms_db"]
    return [f"The RMS of S G over {low:.4g}-{high:.4g} Hz {fall(quieter)}."]


def _stamped(controller: StateSpace, plant: StateSpace, settings: Any) -> StateSpace:
    return StateSpace(
        controller.A,
        controller.B,
        controller.C,
        controller.D,
        controller.rate_hz,
        actuators=plant.sensors,
        sensors=plant.actuators,
        provenance=_provenance(plant, settings),
    )


def _provenance(plant: StateSpace, settings: Any) -> Provenance:
    kept = {f.name: _setting(getattr(settings, f.name)) for f in fields(settings)}
    return Provenance(type(settings).__name__, kept, parents=(plant.hash,), versions=versions())


def _setting(value: Any) -> Any:
    if isinstance(value, StateSpace):
        return value.hash
    return value if value is None or isinstance(value, int | float | str | bool | tuple) else plain(value)


def signed(result: DesignResult, plant: StateSpace, settings: Any) -> DesignResult:
    """Return what another design found in the name of the settings that asked for it."""
    law = result.controller
    stamped = None if law is None else _stamped(law, plant, settings)
    return replace(result, controller=stamped, provenance=_provenance(plant, settings))


def from_synthesis(
    plant: StateSpace,
    synthesised: DesignResult,
    settings: Any,
    details: Mapping[str, Any],
    controller: StateSpace | None = None,
) -> DesignResult:
    """Judge what an H-infinity synthesis found on the plant itself; a refusal is passed on.

    `controller` replaces the one found, when that was made for a part of the plant.
    """
    law = controller or synthesised.controller
    merged = {**synthesised.details, **details}
    if not synthesised.status.ok or law is None:
        return replace(synthesised, details=merged, provenance=_provenance(plant, settings))
    gamma, achieved = synthesised.gamma, synthesised.achieved
    result = judged(plant, law, settings, gamma, achieved, synthesised.residuals, merged)
    if merged.get("decided", True):
        return result
    said = f"{result.status.sentence} {_undecided(*merged['optimum'])}"
    return replace(result, status=Status(result.status.word, said))


def _undecided(low: float, high: float) -> str:
    """Return what a search that ended open says of the law that it found."""
    return (
        f"The law's weighted norm is not shown to be the least: the best that was reached is {rounded(high)}, no more "
        f"than {rounded(low)} is shown to be out of reach, and no equation could be solved between; weights less far "
        "apart in size would decide it."
    )
