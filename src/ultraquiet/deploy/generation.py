"""From a controller to a folder of C99 that proves itself."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, one_of
from ultraquiet._base.errors import NumericalError
from ultraquiet.deploy.c31 import cycles
from ultraquiet.deploy.c31.assembly import c31_files
from ultraquiet.deploy.c31.pushes import pushes, reach_words
from ultraquiet.deploy.c31.vectors import vectors
from ultraquiet.deploy.c_code import render
from ultraquiet.deploy.c_code.footprint import footprint
from ultraquiet.deploy.c_code.output_folder import require_ours, write_folder
from ultraquiet.deploy.c_code.plan import plan_code
from ultraquiet.deploy.deployment import Deployment
from ultraquiet.deploy.law.anti_windup import decide_anti_windup
from ultraquiet.deploy.law.coefficients import anti_windup_gain
from ultraquiet.deploy.law.coordinates import balanced
from ultraquiet.deploy.law.form_choice import FormChoice, choose, error_of, require_stable
from ultraquiet.deploy.law.kind import require_law
from ultraquiet.deploy.law.law import (
    DTYPES,
    Law,
    actuator_limits,
    own_limits,
    require_discrete,
    require_plant,
    within,
)
from ultraquiet.deploy.law.realisation import realisation
from ultraquiet.deploy.law.rounding import rounded
from ultraquiet.deploy.options import C31Budget, CodeOptions, options_and_budget
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord


def generate(
    controller: StateSpace,
    folder: str | Path,
    precision: str = "float32",
    name: str = "controller",
    limits_v: ArrayLike | None = None,
    *,
    plant: StateSpace | None = None,
    options: CodeOptions | None = None,
    c31: C31Budget | None = None,
    **settings: Any,
) -> Deployment:
    """Write a controller as C99 with its self-test and test vectors.

    x+ = A x + B y + L (sat(u) - u), u = C x + D y, limited, ramped, guarded; the code needs no library. The
    states are first scaled evenly, by powers of two (`law.coordinates.balanced`). What may not run is refused, and
    nothing is written.

    Args:
        controller: discrete law from measurements to commands, u = K y.
        folder: where to write; appears whole or not at all, and replaces only what this function wrote.
        precision: `float32` or `float64`, of coefficients, states and arithmetic.
        name: prefix of every file and symbol.
        limits_v: actuator limits in volts, or in the unit of the law's commands: a number, `(nu,)`, or `(nu, 2)` low
            and high; when absent, those of the law's own channels. Where these have none the code keeps none, and the
            status says so.
        plant: G of the loop u = K y, y = G u; when given, forms are judged by the loop's sensitivity.
        options: how the law becomes code: form, anti-windup, ramp and more.
        c31: what the law may take of a TMS320C31's frame.
        settings: single fields of `CodeOptions` instead of `options`, and `budget_cycles`, `enforce_budget`,
            `budget_share` instead of `c31`.

    Returns:
        A `Deployment`; its `status` warns of a law that is itself unstable, of a large rounding error, and names the
        commands that nothing limits.

    Raises:
        InputError: a plant in place of a law, a law in continuous time, a coefficient beyond the precision, an
            impossible budget, bad settings, a target with converters while a command has no limit.
        NumericalError: the loop with the plant is unstable with the rounded law, or rounding makes a stable law
            unstable.
        ToolError: the compilers at hand refuse the code.
        StorageError: the folder cannot be written or holds something else.

    >>> import tempfile
    >>> law = StateSpace([[0.9, 0.1], [-0.1, 0.9]], [[0.1], [0.0]], [[1.0, 0.0]], [[0.0]], rate_hz=3500.0)
    >>> made = generate(law, tempfile.mkdtemp() + "/code", limits_v=10.0)
    >>> made.tables["form"], made.tables["states"], made.tables["bit_exact"]
    ('modal', 2, None)
    >>> generate(law, tempfile.mkdtemp() + "/code", form="delta").tables["form"]
    'delta'
    """
    folder = Path(folder).absolute()
    options, c31 = options_and_budget(options, c31, settings)
    require_discrete(controller, name)
    require_plant(plant)
    require_law(controller, plant)
    even, loop = balanced(controller), None if plant is None else balanced(plant)
    limits = own_limits(controller) if limits_v is None else actuator_limits(limits_v, controller.D.shape[0])
    maker = _maker(even, precision, name, limits, loop, options)
    require_ours(folder)
    choice, why = maker.choice(c31)
    if c31.binding:
        cycles.require_fit(choice.law, c31.cycles_at(choice.law.rate_hz), 1.0 if c31.share is None else c31.share)
    status = _with_open_ends(maker.status(choice), controller, choice.law)
    plan = plan_code(choice.law, controller.hash)
    files = render.sources(plan)
    tables = _tables(choice, c31) | {"anti_windup_because": why} | footprint(plan.law, files)
    tables |= _wires(controller, plan.law)
    files["vectors.csv"] = render.vectors(plan.law)
    if "c31" in options.targets:
        files |= c31_files(plan)
        driven = pushes(plan.law)
        files[f"{plan.law.name}_c31.csv"] = vectors(plan.law, driven)
        tables["c31_vectors"] = reach_words(plan.law, driven)
    deployment = Deployment(plan, folder, tables, status, even, loop, controller)
    write_folder(folder, files | deployment.documents())
    return deployment


@dataclass(frozen=True, eq=False)
class _LawMaker:
    """Rounds one controller to one precision, form by form, and judges what that does to it, or to its loop."""

    controller: StateSpace
    plant: StateSpace | None
    options: CodeOptions
    precision: str
    name: str
    limits: FloatArray
    excitation: FloatArray | None
    ramp_steps: int

    def law(self, form: str, anti_windup: bool) -> tuple[Law, float]:
        """Return the law in a form, and the condition number of its eigenvectors."""
        parts = realisation(self.controller, form)
        law = rounded(
            parts,
            anti_windup_gain(parts) if anti_windup else None,
            self.limits,
            self.precision,
            rate_hz=float(self.controller.rate_hz or 0),
            order=self.controller.states,
            name=self.name,
            ramp_steps=self.ramp_steps,
            excitation=self.excitation,
            overrun_limit=self.options.overrun_limit,
        )
        return law, parts.condition

    def choice(self, c31: C31Budget) -> tuple[FormChoice, str]:
        """Return the law to generate and why it has anti-windup or not: not where `auto` finds no room for it."""
        setting = self.options.anti_windup
        decision = decide_anti_windup(setting, self.controller, self.limits, self.plant, self.options.disturbance_v)
        if not decision.on:
            return self._of_form(anti_windup=False), f"off: {decision.why}"
        room = c31.allowed_at(float(self.controller.rate_hz or 0)) if setting == "auto" else np.inf
        try:
            choice = self._of_form(anti_windup=True)
        except NumericalError as refusal:
            if np.isinf(room):
                raise
            return self._of_form(anti_windup=False), f"off: {decision.why}, but {refusal}"
        need = cycles.frame_cycles(choice.law)
        if need > room:
            off = f"off: {decision.why}, but {need} C31 instructions do not fit the {room:g} allowed"
            return self._of_form(anti_windup=False), off
        return choice, f"on: {decision.why}"

    def _of_form(self, anti_windup: bool) -> FormChoice:
        controller, plant, form = self.controller, self.plant, self.options.form
        make = partial(self.law, anti_windup=anti_windup)
        if form == "auto":
            return choose(controller, make, cycles.frame_cycles, plant, self.options.tolerance)
        law, condition = make(form)
        error = error_of(law.state_space(), controller, plant)
        return FormChoice(law, error, {form: error}, condition)

    def status(self, choice: FormChoice) -> Status:
        """Return a sentence on the law: one that is itself unstable, a large rounding error.

        Raises:
            NumericalError: a loop, or a law that was stable, that is unstable once it is rounded.
        """
        controller, law = self.controller, choice.law
        what, delta = (
            f"{law.precision} coefficients in {law.form} form",
            "" if "delta" in law.form else "form='delta' or ",
        )
        more = "precision='float64'" if law.precision == "float32" else "another design"
        require_stable(law.state_space(), controller, self.plant, what, delta + more)
        plant, runaway = self.plant, ""
        if not controller.is_stable():
            where = "to its limits" if np.isfinite(law.known_limits).all() else "to whatever ends it"
            runaway = f"The controller itself is unstable: it runs {where} whenever the loop opens."
            if plant is None:  # no loop is known that holds it
                return Status(StatusWord.UNSTABLE, runaway)
        more = f" (eigenvector condition {choice.condition:.1e})" if law.form in ("schur", "dense") else ""
        what = "the response" if plant is None else "the loop's sensitivity"
        word = StatusWord.OK if choice.error <= self.options.tolerance else StatusWord.INEXACT
        sentence = (
            f"Rounding to {law.precision} in {law.form} form{more} changes {what} by {choice.error:.1e} of its size."
        )
        return Status(word, f"{sentence} {runaway}".rstrip())


def _maker(
    controller: StateSpace,
    precision: str,
    name: str,
    limits: FloatArray,
    plant: StateSpace | None,
    options: CodeOptions,
) -> _LawMaker:
    one_of("deploy", "precision", precision, tuple(DTYPES))
    excitation_v = options.excitation_v
    excitation = None if excitation_v is None else actuator_limits(excitation_v, len(limits), "excitation_v")
    steps = options.ramp_steps(float(controller.rate_hz or 0))
    return _LawMaker(controller, plant, options, precision, name, limits, excitation, steps)


def _tables(choice: FormChoice, c31: C31Budget) -> dict[str, Any]:
    law = choice.law
    used = cycles.frame_cycles(law)
    kernel = cycles.kernel_of(law)
    budget = c31.cycles_at(law.rate_hz)
    anti_windup = law.L is not None
    return {
        "states": law.order,
        "form": law.form,
        "precision": law.precision,
        "anti_windup": anti_windup,
        "c31_cycles": used,
        "c31_kernel_cycles": kernel,
        "c31_output_cycles": cycles.output_cycles(law),
        "c31_budget": budget,
        "c31_budget_share": used / budget,
        "c31_fits_the_model": used <= budget,
        "c31_words": cycles.words(law),
        "c31_internal_words": cycles.INTERNAL_WORDS,
        "c31_largest_order": cycles.largest_order(
            law.form, budget, law.inputs, law.outputs, **cycles.count_settings(law)
        ),
        "cortex_m7_instructions": None,
        "coefficients": law.coefficients,
        "response_error": _finite(choice.error),
        "forms_tried": {form: _finite(error) for form, error in choice.tried.items()},
        "eigenvector_condition": _finite(choice.condition),
        "bit_exact": None,
    }


def _with_open_ends(status: Status, controller: StateSpace, law: Law) -> Status:
    """Return the status of a law with the commands added that nothing limits, or only on one side."""
    known = np.isfinite(law.known_limits).sum(axis=1)
    for count, what in ((0, "No limit"), (1, "One limit alone")):
        names = ", ".join(
            f"'{wire.name}'" for wire, ends in zip(controller.sensors, known, strict=True) if ends == count
        )
        if names:
            more = f"{what} of {names} is known, and the code keeps no other; limits_v (--limits) sets it."
            status = Status(status.word, f"{status.sentence} {more}")
    return status


def _wires(controller: StateSpace, law: Law) -> dict[str, list[str]]:
    """Return what each measurement and command is, in the code's order, with the limits that the code keeps."""
    return {
        "measurements": [wire.label for wire in controller.actuators],
        "commands": [
            within(wire, low, high)
            for wire, (low, high) in zip(controller.sensors, law.known_limits.tolist(), strict=True)
        ],
    }


def _finite(value: float) -> float | None:
    """Return the number, or None for an infinite one, which JSON cannot hold."""
    return value if np.isfinite(value) else None
