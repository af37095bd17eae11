"""From a controller to a folder of whole-number C99, with its bounds, twin and self-test."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import between, one_of, positive
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown import Shown
from ultraquiet.deploy.c_code.output_folder import manifest_text, require_ours, write_folder
from ultraquiet.deploy.c_code.render import heading, render
from ultraquiet.deploy.c_code.self_test import FNV_BASIS, FNV_PRIME, LCG_FACTOR, LCG_STEP
from ultraquiet.deploy.figures import said
from ultraquiet.deploy.fixed_point.deployment import FixedDeployment
from ultraquiet.deploy.fixed_point.law import FixedLaw
from ultraquiet.deploy.fixed_point.ranges import cut_short, full_ranges, full_size, held_to
from ultraquiet.deploy.fixed_point.reach import all_corners, largest_commands, limited_commands, state_corners
from ultraquiet.deploy.fixed_point.scaling import fixed_law
from ultraquiet.deploy.fixed_point.self_test import self_test
from ultraquiet.deploy.law.coordinates import balanced
from ultraquiet.deploy.law.form_choice import TOLERANCE, error_of, require_stable
from ultraquiet.deploy.law.kind import require_law
from ultraquiet.deploy.law.law import require_discrete, require_plant
from ultraquiet.deploy.settings import collected
from ultraquiet.deploy.toolchain.compiler import FLAGS
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord

# The level of a ramp counts in bits of the word; 2^18 steps, 75 s at 3.5 kHz, are as many as the self-test can climb.
RAMP_BITS = {"q15": 14, "q31": 18}
FILES = {
    "fixed.h.j2": "{name}.h",
    "fixed.c.j2": "{name}.c",
    "fixed_selftest.c.j2": "{name}_selftest.c",
    "fixed_host.c.j2": "{name}_host.c",
    "fixed_README.md.j2": "README.md",
}


@dataclass(frozen=True)
class FixedOptions(Shown):
    """How a law becomes code of whole numbers.

    Args:
        form: `modal`, `delta`, or `auto`: the one that changes the loop less.
        scaling: `l1` (no overflow possible) or `l2` (finer states, limited in the code).
        input_v: full range of a measurement, in its unit; the largest of the law's own channels when absent.
        output_v: full range of a command, in its unit, or limits of each, `(nu,)` or `(nu, 2)`, of which the smallest
            size holds all of them on both sides of zero; those of the law's own channels when absent.
        ramp_s: about this many seconds from zero to full command: the nearest power of two of samples.
        tolerance: largest relative error of coefficients, and largest rounding noise as a share of the range.

    Raises:
        InputError: the setting and what it may be.

    >>> FixedOptions(ramp_s=1.0).ramp_bits("q31", 4096.0)
    12
    """

    form: str = "auto"
    scaling: str = "l1"
    input_v: float | None = None
    output_v: ArrayLike | None = None
    ramp_s: float = 0.5
    tolerance: float = TOLERANCE

    def __post_init__(self) -> None:
        between("generate_fixed", "tolerance", self.tolerance, 0.0, 1.0)
        positive("generate_fixed", "ramp_s", self.ramp_s, "s")

    def ramp_bits(self, word: str, rate_hz: float) -> int:
        """Return the power of two of samples that comes nearest to the ramp.

        Raises:
            InputError: a ramp longer than the word counts.
        """
        bits = round(math.log2(max(self.ramp_s * rate_hz, 1.0)))
        if bits > RAMP_BITS[word]:
            longest = 2 ** RAMP_BITS[word] / rate_hz
            raise InputError(
                f"generate_fixed: 'ramp_s' may be {longest:.3g} s in {word} at this rate, got {self.ramp_s:g} s."
            )
        return bits


def generate_fixed(
    controller: StateSpace,
    folder: str | Path,
    word: str = "q31",
    name: str = "controller",
    *,
    plant: StateSpace | None = None,
    options: FixedOptions | None = None,
    **settings: Any,
) -> FixedDeployment:
    """Write a controller as C99 of whole numbers, with its self-test and the bounds it was scaled by.

    Args:
        controller: discrete, stable law from measurements to commands, u = K y.
        folder: where to write; appears whole or not at all, and replaces only what this package wrote.
        word: `q31` (32-bit words, 64-bit sums) or `q15` (16, 32).
        name: prefix of every file and symbol.
        plant: G of the loop u = K y, y = G u; judges the loop instead of the law's own response.
        options: how the law becomes whole numbers.
        settings: single fields of `FixedOptions` instead of `options`.

    Raises:
        InputError: a plant in place of a law, a law in continuous time, one that loses more than `tolerance`, one
            whose commands would never move, a range that nobody states, bad settings.
        NumericalError: the loop with the plant is unstable with the rounded law, or rounding makes a stable law
            unstable.
        StorageError: the folder cannot be written or holds something else.

    >>> import tempfile
    >>> law = StateSpace([[0.9, 0.1], [-0.1, 0.9]], [[0.1], [0.0]], [[1.0, 0.0]], [[0.0]], rate_hz=3500.0)
    >>> generate_fixed(law, tempfile.mkdtemp() + "/code", "q15", input_v=10.0, output_v=5.0).status.word
    'ok'
    """
    folder = Path(folder).absolute()
    options = collected("generate_fixed", "options", options, FixedOptions, settings)
    require_discrete(controller, name)
    require_plant(plant)
    require_law(controller, plant)
    one_of("generate_fixed", "word", word, tuple(RAMP_BITS))
    bits = options.ramp_bits(word, float(controller.rate_hz or 0))
    require_ours(folder)
    even, loop = balanced(controller), None if plant is None else balanced(plant)
    law, error = _best(even, word, name, loop, options, bits)
    _require_movement(law, even)
    require_stable(law.state_space(), even, loop, f"{law.word} coefficients in {law.form} form", _more(law))
    status = _status(law, error, plant is None, options.tolerance, options.scaling)
    status = Status(status.word, f"{status.sentence} {cut_short(controller, options.output_v)}".rstrip())
    deployment = FixedDeployment(law, folder, _tables(law, error, controller), status)
    write_folder(folder, _texts(deployment, controller))
    return deployment


def _require_movement(law: FixedLaw, controller: StateSpace) -> None:
    """Refuse code whose commands stay at zero whatever is measured, for a law that has commands.

    Raises:
        InputError: with the size of one count.
    """
    if (np.any(controller.C) or np.any(controller.D)) and not np.any(largest_commands(law)):
        raise InputError(
            f"generate_fixed: in {law.word} with commands of +-{law.output_v:g} no measurement of +-{law.input_v:g}"
            f" moves a command by one count, {law.output_v / 2.0 ** (law.bits - 1):.1e}; take a smaller output_v or"
            f" {_more(law)}."
        )


def _more(law: FixedLaw) -> str:
    """Return the word that holds more than this law's."""
    return "q31" if law.word == "q15" else "float32"


def _status(law: FixedLaw, error: float, alone: bool, tolerance: float, scaling: str) -> Status:
    """Return a sentence on the law.

    Raises:
        InputError: rounding changes it by more than the tolerance.
    """
    noise = float(law.noise_v.max()) / law.output_v
    what = "the response" if alone else "the loop's sensitivity"
    if not error <= tolerance or noise > tolerance:
        other = "" if scaling == "l2" else ", scaling='l2'"
        lost = "makes the loop unstable" if not np.isfinite(error) else f"changes {what} by {error:.1e} of its size"
        raise InputError(
            f"generate_fixed: {law.word} in {law.form} form {lost} and puts rounding noise of {noise:.1e} of the range"
            f" on the commands, more than {tolerance:g}; take {_more(law)}{other}, a larger tolerance, or ranges nearer"
            f" to what comes and goes: readings have +-{law.input_v:g} now, commands +-{law.output_v:g}."
        )
    reach = "no state can overflow" if not law.saturates else "states are limited"
    return Status(
        StatusWord.OK,
        f"Rounding to {law.word} in {law.form} form changes {what} by {error:.1e} of its size and adds {noise:.1e} of"
        f" the range as noise; {reach}, the bound is {law.peak:.3f} of full scale.",
    )


def _best(
    controller: StateSpace, word: str, name: str, plant: StateSpace | None, options: FixedOptions, ramp_bits: int
) -> tuple[FixedLaw, float]:
    tried: list[tuple[FixedLaw, float]] = []
    last_refusal = None
    input_v, output_v = full_ranges("generate_fixed", controller, options.input_v, options.output_v)
    settings: dict[str, Any] = {"scaling": options.scaling, "input_v": input_v, "output_v": output_v}
    settings |= {"name": name, "ramp_bits": ramp_bits}
    for form in ("modal", "delta") if options.form == "auto" else (options.form,):
        try:
            law = fixed_law(controller, word, form, **settings)
            tried.append((law, error_of(law.state_space(), controller, plant)))
        except InputError as refusal:
            last_refusal = refusal  # what it says to take has not been tried here
    if not tried:
        assert last_refusal is not None
        raise last_refusal
    return min(tried, key=lambda attempt: attempt[1])


def _tables(law: FixedLaw, error: float, controller: StateSpace) -> dict[str, Any]:
    return {
        "states": law.order,
        "form": law.form,
        "precision": law.word,
        "scaling": law.scaling,
        "response_error": error,
        "state_bound": law.peak,
        "accumulator_bound": law.accumulator,
        "noise_v": float(law.noise_v.max()),
        "noise_bound_v": float(law.noise_bound_v.max()),
        "multiply_adds": law.multiply_adds,
        "coefficient_bytes": law.coefficient_bytes,
        "bit_exact": None,
        "measurements": held_to(law.input_v, controller.actuators),
        "commands": held_to(law.output_v, controller.sensors),
    }


def _texts(deployment: FixedDeployment, controller: StateSpace) -> dict[str, str]:
    law, model_hash = deployment.law, controller.hash
    corners, edges = all_corners(law)
    context = {
        **heading(law, model_hash),
        "A": law.A.tolist(),
        "B": law.B.tolist(),
        "C": law.C.tolist(),
        "D": law.D.tolist(),
        "full_reading": full_size(law.input_v, controller.actuators),
        "full_command": full_size(law.output_v, controller.sensors),
        "down_a": (law.shift_a + 2).tolist(),
        "down_b": (law.shift_b + 2).tolist(),
        "down_u": (law.shift_u + law.bits - 2).tolist(),
        "top": law.top,
        "rows": self_test(law, corners, edges),
        "corners": corners.tolist(),
        "limited_commands": limited_commands(law),
        "edges": edges,
        "limited_states": len(state_corners(law)) > 0,
        "basis": FNV_BASIS,
        "prime": FNV_PRIME,
        "factor": LCG_FACTOR,
        "step": LCG_STEP,
        "figures": said({key: value for key, value in deployment.tables.items() if value is not None}),
        "status": deployment.status,
        "flags": " ".join(FLAGS),
    }
    files = {file.format(name=law.name): render(template, context) for template, file in FILES.items()}
    manifest = {
        "name": law.name,
        "model_sha256": model_hash,
        "coefficients_sha256": law.hash,
        "tables": deployment.tables,
    }
    return files | {"manifest.json": manifest_text(manifest | {"status": str(deployment.status)})}
