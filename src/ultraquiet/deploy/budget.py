"""Whether a law fits the frame of the TMS320C31-40: a published count of instructions, not a measurement."""

from ultraquiet._base.constraints import whole
from ultraquiet._base.errors import InputError
from ultraquiet.deploy.law import Law

# Section 4.2 of the paper: half of the 285 us between samples at 3.5 kHz is left to the law; at 50 ns an instruction
# that is 2800 instructions in 140 us.
BUDGET_CYCLES = 2800
# Reading six converters, writing six, the interrupt's entry and exit, in hand-written C31 code.
SKELETON_CYCLES = 142
# Instructions around the multiply-adds, counted in hand-written kernels (RPTS costs 1 + 3; pointers, store): per row
# of a full matrix, per state of a modal kernel, per state more in delta form, and once for the whole call.
ROW, STATE, DELTA, CALL = 10, 3, 1, 5
# A section of a bank takes in one number and puts out one; its loop is set up once for each channel.
SECTION = 2 + STATE
# Two blocks of on-chip RAM, 1K words of 32 bits each.
INTERNAL_WORDS = 2048

ASSUMPTIONS = (
    "TMS320C31-40, 50 ns an instruction, 20 million instructions a second; MPYF3 || ADDF3 does one multiply-add a cycle"
    " when two of its four sources are memory; coefficients and states lie in the two internal single-cycle RAM blocks"
    " (1K words each; a larger law needs external zero-wait memory); numbers are the C31's own; kernel counts are"
    " those of hand-written code for six inputs and six outputs, other sizes are scaled by their multiply-adds;"
    f" conversions, saturation and interrupt are the {SKELETON_CYCLES} cycles of the frame's skeleton. A law fits the"
    " model; it has not run on the DSP."
)


def kernel_cycles(
    form: str,
    states: int,
    inputs: int = 6,
    outputs: int = 6,
    *,
    anti_windup: bool = False,
    block: int | None = None,
    channels: int | None = None,
    turned: bool = False,
) -> int:
    """Return the instructions of one step on the C31, without the frame's skeleton.

    Six by six: dense (n + 6)(n + 16), modal 15 n + 101, delta 16 n + 101, anti-windup 6 n more; `schur` counts its
    rows like those of a dense matrix of `block` columns; a bank of m channels 5 n + 21 m + 5, `bank-delta` and its
    anti-windup n more each, transforms m (inputs + 10) + outputs (m + 10).

    Args:
        form: `modal`, `delta`, `bank`, `bank-delta`, `schur` or `dense`.
        states: n, stored states.
        inputs: measurements.
        outputs: commands.
        anti_windup: whether L (sat(u) - u) is added.
        block: number of columns of an average row of A in `schur` form; n when absent.
        channels: of a bank; the lesser of inputs and outputs when absent.
        turned: whether a bank stands between two transforms.

    >>> kernel_cycles("modal", 120), kernel_cycles("dense", 60), kernel_cycles("modal", 60, anti_windup=True)
    (1901, 5016, 1361)
    """
    more = states * outputs if anti_windup else 0
    if form in ("bank", "bank-delta"):
        m = min(inputs, outputs) if channels is None else channels
        per_state = SECTION + (DELTA if form == "bank-delta" else 0) + int(anti_windup and not turned)
        transforms = m * (inputs + ROW) + outputs * (m + ROW) + (more if anti_windup else 0) if turned else 0
        return states * per_state + m * (1 + 2 * ROW) + transforms + CALL
    if form in ("modal", "delta"):
        per_state = inputs + outputs + STATE + (DELTA if form == "delta" else 0)
        return states * per_state + outputs * (inputs + ROW) + CALL + more
    width = states if form == "dense" or block is None else block
    advance = states * (width + inputs + ROW)
    return advance + outputs * (states + inputs + ROW) + more


def cycles(law: Law) -> int:
    """Return the instructions of one frame: kernel and skeleton."""
    width = -(-sum(b.size for b in law.blocks) // law.states)
    return SKELETON_CYCLES + kernel_cycles(
        law.form,
        law.states,
        law.inputs,
        law.outputs,
        anti_windup=law.L is not None,
        block=width if law.form == "schur" else None,
        channels=len(law.channels) or None,
        turned=law.turned,
    )


def output_cycles(law: Law) -> int:
    """Return the kernel's instructions from measurements to commands, the part of the step that delays the loop."""
    if law.channels:
        m = len(law.channels)
        turns = m * (law.inputs + ROW) + law.outputs * (m + ROW) if law.turned else 0
        return law.states + m * (1 + ROW) + turns + CALL
    return law.outputs * (law.states + law.inputs + ROW) + CALL


def words(law: Law) -> int:
    """Return the 32-bit words of coefficients, states, measurements and commands."""
    return law.coefficients + law.states + law.inputs + 3 * law.outputs


def largest_order(
    form: str, budget: int = BUDGET_CYCLES, inputs: int = 6, outputs: int = 6, *, anti_windup: bool = False
) -> int:
    """Return the largest number of states whose frame fits the budget; an even one where blocks are 2x2.

    >>> [
    ...     largest_order("dense"),
    ...     largest_order("modal"),
    ...     largest_order("delta"),
    ...     largest_order("modal", anti_windup=True),
    ... ]
    [40, 170, 158, 120]
    """
    stride = 2 if form in ("modal", "delta", "bank", "bank-delta") else 1
    n = 0
    while SKELETON_CYCLES + kernel_cycles(form, n + stride, inputs, outputs, anti_windup=anti_windup) <= budget:
        n += stride
    return n


def require_fit(law: Law, budget: int) -> None:
    """Refuse a law whose frame does not fit, and say what would.

    Raises:
        InputError: with the law's count, the budget and the largest orders that fit.
    """
    whole("deploy", "budget_cycles", budget, 1)
    need = cycles(law)
    if need <= budget:
        return
    anti_windup = law.L is not None
    fits = largest_order(law.form, budget, law.inputs, law.outputs, anti_windup=anti_windup)
    modal = largest_order("modal", budget, law.inputs, law.outputs)
    raise InputError(
        f"deploy: {law.order} states in {law.form} form{' with anti-windup' if anti_windup else ''} need {need} of"
        f" {budget} C31 instructions; the largest order that would fit is {fits} in this form and {modal} in plain"
        " modal form, so reduce the controller or pass enforce_budget=False."
    )
