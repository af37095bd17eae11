"""From a law to whole numbers, scaled so that nothing can overflow."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, frozen, one_of
from ultraquiet._base.errors import InputError
from ultraquiet.deploy.fixed_point.law import WORDS, FixedLaw, Whole
from ultraquiet.deploy.fixed_point.ranges import full_ranges
from ultraquiet.deploy.fixed_point.state_bounds import energies, peaks, rounding_peaks, rounding_powers
from ultraquiet.deploy.law.realisation import Realisation, realisation
from ultraquiet.values.state_space import StateSpace

FORMS_FIXED = ("modal", "delta")
SCALINGS = ("l1", "l2")
# States of an L2-scaled law are left this many times the root mean square that white noise at full range gives them.
CREST = 4.0
ROUNDS = 30  # attempts to find a scale whose rounded law keeps within its words
# An accumulator of 2 w bits with 2 w - 5 behind the point holds sixteen times a state's range.
ACC_RANGE = 16.0


def fixed_law(
    controller: StateSpace,
    word: str = "q31",
    form: str = "modal",
    *,
    scaling: str = "l1",
    input_v: float | None = None,
    output_v: ArrayLike | None = None,
    name: str = "controller",
    ramp_bits: int = 0,
) -> FixedLaw:
    """Return a law in whole numbers.

    Args:
        controller: discrete, stable law from measurements to commands.
        word: `q31` (32-bit words, 64-bit accumulators) or `q15` (16, 32).
        form: `modal` or `delta`.
        scaling: `l1`: no state or sum can overflow while measurements stay in range; `l2`: states keep more bits, and
            are limited where noise at full range would carry them past four times its root mean square.
        input_v: full range of every measurement, in its unit; the largest of the law's own channels when absent.
        output_v: full range of every command, in its unit; commands saturate there. Of limits of each, `(nu,)` or
            `(nu, 2)`, the smallest size; that of the law's own channels when absent.
        name: prefix of every file and symbol.
        ramp_bits: the ramp takes 2^ramp_bits steps.

    Raises:
        InputError: a law or a rounded law that is not stable, a range that nobody states, or states that rounding alone
            could fill.

    >>> law = StateSpace([[0.9, 0.1], [-0.1, 0.9]], [[0.1], [0.0]], [[1.0, 0.0]], [[0.0]], rate_hz=3500.0)
    >>> made = fixed_law(law, "q15", input_v=10.0, output_v=5.0)
    >>> made.A.tolist(), made.peak <= 1.0
    ([[14746, 1638, -1638, 14746]], True)

    Reference: Jackson, IEEE Trans. Audio Electroacoust. 18 (1970), doi:10.1109/TAU.1970.1162084.
    """
    _check(controller, word, form, scaling)
    input_v, output_v = full_ranges("fixed_law", controller, input_v, output_v)
    try:
        parts = _normalised(realisation(controller, form), input_v, output_v)
    except InputError as refusal:
        # Its own advice names forms of floating point, which these words have not.
        why = str(refusal).partition(";")[0].removeprefix("deploy: ")
        raise InputError(f"fixed_law: {why}; take precision='float32', which knows other forms.") from refusal
    scale = _scale(parts, scaling)
    settings: dict[str, Any] = {"name": name, "word": word, "form": form, "scaling": scaling, "input_v": input_v}
    settings |= {"output_v": output_v, "rate_hz": float(controller.rate_hz or 0), "order": controller.states}
    settings["ramp_bits"] = ramp_bits
    law, room = _rounded(parts, scale, settings), np.zeros(0)
    for _ in range(ROUNDS):
        room = _occupied(law)
        if law.saturates or np.all(room <= 1.0):
            break
        scale = scale * np.maximum(1.0, room * (1 + 1e-3))
        law = _rounded(parts, scale, settings)
    if not law.saturates and np.any(room > 1.0):
        raise InputError(
            f"fixed_law: in {word} {form} form rounding alone could carry a state past its range (bound"
            f" {room.max():.1f} of full scale); take {_longer(law.bits)}."
        )
    return replace(law, peak=float(room.max()))


def _check(controller: StateSpace, word: str, form: str, scaling: str) -> None:
    one_of("fixed_law", "word", word, tuple(WORDS))
    one_of("fixed_law", "form", form, FORMS_FIXED)
    one_of("fixed_law", "scaling", scaling, SCALINGS)
    if not isinstance(controller, StateSpace) or controller.rate_hz is None:
        raise InputError("fixed_law: 'controller' must be a StateSpace in discrete time.")
    if not controller.is_stable():
        size = np.abs(controller.poles()).max()
        raise InputError(
            f"fixed_law: a pole of magnitude {size:.9f} gives states no bound, so no fixed-point scale exists; take"
            " precision='float32'."
        )


def _normalised(parts: Realisation, input_v: float, output_v: float) -> Realisation:
    """Return the law from and to fractions of full scale."""
    return replace(parts, B=parts.B * input_v, C=parts.C / output_v, D=parts.D * input_v / output_v)


def _scale(parts: Realisation, scaling: str) -> FloatArray:
    """Return for each block the size of its states that becomes one."""
    A = _stacked(parts)
    B = parts.B.reshape(len(A), 2, -1)
    if scaling == "l1":
        size = peaks(A, B).max(axis=1)
    else:
        # No less than what one sample of all measurements together can put into the sum.
        size = np.maximum(CREST * np.sqrt(energies(A, B)), np.abs(B).sum(axis=2)).max(axis=1)
    return np.where(size > 0, size, 1.0)


def _stacked(parts: Realisation) -> FloatArray:
    return np.stack(parts.blocks) + (np.eye(2) if parts.delta else 0.0)


def _rounded(parts: Realisation, scale: FloatArray, settings: dict[str, Any]) -> FixedLaw:
    bits = WORDS[settings["word"]]
    each = np.repeat(scale, 2)
    A, shift_a = _integers(np.stack(parts.blocks).reshape(-1, 4), bits, 2, lowest=-1)
    B, shift_b = _integers(parts.B / each[:, None], bits)
    gains = np.concatenate([parts.D, parts.C * each], axis=1)
    both, shift_u = _integers(gains, bits, lowest=3 - bits, highest=bits + 1)
    D, C = both[:, : parts.D.shape[1]], both[:, parts.D.shape[1] :].T
    blank = np.zeros(len(D))
    law = FixedLaw(
        A=frozen(A),
        B=frozen(B),
        C=frozen(np.ascontiguousarray(C)),
        D=frozen(np.ascontiguousarray(D)),
        shift_a=frozen(shift_a),
        shift_b=frozen(shift_b),
        shift_u=frozen(shift_u),
        peak=np.inf,
        accumulator=np.inf,
        noise_v=blank,
        noise_bound_v=blank,
        **settings,
    )
    if np.abs(np.linalg.eigvals(law.fractions()[0].reshape(law.states, -1))).max(initial=0.0) >= 1.0:
        form = "" if law.delta else "form='delta' or "
        raise InputError(
            f"fixed_law: the law is stable, its {law.word} coefficients in {law.form} form are not; take"
            f" {form}{_longer(bits)}."
        )
    return _noise(law)


def _integers(
    rows: FloatArray, bits: int, parts: int = 1, lowest: int = 0, highest: int | None = None
) -> tuple[Whole, Whole]:
    """Return rows as integers of one shift e a row: c 2^(bits - 2 + e), e as large as keeps every sum |c| 2^e below 2.

    `parts` rows of the matrix lie behind one another in a row given here, and their sums count apart.
    """
    sums = np.abs(rows).reshape(len(rows), parts, -1).sum(axis=2).max(axis=1)
    with np.errstate(divide="ignore"):
        shift = np.floor(np.log2(2.0 / sums))
    # More than 2 bits - 6 of them would leave the accumulator's own last place. A command goes down by bits - 2 + e
    # places at once, and a word of 2 bits has no more than that less one: beyond e = bits + 1 C leaves it open what
    # the shift does.
    highest = 2 * bits - 6 if highest is None else highest
    shift = np.clip(np.where(np.isfinite(shift), shift, 0.0), lowest, highest)
    while True:
        integers = np.rint(rows * 2.0 ** (bits - 2 + shift)[:, None])
        over = np.abs(integers).reshape(len(rows), parts, -1).sum(axis=2).max(axis=1, initial=0.0) >= 2.0 ** (bits - 1)
        if not over.any():
            return integers.astype(np.int64), shift.astype(np.int64)
        if np.any(shift[over] <= lowest):
            raise InputError(
                f"fixed_law: a row of gains sums to {sums[over].max():.1e} of full scale, too much for a word of"
                f" {bits} bits; take {_longer(bits)} or a larger output_v."
            )
        shift = shift - over


def _longer(bits: int) -> str:
    """Return the next word that holds more than one of so many bits."""
    return next((word for word, more in WORDS.items() if more > bits), "float32")


def _noise(law: FixedLaw) -> FixedLaw:
    """Add what rounding does to the commands, and how far sums can go."""
    A, B, C, _ = law.fractions()
    lsb = 2.0 ** (1 - law.bits)
    step = _step_error(law)
    blocks = _own(A)
    seen = C.T.reshape(len(blocks), 2, -1)
    bound = step * rounding_peaks(blocks, seen).sum(axis=0) + lsb / 2
    # Rounding errors count as white and even over the last place: variance lsb^2 / 12.
    rms = np.sqrt((rounding_powers(blocks, seen).sum(axis=0) + 1.0) / 12.0) * lsb
    advance = np.abs(A - np.eye(law.states) * law.delta).sum(axis=1) + np.abs(B).sum(axis=1)
    largest = float(np.max(advance / ACC_RANGE, initial=0.0))
    return replace(law, noise_v=rms * law.output_v, noise_bound_v=bound * law.output_v, accumulator=largest)


def _step_error(law: FixedLaw) -> float:
    """Return the largest error of a state by the roundings of one step, in fractions of full scale."""
    return 0.5 * 2.0 ** (1 - law.bits) + 2.0 ** (5 - 2 * law.bits)


def _own(A: FloatArray) -> FloatArray:
    at = np.arange(0, len(A), 2)
    return np.stack([A[k : k + 2, k : k + 2] for k in at])


def _occupied(law: FixedLaw) -> FloatArray:
    """Return for each block the bound on its states, rounding included, over the largest positive word."""
    A, B, _, _ = law.fractions()
    blocks = _own(A)
    ones = np.repeat(np.eye(2)[None], len(blocks), axis=0)
    reach = peaks(blocks, B.reshape(len(blocks), 2, -1)) + _step_error(law) * rounding_peaks(blocks, ones)
    return reach.max(axis=1) / (1.0 - 2.0 ** (1 - law.bits))
