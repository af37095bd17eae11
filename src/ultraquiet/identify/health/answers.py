"""Whether a sensor answers to what the actuators do: coherence, tested against none at all."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.values import Record

# Segments of a record: so many more than four times its inputs; few and long, for modes that ring long. A mode that
# fills one line of them is told more surely by so many times as many. Fewer samples in one hold too few lines to test.
SEGMENTS, MORE, SHORTEST = 8, 4, 16
OWN_SHARE = 1e-6  # of an input that the others leave unexplained, of its strongest line: less is rounding
LEAST_P = 1e-300  # of one line


def answers(record: Record) -> tuple[FloatArray, FloatArray]:
    """Return p-values that a sensor's readings have nothing to do with the commands, and with each command.

    The record is cut into K segments. At each line the readings `(K,)` are regressed on the spectra of m inputs that
    move, none of which follows from the others; without an answer, the explained share of their power is Beta(m, K - m)
    and the share that one input explains of what the others leave is Beta(1, K - m), whatever the inputs are. Lines are
    put together three times, by the sum of -log p over the even and over the odd ones (many weak lines; neighbours of a
    Hann-windowed spectrum are correlated by 2/3, every second one by 1/6) and by the smallest p (one strong line);
    three times the least counts. All that is done with few long segments and with many short ones, and twice the lesser
    p counts (Bonferroni).

    Args:
        record: its samples; short ones (16 samples a segment) tell nothing.

    Returns:
        `(ny,)` and `(ny, nu)`; 1 where nothing is told, as of inputs that do not move.

    Reference: J. S. Bendat, A. G. Piersol, Random Data, 4th ed. (2010), chapter 9, doi:10.1002/9781118032428.
    """
    moving, few = _moving(record)
    told = [_answers(record, moving, k) for k in (few, MORE * few) if moving and record.samples // k >= SHORTEST]
    if not told:
        return np.ones(len(record.sensors)), np.ones((len(record.sensors), len(record.actuators)))
    any_p, each_p = (np.min(part, axis=0) for part in zip(*told, strict=True))
    return np.minimum(len(told) * any_p, 1.0), np.minimum(len(told) * each_p, 1.0)


def _answers(record: Record, moving: list[int], segments: int) -> tuple[FloatArray, FloatArray]:
    """Return the same p-values from so many segments."""
    each_p = np.ones((len(record.sensors), len(record.actuators)))
    U = np.stack([_lines(record.inputs[j], segments) for j in moving], axis=2)
    Y = np.stack([_lines(y, segments) for y in record.outputs], axis=2)
    own = _apart(U)
    free = segments - len(own)
    any_p = _together(_explained(U[:, :, own], Y, len(own)), len(own), free)
    for k, j in enumerate(moving):
        # Of inputs that follow from each other none can be told from the rest: what is heard may be each of them.
        if k not in own or _follows(U[:, :, [i for i in range(len(moving)) if i != k] + [k]]):
            each_p[:, j] = any_p
        else:
            each_p[:, j] = _together(_explained(U[:, :, [i for i in own if i != k] + [k]], Y, 1), 1, free)
    return any_p, each_p


def _apart(U: ComplexArray) -> list[int]:
    """Return inputs of which none follows from those before it, and all others from them.

    What rounding leaves of an input that follows is a direction of its own: any unit would decide what it explains.
    """
    own: list[int] = []
    for k in range(U.shape[2]):
        if not own or not _follows(U[:, :, [*own, k]]):
            own.append(k)
    return own


def tells(record: Record) -> bool:
    """Return whether an input moves, for long enough to tell who answers."""
    moving, segments = _moving(record)
    return bool(moving) and record.samples // segments >= SHORTEST


def _moving(record: Record) -> tuple[list[int], int]:
    moving = [j for j, u in enumerate(record.inputs) if np.ptp(u) > 0]
    return moving, SEGMENTS + 4 * len(moving)


def _lines(signal: FloatArray, segments: int) -> ComplexArray:
    """Return the spectra of a signal's segments, `(lines, segments)`."""
    size = signal.size // segments
    parts = (signal - signal.mean())[: segments * size].reshape(segments, size)
    # Divided by its size first, so that no unit takes squares out of range.
    scale = np.abs(parts).max()
    return np.fft.rfft(parts / (scale if scale > 0 else 1.0) * np.hanning(size), axis=1)[:, 1 : size // 2].T


def _follows(U: ComplexArray) -> bool:
    """Return whether the last input is a combination of the others at every line."""
    size = np.sqrt(np.sum(np.abs(U[:, :, -1]) ** 2, axis=1))
    own = np.abs(np.linalg.qr(U)[1][:, -1, -1])
    return bool(np.all(own <= OWN_SHARE * size.max()))


def _explained(U: ComplexArray, Y: ComplexArray, last: int) -> FloatArray:
    """Return what the `last` inputs explain of the power that the others leave, `(lines, ny)` between 0 and 1."""
    Q = np.linalg.qr(U)[0]
    power = np.abs(np.conj(np.swapaxes(Q, 1, 2)) @ Y) ** 2
    before, own = power[:, : power.shape[1] - last].sum(axis=1), power[:, power.shape[1] - last :].sum(axis=1)
    left = np.sum(np.abs(Y) ** 2, axis=1) - before
    return np.clip(own / np.where(left > 0, left, np.inf), 0.0, 1.0)


def _together(share: FloatArray, inputs: int, free: int) -> FloatArray:
    """Return one p-value a sensor from the shares of its lines, which without an answer are Beta(inputs, free)."""
    from scipy.special import betainc, gammaincc

    p = np.maximum(betainc(free, inputs, 1.0 - share), LEAST_P)
    summed = [gammaincc(len(part), -np.log(part).sum(axis=0)) for part in (p[::2], p[1::2])]
    strongest = -np.expm1(len(p) * np.log1p(-np.minimum(p.min(axis=0), 1.0 - 1e-16)))
    return np.minimum(3.0 * np.min([*summed, strongest], axis=0), 1.0)
