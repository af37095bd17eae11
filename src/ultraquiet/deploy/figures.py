"""What each figure of a law's code is called, for whoever reads it: report, workbench, command line, its README.

`Deployment.tables` names figures for programs; these are the words, with the unit, that stand before a reader.
"""

from collections.abc import Mapping
from math import isfinite
from typing import Any

from ultraquiet.deploy.toolchain.targets import TARGETS

SAYS = {
    "states": "states",
    "form": "form of the equations",
    "precision": "number format",
    "anti_windup": "anti-windup",
    "anti_windup_because": "anti-windup, why",
    "c31_cycles": "TMS320C31, instructions a sample",
    "c31_kernel_cycles": "of these u = C x + D y and the update",
    "c31_output_cycles": "TMS320C31, instructions before the commands are ready",
    "c31_budget": "TMS320C31, instructions a sample may take",
    "c31_budget_share": "share of these instructions",
    "c31_fits_the_model": "fits the TMS320C31, by its model",
    "c31_words": "TMS320C31, data and coefficients (32-bit words)",
    "c31_internal_words": "TMS320C31, words on the chip",
    "c31_largest_order": "most states of this form that would fit",
    "c31_vectors": "TMS320C31, how far its test vectors go",
    "coefficients": "coefficients",
    "response_error": "error by rounding, relative",
    "forms_tried": "error by rounding of each form, relative",
    "eigenvector_condition": "condition of the eigenvectors",
    "bit_exact": "every bit that of its twin",
    "instructions_on": "instructions a sample on",
    "bit_exact_on": "every bit that of its twin on",
    "flash_bytes": "flash (bytes)",
    "flash_from": "flash measured by",
    "ram_bytes": "RAM (bytes)",
    "stack_bytes": "stack (bytes)",
    "latency_us": "from readings to commands (us)",
    "bench_loss_db": "lost on the bench beside float64 (dB)",
    "measurements": "readings, in the order of the code",
    "commands": "commands, in the order of the code, and their limits",
    "scaling": "scaling",
    "state_bound": "state bound (share of full scale)",
    "accumulator_bound": "accumulator bound (share of full scale)",
    "noise_v": "rounding noise in the commands, rms (their unit)",
    "noise_bound_v": "rounding noise at most (their unit)",
    "multiply_adds": "multiplications and additions a sample",
    "coefficient_bytes": "coefficients (bytes)",
}
# Figures of a simulation of frames, `FrameSimulation.table`.
OF_FRAMES = {
    "times": "times taken from",
    "ran": "what ran",
    "frames": "frames",
    "period_us": "period (us)",
    "step_us": "one step (us)",
    "utilisation_step": "share of a frame that a step takes",
    "utilisation_with_background": "share with background work",
    "mean_latency_us": "from tick to commands, mean (us)",
    "worst_latency_us": "from tick to commands, worst (us)",
    "start_jitter_us": "spread of the steps' starts (us)",
    "worst_step_end_us": "latest end of a step (us)",
    "slack_us": "left before the next tick (us)",
    "worst_background_end_us": "latest end of background work (us)",
    "overruns": "overruns",
    "late_background_frames": "frames that end with background work undone",
    "frames_out_of_control": "frames without control",
}
_ON_TARGET = {
    "instructions": "{}, instructions a sample",
    "output_instructions": "{}, instructions before the commands are ready",
}


def figure_words(name: str) -> str:
    """Return what a figure of `tables` is, in words and with its unit.

    >>> figure_words("ram_bytes")
    'RAM (bytes)'
    >>> figure_words("cortex_m7_instructions")
    'Cortex-M7, instructions a sample'
    """
    for target in TARGETS.values():
        for tail, words in _ON_TARGET.items():
            if name == f"{target.key}_{tail}":
                return words.format(target.title)
    return SAYS[name] if name in SAYS else OF_FRAMES[name]


def figure_text(value: Any) -> str:
    """Return the value of a figure as a reader wants it.

    >>> figure_text({"cortex-m4f": True, "cortex-m7": None})
    'cortex-m4f yes, cortex-m7 -'
    """
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {figure_text(each)}" for key, each in value.items()) or "-"
    if isinstance(value, list | tuple):
        return ", ".join(map(figure_text, value))
    if isinstance(value, float):
        return f"{value:.3g}" if isfinite(value) else "without bound"
    return str(value)


def said(tables: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return every figure of `tables` as words and text."""
    return [(figure_words(name), figure_text(value)) for name, value in tables.items()]
