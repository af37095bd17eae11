"""From a controller to a folder of C99 that proves itself."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import between, one_of, positive, whole
from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet.bench import Bench
from ultraquiet.deploy.c31 import cycles
from ultraquiet.deploy.c31.assembly import c31_files
from ultraquiet.deploy.c_code import render, self_test
from ultraquiet.deploy.c_code.compiled import CompiledController, Library
from ultraquiet.deploy.c_code.footprint import footprint
from ultraquiet.deploy.c_code.output_folder import MANIFEST, manifest_text, require_ours, rewrite, write_folder
from ultraquiet.deploy.law.anti_windup import Wish, wish
from ultraquiet.deploy.law.coefficients import CoefficientBank, anti_windup_gain, bank_for
from ultraquiet.deploy.law.form_choice import TOLERANCE, Choice, choose, error_of, loop_radius
from ultraquiet.deploy.law.law import (
    DTYPES,
    OVERRUN_LIMIT,
    Law,
    actuator_limits,
    require_discrete,
    require_plant,
    rounded,
)
from ultraquiet.deploy.law.realisation import FORMS, realisation
from ultraquiet.deploy.law.twin import Twin
from ultraquiet.deploy.toolchain import compiler
from ultraquiet.deploy.toolchain.targets import TARGETS
from ultraquiet.deploy.verification.bench_tones import on_bench
from ultraquiet.deploy.verification.fuzz import STEPS as FUZZ_STEPS
from ultraquiet.deploy.verification.rounded_loop import reanalysis
from ultraquiet.deploy.verification.verify import STEPS, Verification, verify_code
from ultraquiet.values.controller import Controller
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

RAMP_S = 0.5  # ten periods of the slowest isolated tone pass in 2 s; a quarter of that keeps the start below it
TARGET_CODES = ("c99", "c31")
MAX_RAMP_STEPS = 2**24  # beyond it float32 no longer counts every step


class Deployment:
    """A generated folder and what is known of it.

    `tables` holds `states`, `form`, `c31_cycles` (kernel and frame), `c31_budget`, `flash_bytes`, `ram_bytes`,
    `cortex_m7_instructions` (None unless counted), `bit_exact` (None until `verify` has compared) and more; `status`
    is a sentence on the law, `law` holds the rounded coefficients, `designed` and `plant` what it was made from.
    """

    def __init__(
        self,
        law: Law,
        folder: Path,
        tables: dict[str, Any],
        status: Status,
        model_hash: str,
        designed: StateSpace | None = None,
        plant: StateSpace | None = None,
    ) -> None:
        self.law, self.folder, self.tables, self.status = law, folder, tables, status
        self.model_hash, self.designed, self.plant = model_hash, designed, plant
        self._library: Library | None = None

    @property
    def quantised(self) -> StateSpace:
        """The linear law with its rounded coefficients, for an analysis in float64."""
        return self.law.state_space()

    @cached_property
    def controller(self) -> Controller:
        """The law in control, from rest; the compiled code runs it (without a compiler its twin)."""
        return self.instance()

    def instance(self, ramp: bool = False) -> Controller:
        """Return a new `Controller` that runs the compiled code; `ramp` starts it as a real start would."""
        cc = compiler.compiler()
        if self._library is None and cc is not None:
            self._library = Library(self.law, self.folder, cc)
        if self._library is not None:
            return CompiledController(self._library, ramp)
        twin = Twin(self.law)
        if ramp:
            twin.enable()
        else:
            twin.reset()
        return twin

    def verify(
        self,
        steps: int = STEPS,
        seed: int = 0,
        *,
        plant: StateSpace | None = None,
        bench: Bench | Callable[[], Bench] | None = None,
        targets: Sequence[str] = tuple(TARGETS),
        fuzz_steps: int = FUZZ_STEPS,
    ) -> Verification:
        """Compile the code, compare `steps` samples and the self-test bit by bit, and note the outcome.

        With an ARM compiler and an emulator at hand both also run on the `targets` (`cortex-m4f`, `cortex-m7`), where
        each step's instructions are counted. `tables` and the folder's README and manifest then hold what was found.
        Never raises for a missing or refusing compiler: the status says so.

        Args:
            steps: samples to compare (at most 100 000 on each target).
            seed: of the measurements.
            plant: G, for the loop with the rounded law to be analysed again; else the one given to `generate`.
            bench: a bench, or a function that makes one, on which float64 law and compiled code reduce tones.
            targets: emulated processors; empty for none.
            fuzz_steps: random steps under the compiler's sanitizers; 0 for none.
        """
        whole("Deployment.verify", "steps", steps, 1)
        whole("Deployment.verify", "seed", seed, 0)
        whole("Deployment.verify", "fuzz_steps", fuzz_steps, 0)
        require_plant(plant)
        plant = self.plant if plant is None else plant
        found = verify_code(self.law, self.folder, compiler.compiler(), steps, seed, targets, fuzz_steps)
        law = self.quantised if self.designed is None else self.designed
        loop = None if plant is None else reanalysis(law, self.quantised, plant)
        runs = found.status.word != StatusWord.NOT_COMPILED
        measured = on_bench(bench, law, self.instance()) if bench is not None and runs else None
        found = found.with_loop(loop, measured)
        self.tables |= found.figures()
        rewrite(self.folder, self.documents(found.status))
        return found

    def bank(self, controller: StateSpace) -> CoefficientBank:
        """Return another controller's coefficients as words and CRC-32, to be loaded while this code runs.

        Raises:
            InputError: the code cannot hold them: another rate, number of channels or states.
        """
        return bank_for(self.law, controller)

    def documents(self, verified: Status | None = None) -> dict[str, str]:
        """Return the texts of README and manifest as things stand."""
        said = "Not verified yet." if verified is None else str(verified)
        manifest = {
            "name": self.law.name,
            "model_sha256": self.model_hash,
            "coefficients_sha256": self.law.hash,
            "tables": self.tables,
            "status": asdict(self.status),
            "verified": said,
        }
        text = render.readme(self.law, self.model_hash, self.tables, [str(self.status), said], cycles.ASSUMPTIONS)
        return {"README.md": text, MANIFEST: manifest_text(manifest)}


def generate(
    controller: StateSpace,
    folder: str | Path,
    precision: str = "float32",
    name: str = "controller",
    limits_v: ArrayLike = 25.0,
    *,
    form: str = "auto",
    anti_windup: bool | str = False,
    disturbance_v: ArrayLike | None = None,
    excitation_v: ArrayLike | None = None,
    overrun_limit: int = OVERRUN_LIMIT,
    ramp_s: float = RAMP_S,
    plant: StateSpace | None = None,
    tolerance: float = TOLERANCE,
    budget_cycles: int = cycles.BUDGET_CYCLES,
    enforce_budget: bool = False,
    budget_share: float | None = None,
    targets: Sequence[str] = ("c99",),
) -> Deployment:
    """Write a controller as C99 with its self-test and test vectors.

    x+ = A x + B y + L (sat(u) - u), u = C x + D y, limited, ramped, guarded; the code needs no library.

    Args:
        controller: discrete law from measurements to commands, u = K y.
        folder: where to write; appears whole or not at all, and replaces only what this function wrote.
        precision: `float32` or `float64`, of coefficients, states and arithmetic.
        name: prefix of every file and symbol.
        limits_v: actuator limits in volts: a number, `(nu,)`, or `(nu, 2)` low and high.
        form: `modal`, `delta`, `bank`, `bank-delta`, `schur`, `dense`, or `auto`: the cheapest whose rounded response
            is within `tolerance`.
        anti_windup: correct the state by what the limits took away; `auto` when the law has an unstable pole or one
            below 1 Hz, or its commands meet a limit under `disturbance_v`, and the budget allows.
        disturbance_v: design disturbance for `auto`, what the sensors show without control, `(ny, n)` volts.
        excitation_v: limits of what may be added to the commands, like `limits_v`; a tenth of those when absent.
        overrun_limit: overruns in a row that latch a fault and ramp the command out.
        ramp_s: seconds from zero to full command, and back.
        plant: G of the loop u = K y, y = G u; when given, forms are judged by the loop's sensitivity.
        tolerance: largest relative error that `auto` accepts.
        budget_cycles: C31 instructions a frame may take.
        enforce_budget: refuse a law that does not fit.
        budget_share: refuse a law that takes more than this share of `budget_cycles`, 0 to 1.
        targets: `c99` alone, or with `c31` for TMS320C31 assembly of a modal or delta law beside it.

    Returns:
        A `Deployment`; its `status` warns of an unstable law or a large rounding error.

    Raises:
        InputError: a law in continuous time, a coefficient beyond the precision, an impossible budget, bad settings.
        StorageError: the folder cannot be written or holds something else.

    >>> import tempfile
    >>> law = StateSpace([[0.9, 0.1], [-0.1, 0.9]], [[0.1], [0.0]], [[1.0, 0.0]], [[0.0]], rate_hz=3500.0)
    >>> made = generate(law, tempfile.mkdtemp() + "/code", limits_v=10.0)
    >>> made.tables["form"], made.tables["states"], made.tables["bit_exact"]
    ('modal', 2, None)
    """
    folder = Path(folder).absolute()
    _check(controller, precision, name, form, targets)
    require_plant(plant)
    between("deploy", "tolerance", tolerance, 0.0, 1.0)
    whole("deploy", "budget_cycles", budget_cycles, 1)
    limits = actuator_limits(limits_v, controller.D.shape[0])
    steps = round(positive("deploy", "ramp_s", ramp_s, "s") * float(controller.rate_hz or 0))
    whole("deploy", "ramp_s in samples", steps, 1, MAX_RAMP_STEPS)
    excitation = None if excitation_v is None else actuator_limits(excitation_v, len(limits), "excitation_v")
    whole("deploy", "overrun_limit", overrun_limit, 1, MAX_RAMP_STEPS)
    require_ours(folder)
    wanted = wish(anti_windup, controller, limits, plant, disturbance_v)

    def make(shape: str, aware: bool = wanted.on) -> tuple[Law, float]:
        parts = realisation(controller, shape)
        L = anti_windup_gain(parts) if aware else None
        rate, order = float(controller.rate_hz or 0), controller.states
        law = rounded(
            parts,
            L,
            limits,
            precision,
            rate_hz=rate,
            order=order,
            name=name,
            ramp_steps=steps,
            excitation=excitation,
            overrun_limit=overrun_limit,
        )
        return law, parts.condition

    room = budget_cycles * (1.0 if budget_share is None else budget_share)
    choice, why = _aware(controller, form, make, plant, tolerance, wanted, room if anti_windup == "auto" else np.inf)
    if enforce_budget or budget_share is not None:
        cycles.require_fit(choice.law, budget_cycles, 1.0 if budget_share is None else budget_share)
    what = "the response" if plant is None else "the loop's sensitivity"
    status = _status(controller, choice, tolerance, what, plant)
    rows = self_test.self_test(choice.law)
    files = render.sources(choice.law, rows, controller.hash)
    tables = _tables(choice, budget_cycles) | {"anti_windup_because": why} | footprint(choice.law, files)
    files["vectors.csv"] = render.vectors(choice.law)
    if "c31" in targets:
        files |= c31_files(choice.law, controller.hash)
    made = Deployment(choice.law, folder, tables, status, controller.hash, controller, plant)
    write_folder(folder, files | made.documents())
    return made


def _check(controller: StateSpace, precision: str, name: str, form: str, targets: Sequence[str]) -> None:
    require_discrete(controller, name)
    one_of("deploy", "precision", precision, tuple(DTYPES))
    one_of("deploy", "form", form, ("auto", *FORMS))
    if isinstance(targets, str) or not isinstance(targets, Sequence) or "c99" not in targets:
        raise InputError(f"deploy: 'targets' must list 'c99' and may list 'c31', got {targets!r}.")
    for target in targets:
        one_of("deploy", "targets", target, TARGET_CODES)


def _aware(
    controller: StateSpace,
    form: str,
    make: Any,
    plant: StateSpace | None,
    tolerance: float,
    wanted: Wish,
    room: float,
) -> tuple[Choice, str]:
    """Return the choice, without the anti-windup that was wanted when it takes more cycles than there is room for."""
    if not wanted.on:
        return _choice(controller, form, make, plant, tolerance), f"off: {wanted.why}"
    plain = partial(make, aware=False)
    try:
        choice = _choice(controller, form, make, plant, tolerance)
    except NumericalError as refusal:
        if np.isinf(room):
            raise
        return _choice(controller, form, plain, plant, tolerance), f"off: {wanted.why}, but {refusal}"
    need = cycles.cycles(choice.law)
    if need > room:
        off = f"off: {wanted.why}, but {need} C31 instructions do not fit the {room:g} allowed"
        return _choice(controller, form, plain, plant, tolerance), off
    return choice, f"on: {wanted.why}"


def _choice(controller: StateSpace, form: str, make: Any, plant: StateSpace | None, tolerance: float) -> Choice:
    if form == "auto":
        return choose(controller, make, cycles.cycles, plant, tolerance)
    law, condition = make(form)
    error = error_of(law.state_space(), controller, plant)
    return Choice(law, error, {form: error}, condition)


def _status(controller: StateSpace, choice: Choice, tolerance: float, what: str, plant: StateSpace | None) -> Status:
    law = choice.law
    if plant is not None and (radius := loop_radius(plant, controller)) >= 1.0:
        return Status(
            StatusWord.UNSTABLE, f"The loop of this plant and the controller as designed has a pole at {radius:.6f}."
        )
    if not controller.is_stable():
        return Status(
            StatusWord.UNSTABLE, "The controller itself is unstable: it runs to its limits whenever the loop opens."
        )
    if not law.state_space().is_stable():
        return Status(
            StatusWord.UNSTABLE,
            f"The controller is stable, its {law.precision} coefficients are not; take form='delta' or float64.",
        )
    if not np.isfinite(choice.error):
        return Status(
            StatusWord.UNSTABLE, f"The loop is stable with the controller, not with its {law.precision} coefficients."
        )
    more = f" (eigenvector condition {choice.condition:.1e})" if law.form in ("schur", "dense") else ""
    word = StatusWord.OK if choice.error <= tolerance else StatusWord.INEXACT
    sentence = f"Rounding to {law.precision} in {law.form} form{more} changes {what} by {choice.error:.1e} of its size."
    return Status(word, sentence)


def _tables(choice: Choice, budget_cycles: int) -> dict[str, Any]:
    law = choice.law
    used = cycles.cycles(law)
    kernel = cycles.kernel_of(law)
    anti_windup = law.L is not None
    return {
        "states": law.order,
        "form": law.form,
        "precision": law.precision,
        "anti_windup": anti_windup,
        "c31_cycles": used,
        "c31_kernel_cycles": kernel,
        "c31_output_cycles": cycles.output_cycles(law),
        "c31_budget": budget_cycles,
        "c31_budget_share": used / budget_cycles,
        "c31_fits_the_model": used <= budget_cycles,
        "c31_words": cycles.words(law),
        "c31_internal_words": cycles.INTERNAL_WORDS,
        "c31_largest_order": cycles.largest_order(
            law.form, budget_cycles, law.inputs, law.outputs, **cycles.shape(law)
        ),
        "cortex_m7_instructions": None,
        "coefficients": law.coefficients,
        "response_error": _finite(choice.error),
        "forms_tried": {form: _finite(error) for form, error in choice.tried.items()},
        "eigenvector_condition": _finite(choice.condition),
        "bit_exact": None,
    }


def _finite(value: float) -> float | None:
    """Return the number, or None for an infinite one, which JSON cannot hold."""
    return value if np.isfinite(value) else None
