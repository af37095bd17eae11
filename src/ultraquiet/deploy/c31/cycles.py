"""Whether a law fits the frame of the TMS320C31-40: a published count of instructions, not a measurement."""

import math
from typing import Any

from ultraquiet._base.constraints import between
from ultraquiet._base.errors import InputError
from ultraquiet.deploy.law.law import Law

# Section 4.2 of the paper: half of the 285 us between samples at 3.5 kHz is left to the law; at 50 ns an instruction
# that is 2800 instructions in 140 us. At another rate the law has the same share of a frame.
BUDGET_CYCLES, AT_HZ = 2800, 3500.0
# Reading six converters, limiting, writing six, the registers saved and the interrupt's entry and exit: an allowance.
# The emitted frame takes FRAME and so much a measurement and a command, 131 and 140 cycles six by six; where that is
# more than the allowance, it counts instead.
SKELETON_CYCLES = 142
FRAME, FRAME_WITH_CORRECTION, READ, WRITE = 71, 74, 2, 8
# Of the emitted modal and delta kernels: per row of commands LDF, RPTS (1 + 3), ADDF3, RND, STF; per state
# two products of its block and one RND; in delta form one ADDF3 more; once eight pointers and settings before the rows,
# LDI and RPTB (1 + 3) before the update, four to drain it.
KERNEL_ROW, STATE, DELTA, SET_UP, UPDATE = 8, 3, 1, 8, 9
# Of hand-written kernels for full matrices: instructions around a row's multiply-adds, and around a whole call.
ROW, CALL = 10, 5
# Of an emitted bank: a state takes in one number and puts out one; a channel more than a row of commands one product,
# LDF, LDI and RPTB; once one pointer more, and no LDI before the update. A channel that is a gain has no loops.
SECTION, CHANNEL, BANK, GAIN = 2 + STATE, 1 + 6, 4 + 1, 5
# Two blocks of on-chip RAM, 1K words of 32 bits each.
INTERNAL_WORDS = 2048

# Words of the emitted data beside the law's own: nine pointers, two scales, the count of coefficients and the tables'
# sum, one pointer more with anti-windup, and two words before the first state that take the stores of the filling
# pipeline.
POINTERS, AHEAD = 13, 2

ASSUMPTIONS = (
    "TMS320C31-40, 50 ns an instruction, 20 million instructions a second; one cycle an instruction, RPTS, RPTB and"
    " returns four, a repeated instruction is not fetched again; MPYF3 || ADDF3 does one multiply-add a cycle, two of"
    " its four sources from memory; program, states and measurements lie in internal block 0, coefficients in block 1"
    " (1K words each) or, beyond its 896 free words, in external memory without wait states; a block serves two"
    " accesses a cycle, external memory one; a store before two reads costs a cycle, a pointer written and used at once"
    " two. Numbers are the C31's own. Modal, delta and plain bank counts are those of the emitted code, instruction by"
    " instruction; transforms, Schur and dense ones are scaled from hand-written kernels by their multiply-adds."
    f" Conversions, limits and interrupt are allowed {SKELETON_CYCLES} cycles. A law fits the model; it has not run on"
    " the DSP."
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
    rows like those of a dense matrix of `block` columns; a bank of m channels 5 n + 15 m + 13, `bank-delta` n and its
    anti-windup n + m more, transforms m (inputs + 10) + outputs (m + 10).

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
        per_channel = KERNEL_ROW + CHANNEL + int(anti_windup and not turned)
        return states * per_state + m * per_channel + transforms + SET_UP + BANK
    if form in ("modal", "delta"):
        per_state = inputs + outputs + STATE + (DELTA if form == "delta" else 0)
        return states * per_state + outputs * (inputs + KERNEL_ROW) + SET_UP + UPDATE + more
    width = states if form == "dense" or block is None else block
    advance = states * (width + inputs + ROW)
    return advance + outputs * (states + inputs + ROW) + more


def frame_cycles(law: Law) -> int:
    """Return the instructions of one frame: kernel and skeleton."""
    return kernel_of(law) + skeleton_cycles(law.inputs, law.outputs, anti_windup=law.L is not None)


def kernel_of(law: Law) -> int:
    """Return the instructions of one step of this law, without the frame's skeleton."""
    kernel = kernel_cycles(law.form, law.states, law.inputs, law.outputs, **count_settings(law))
    return kernel - GAIN * law.channels.count(0) - _rows_of_gains(law)


def skeleton_cycles(inputs: int = 6, outputs: int = 6, *, anti_windup: bool = False) -> int:
    """Return what the frame around the kernel is allowed: 142, or what the emitted one takes where that is more.

    >>> skeleton_cycles(), skeleton_cycles(12, 12)
    (142, 191)
    """
    counted = FRAME_WITH_CORRECTION + outputs if anti_windup else FRAME
    return max(SKELETON_CYCLES, counted + READ * inputs + WRITE * outputs)


def _rows_of_gains(law: Law) -> int:
    """Return what rows of commands save where a channel is a gain; the last one waits a cycle for its pointer."""
    return GAIN * law.channels.count(0) - int(law.channels[-1:] == (0,))


def count_settings(law: Law) -> dict[str, Any]:
    """Return what beside form and size decides the count."""
    width = -(-sum(b.size for b in law.blocks) // law.states)
    return {
        "anti_windup": law.L is not None,
        "block": width if law.form == "schur" else None,
        "channels": len(law.channels) or None,
        "turned": law.turned,
    }


def output_cycles(law: Law) -> int:
    """Return the kernel's instructions from measurements to commands, the part of the step that delays the loop."""
    if law.channels:
        m = len(law.channels)
        turns = m * (law.inputs + ROW) + law.outputs * (m + ROW) if law.turned else 0
        return law.states + m * (1 + KERNEL_ROW) - _rows_of_gains(law) + turns + SET_UP + 1
    if law.form in ("modal", "delta"):
        return law.outputs * (law.states + law.inputs + KERNEL_ROW) + SET_UP
    return law.outputs * (law.states + law.inputs + ROW) + CALL


def words(law: Law) -> int:
    """Return the 32-bit words of coefficients and data, without the program; for modal and delta the emitted ones.

    Alignment of the ring of measurements may add up to 31.
    """
    corrections = 0 if law.L is None else law.outputs + 1
    gains = sum(M.size for M in (*law.blocks, law.B, law.C, law.D, law.L) if M is not None) + 2 * law.outputs
    if law.channels:
        own = 5 if law.L is not None and not law.turned else 4
        turns = sum(T.size for T in (law.turn_in, law.turn_out) if T is not None)
        gains = own * law.states + len(law.channels) + turns + 2 * law.outputs
        gains += law.L.size if law.L is not None and law.turned else 0
    return gains + law.states + law.inputs + law.outputs + corrections + POINTERS + AHEAD


def budget_at(rate_hz: float) -> int:
    """Return the instructions left to a law at a rate in Hz.

    >>> budget_at(3500.0), budget_at(8000.0)
    (2800, 1225)
    """
    return max(int(BUDGET_CYCLES * AT_HZ / rate_hz), 1)


def largest_order(
    form: str,
    budget: int = BUDGET_CYCLES,
    inputs: int = 6,
    outputs: int = 6,
    *,
    anti_windup: bool = False,
    block: int | None = None,
    channels: int | None = None,
    turned: bool = False,
) -> int:
    """Return the largest number of states whose frame fits the budget; an even one where blocks are 2x2.

    Arguments as in `kernel_cycles`; 0 when not even the smallest law fits.

    >>> [
    ...     largest_order("dense"),
    ...     largest_order("modal"),
    ...     largest_order("delta"),
    ...     largest_order("modal", anti_windup=True),
    ... ]
    [40, 170, 158, 120]
    """
    stride = 2 if form in ("modal", "delta", "bank", "bank-delta") else 1
    law_shape = {"anti_windup": anti_windup, "block": block, "channels": channels, "turned": turned}
    frame = skeleton_cycles(inputs, outputs, anti_windup=anti_windup)

    def fits(strides: int) -> bool:
        return frame + kernel_cycles(form, strides * stride, inputs, outputs, **law_shape) <= budget

    most = 1
    while fits(most):
        most *= 2
    least = most // 2
    while most - least > 1:  # more states never take fewer cycles
        middle = (least + most) // 2
        least, most = (middle, most) if fits(middle) else (least, middle)
    return least * stride


def require_fit(law: Law, budget: int, share: float = 1.0) -> None:
    """Refuse a law whose frame takes more than `share` of the budget, and say what would fit.

    Raises:
        InputError: with the law's count, the budget and the largest orders that fit; an impossible budget or share.
    """
    between("deploy", "budget_share", share, 0.0, 1.0)
    need, allowed = frame_cycles(law), math.floor(share * budget)
    if need <= allowed:
        return
    law_shape = count_settings(law)
    fits = largest_order(law.form, allowed, law.inputs, law.outputs, **law_shape)
    modal = largest_order("modal", allowed, law.inputs, law.outputs)
    of = f"{budget}" if share == 1.0 else f"{allowed} ({100 * share:g} % of {budget})"
    raise InputError(
        f"deploy: {law.order} states in {law.form} form{' with anti-windup' if law_shape['anti_windup'] else ''} need"
        f" {need} of {of} C31 instructions; the largest order that would fit is {fits} in this form and {modal} in"
        " plain modal form, so reduce the controller or allow it more of the budget (budget_share, enforce_budget)."
    )
