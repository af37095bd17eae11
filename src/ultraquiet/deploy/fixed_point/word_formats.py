"""The formats of a law in whole numbers, row by row."""

import numpy as np

from ultraquiet.deploy.fixed_point.law import FixedLaw
from ultraquiet.deploy.law.word_length import WordFormat


def fixed_formats(law: FixedLaw) -> tuple[WordFormat, ...]:
    """Return the formats of a law in fixed point, w bits a word.

    Coefficients have w - 2 + e fractional bits, e the shift of their row; states, readings and commands are fractions
    of full scale, w - 1 of them. The sum of a state has 2 w - 5, the one of a command w - 2 + c more than a state's.
    """
    w = law.bits
    shifts = np.concatenate([law.shift_a, law.shift_b, law.shift_u])
    of_commands = w - 1 + w - 2 + law.shift_u
    sums = np.append(of_commands, 2 * w - 5) if law.states else of_commands
    return (
        WordFormat("coefficients", w, fractional=(int(shifts.min() + w - 2), int(shifts.max() + w - 2))),
        WordFormat("states", w, fractional=(w - 1, w - 1)),
        WordFormat("sums", 2 * w, fractional=(int(sums.min()), int(sums.max()))),
        WordFormat("readings and commands", w, fractional=(w - 1, w - 1)),
    )
