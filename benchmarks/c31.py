"""The TMS320C31: cycles of emitted kernels counted by the test-suite's interpreter, beside the model and its limits."""

import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import numpy as np

from ultraquiet.deploy.c31 import cycles
from ultraquiet.deploy.c31.assembly import c31_code
from ultraquiet.deploy.law.anti_windup import conditioning_gain
from ultraquiet.deploy.law.law import Law, actuator_limits
from ultraquiet.deploy.law.realisation import Realisation
from ultraquiet.deploy.law.rounding import rounded

# The interpreter and the random laws live with the tests that check them.
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "deploy"))

c31_interpreter, c31_program, deploy_laws = map(import_module, ("c31_interpreter", "c31_program", "deploy_laws"))

ORDERS = (30, 60, 120, 170)
KERNEL_OF_60, FRAME = 1100, cycles.BUDGET_CYCLES
INTERRUPT = 4  # the vector's fetch empties the pipeline as a branch does


def measure() -> Iterator[tuple[str, str, str, bool]]:
    rng = np.random.default_rng(0)
    for states in ORDERS:
        yield from _one(_law(rng, states, "modal", False), KERNEL_OF_60 if states == 60 else None)
    yield from _one(_law(rng, 158, "delta", False), None)
    yield from _one(_law(rng, 120, "modal", True), None)
    yield from _one(_bank(rng, 60), None)
    for anti_windup, wanted in ((False, 170), (True, 120)):
        found = cycles.largest_order("modal", anti_windup=anti_windup)
        what = "largest modal order, 6 x 6" + (", anti-windup" if anti_windup else "")
        yield what, f"{found}", f"{wanted} states", found == wanted


def _one(law: Law, limit: int | None) -> Iterator[tuple[str, str, str, bool]]:
    code = c31_code(law)
    machine = c31_interpreter.Machine(c31_program.Program(code.assembly, code.linker))
    for j in range(law.inputs):
        machine.memory[machine.program.symbols["ADC"] + j] = 1000 * j
    whole = machine.run("controller_frame") + INTERRUPT
    kernel = machine.spent["controller_output"] + machine.spent["controller_update"]
    modelled = cycles.kernel_of(law)
    what = f"{law.states} states, {law.form}{', anti-windup' if law.L is not None else ''}"
    yield f"{what}: kernel", f"{kernel} cycles", f"{modelled} of the model", kernel == modelled
    if limit is not None:
        yield "its kernel", f"{kernel} cycles", f"at most {limit}", kernel <= limit
    least = 14 * law.states + 36
    yield "over 14 n + 36 multiply-adds", f"{kernel / least:.3f}", "told", True
    share = f"{100 * cycles.frame_cycles(law) / FRAME:.1f} % ({whole} counted)"
    yield (
        f"with a skeleton of {cycles.SKELETON_CYCLES}: share of {FRAME}",
        share,
        "at most 100 %",
        max(whole, cycles.frame_cycles(law)) <= FRAME,
    )
    place = "internal" if code.coefficients_internal else "external"
    words = f"{code.program_words} + {code.data_words} + {code.coefficient_words} {place}"
    yield "words of program, data, coefficients", words, "told", True


def _bank(rng: np.random.Generator, states: int) -> Law:
    """Return one law of the same size for each of six channels."""
    whole = _law(rng, states, "modal", False)
    own = np.arange(states)[:, None] // (states // 6) == np.arange(6)
    parts = Realisation(
        "bank", whole.blocks, whole.B * own, whole.C * own.T, np.diag(np.diag(whole.D)), 1.0, (states // 12,) * 6
    )
    return rounded(parts, None, actuator_limits(25.0, 6), "float32", rate_hz=deploy_laws.RATE_HZ, order=states)


def _law(rng: np.random.Generator, states: int, form: str, anti_windup: bool) -> Law:
    design = deploy_laws.random_law(rng, states, mixed=False)
    pairs = [design.A[k : k + 2, k : k + 2] for k in range(0, states, 2)]
    blocks = tuple(p - np.eye(2) if form == "delta" else p for p in pairs)
    parts = Realisation(form, blocks, design.B, design.C, design.D, 1.0)
    L = conditioning_gain(design.A, design.B, design.C, design.D) if anti_windup else None
    return rounded(parts, L, actuator_limits(25.0, 6), "float32", rate_hz=deploy_laws.RATE_HZ, order=states)
