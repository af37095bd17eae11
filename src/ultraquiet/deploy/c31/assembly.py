"""From a law to TMS320C31 assembly whose cycles are those of the model."""

import math
from dataclasses import dataclass

import numpy as np

from ultraquiet._base.constraints import FloatArray
from ultraquiet._base.errors import InputError
from ultraquiet._base.shown import Shown
from ultraquiet.deploy.c31 import cycles
from ultraquiet.deploy.c31.float_format import decode, encode
from ultraquiet.deploy.c_code.plan import CodePlan
from ultraquiet.deploy.c_code.render import render
from ultraquiet.deploy.law.law import Law

BLOCK_0, BLOCK_1 = 0x809800, 0x809C00
# The boot loader keeps the last 63 words of block 1 for the interrupts' branches; 64 below them are left to the stack.
COEFFICIENTS_END = 0x809F80
EXTERNAL = 0x80A000
# Converters of a board that is not known: addresses, and 16 bits over +-10 V in, +-10 V out.
ADC, DAC = 0xA00000, 0xA00010
VOLTS_PER_COUNT, COUNTS_PER_VOLT = 10.0 / 2**15, 2**15 / 10.0
# A code beyond 16 bits would wrap round to the other end. The lowest code is left as room: the factor's 24 bits lie a
# little above the true one and FIX goes downwards, so -10 V itself would become -32769, which the converter takes for
# +32767.
MOST_COUNTS = 2**15 - 1
SECTION_STEP = 32  # section origins are multiples of this, at least the alignment of the ring
FORMS = ("modal", "delta", "bank", "bank-delta")
MOST_REPEATS = 2**15  # an immediate of RPTS is 16 bits, taken as signed to be safe


@dataclass(frozen=True)
class C31Code(Shown):
    """Texts for the TMS320C3x assembler and linker, and the words they take of which memory."""

    assembly: str
    linker: str
    program_words: int
    data_words: int
    coefficient_words: int
    coefficients_internal: bool


def c31_code(law: Law, model_hash: str = "") -> C31Code:
    """Return one frame of the law as C31 assembly: converters, output, limits, converters, update.

    The kernel takes `cycles.kernel_of` cycles, the rest at most `cycles.skeleton_cycles`. Every command
    is held within the actuator's limits and the converter's range before it becomes a code; the C31 has
    no NaN or infinity, a sum beyond its numbers stays at their end. Ramps, faults and overruns are left
    to the background; the C99 code holds them.

    Args:
        law: in modal, delta or bank form, a bank without transforms.
        model_hash: named in the header.

    Raises:
        InputError: another form, a command without a limit, a coefficient beyond the C31's numbers, or a law beyond
            its internal memory.

    >>> from ultraquiet.deploy import generate
    >>> from ultraquiet.values import StateSpace
    >>> import tempfile
    >>> law = StateSpace([[0.9, 0.1], [-0.1, 0.9]], [[0.1], [0.0]], [[1.0, 0.0]], [[0.0]], rate_hz=3500.0)
    >>> code = c31_code(generate(law, tempfile.mkdtemp() + "/code", form="modal", limits_v=5.0).law)
    >>> code.coefficient_words, "RPTB    controller_last" in code.assembly
    (9, True)
    """
    _require(law)
    text = render("c31.asm.j2", _context(law, model_hash))
    words = _section_words(text)
    table = _next(BLOCK_0 + words[".text"])
    state = _next(table + words["table"])
    if state + words["state"] > BLOCK_1:
        raise InputError(
            f"deploy: {law.states} states with their program do not fit one block of the C31's memory, 1024 words;"
            " reduce the controller."
        )
    inside = coefficients_internal(law)
    coefs = BLOCK_1 if inside else EXTERNAL
    places = {"text": BLOCK_0, "table": table, "state": state, "coefs": coefs}
    linker = render("c31.cmd.j2", {"name": law.name, **{key: f"0x{place:06X}" for key, place in places.items()}})
    return C31Code(text, linker, words[".text"], words["table"] + words["state"], words["coefs"], inside)


def c31_files(plan: CodePlan) -> dict[str, str]:
    """Return file name -> text of what the folder holds for the C31."""
    law, code = plan.law, c31_code(plan.law, plan.model_hash)
    return {f"{law.name}_c31.asm": code.assembly, f"{law.name}_c31.cmd": code.linker}


def coefficients_internal(law: Law) -> bool:
    """Return whether the kernel's coefficients fit internal block 1; else they stream from external memory."""
    return len(_stream(law)) <= COEFFICIENTS_END - BLOCK_1


def converter_limits(law: Law) -> FloatArray:
    """Return the range of each command in volts, `(nu, 2)`: the actuator's limits, and nothing the converter cannot."""
    most = MOST_COUNTS / COUNTS_PER_VOLT
    return np.clip(law.limits.astype(np.float64), -most, most)


def table_sum(law: Law) -> int:
    """Return what the emitted check must find: s = turned(s) + word over scales, limits and coefficients, modulo 2^32.

    `turned` moves each bit one place to the left and the highest to the lowest, so that a word changed by any bit, and
    two words exchanged, change the sum.
    """
    numbers = [[VOLTS_PER_COUNT, COUNTS_PER_VOLT], converter_limits(law).ravel(), _stream(law)]
    total = 0
    for word in encode(np.concatenate(numbers)).tolist():
        total = ((total << 1 | total >> 31) + word) & 0xFFFFFFFF
    return total


def _require(law: Law) -> None:
    if not isinstance(law, Law):
        raise InputError(f"deploy: C31 assembly needs the rounded law, `generate(...).law`, got {type(law).__name__}.")
    if not np.isfinite(law.known_limits).all():
        raise InputError(
            "deploy: C31 assembly turns commands into counts of a converter, and nobody says how far they may go;"
            " state the actuators' range, or the converter's where that is narrower, with limits_v."
        )
    if law.form not in FORMS:
        raise InputError(
            f"deploy: C31 assembly is written for modal, delta and bank form, not for {law.form}; take form='modal' or"
            " targets=('c99',)."
        )
    if law.turned:
        raise InputError(
            "deploy: C31 assembly of a bank knows no transforms around it; take form='modal' or targets=('c99',)."
        )
    if law.states + law.inputs > MOST_REPEATS:
        raise InputError(f"deploy: a row of {law.states + law.inputs} terms is beyond one RPTS of the C31.")


def _context(law: Law, model_hash: str) -> dict[str, object]:
    anti_windup = law.L is not None
    bank = bool(law.channels)
    ring = law.inputs if bank else law.inputs - 1 + (law.outputs if anti_windup else 0)
    align = 2 ** math.ceil(math.log2(ring + 1)) if ring else 1  # circular addressing: 2^K above the block's size
    if align > SECTION_STEP:
        raise InputError(
            f"deploy: {ring + 1} measurements and corrections exceed the {SECTION_STEP - 1} of a C31 ring here;"
            " take targets=('c99',)."
        )
    saved = ["ST", "DP", "IR0", "BK", "RS", "RE", "RC", *(f"AR{k}" for k in range(8 if anti_windup else 7))]
    return {
        "law": law,
        "name": law.name,
        "rate": f"{law.rate_hz:g}",
        "model_hash": model_hash or "not given",
        "zero": _words([0.0])[0][0],
        "n": law.states,
        "ny": law.inputs,
        "nu": law.outputs,
        "anti_windup": anti_windup,
        "ring": ring,
        "align": align,
        "block_size": max(ring, 1),
        "pad": -(cycles.AHEAD + law.states + (0 if bank else 1)) % align,
        "bank": bank,
        "channel_states": [2 * blocks for blocks in law.channels],
        **(_bank_places(law, align) if bank else _places(law, ring)),
        "saved": saved,
        "adc": f"0x{ADC:06X}",
        "dac": f"0x{DAC:06X}",
        "adc_scale": _words([VOLTS_PER_COUNT])[0][0],
        "dac_scale": _words([COUNTS_PER_VOLT])[0][0],
        "limits": _words(converter_limits(law)),
        "most_counts": MOST_COUNTS,
        "coefficients": _words(_stream(law)),
        "table_sum": f"0x{table_sum(law):08X}",
        "place": "internal block 1" if coefficients_internal(law) else "external memory without wait states",
        "kernel_cycles": cycles.kernel_of(law),
        "skeleton": cycles.skeleton_cycles(law.inputs, law.outputs, anti_windup=anti_windup),
    }


def _places(law: Law, ring: int) -> dict[str, object]:
    """Return what lies in the state section, in words, and where its pointers begin; y0 has a register of its own."""
    end, odd = f"{law.name}_ring + {law.inputs - 1}", law.outputs % 2
    layout = [("", cycles.AHEAD), ("_x", law.states), ("_y", 1), ("_ring", ring), ("_u", law.outputs)]
    return {
        "layout": layout,
        "first": end if odd else f"{law.name}_x",
        "at_ring": f"{law.name}_ring",
        "excess": end,
    }


def _bank_places(law: Law, align: int) -> dict[str, object]:
    """Return the same for a bank, whose measurements are one ring and whose corrections are another."""
    corrections = law.outputs if law.L is not None else 0
    measured = align if corrections else law.inputs
    layout = [("", cycles.AHEAD), ("_x", law.states), ("_y", measured), ("_ring", corrections), ("_u", law.outputs)]
    return {
        "layout": layout,
        "first": f"{law.name}_x",
        "at_ring": f"{law.name}_y",
        "excess": f"{law.name}_ring",
    }


def _stream(law: Law) -> FloatArray:
    """Return the coefficients in the order in which the kernel takes them.

    First [C D] row by row, every second one from its end, the last one always; then for each state
    a_k1, b_0, a_k2, b_1..., with L after B. A bank has of each only its channel's own.
    """
    if law.channels:
        return _bank_stream(law)
    gain = np.concatenate([law.C, law.D], axis=1).astype(np.float64)
    rows = [row if (law.outputs - i) % 2 == 0 else row[::-1] for i, row in enumerate(gain)]
    drive = law.B if law.L is None else np.concatenate([law.B, law.L], axis=1)
    own = np.concatenate(law.blocks, axis=0)
    update = np.concatenate([own[:, :1], drive[:, :1], own[:, 1:], drive[:, 1:]], axis=1).astype(np.float64)
    return np.concatenate([*rows, update.ravel()])


def _bank_stream(law: Law) -> FloatArray:
    ends = np.cumsum([0, *(2 * blocks for blocks in law.channels)])
    parts = [np.append(law.C[c, ends[c] : ends[c + 1]], law.D[c, c]) for c in range(len(law.channels))]
    channel = np.repeat(np.arange(len(law.channels)), np.diff(ends))
    own, row = np.concatenate(law.blocks, axis=0), np.arange(law.states)
    columns = [own[:, 0], law.B[row, channel], own[:, 1]]
    if law.L is not None:
        columns.append(law.L[row, channel])
    return np.concatenate([*parts, np.stack(columns, axis=1).ravel()]).astype(np.float64)


def _words(values: object) -> list[tuple[str, str]]:
    """Return each number as a word of the C31 and, for the reader, in decimal."""
    words = encode(np.ravel(np.asarray(values, dtype=np.float64)))
    return [(f"0x{word:08X}", f"{value:.9g}") for word, value in zip(words, decode(words), strict=True)]


def _section_words(text: str) -> dict[str, int]:
    """Return the words of each section; an instruction is one word, its parallel half (||) adds none."""
    words: dict[str, int] = {}
    section = ""
    for line in text.splitlines():
        part = line.split(";")[0].split()
        if not part or part[0].endswith(":") or part[0] in (".global", ".end", "||") or ".set" in part:
            continue
        if part[0] == ".sect":
            section = part[1].strip('"')
        elif part[0] == ".text":
            section = part[0]
        else:
            words[section] = words.get(section, 0) + (int(part[1]) if part[0] == ".space" else 1)
    return words


def _next(place: int) -> int:
    return place + -place % SECTION_STEP
