"""Frequency response functions from records."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ultraquiet._base.constraints import ComplexArray, FloatArray, same_rate
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance
from ultraquiet.spectra.psd import segments
from ultraquiet.values import FrequencyResponse, Record

# Below this share of the strongest line an input counts as silent: far above rounding, far below any converter's floor.
SILENT = 1e-12


@dataclass(frozen=True, eq=False)
class _Columns:
    """What one record tells: gains and coherence `(ny, inputs, nf)`, and where its inputs carry power `(nf,)`."""

    f_hz: FloatArray
    values: ComplexArray
    coherence: FloatArray
    alive: NDArray[np.bool_]
    text: str


def frf(
    records: Record | Sequence[Record],
    segment_samples: int | None = None,
    overlap: float = 0.5,
    window: str = "hann",
) -> FrequencyResponse:
    """Return the H1 estimate G = S_yu S_uu^-1 of the inputs that move, with its coherence.

    Args:
        records: one record; or several of one bench, each exciting its own inputs, set side by side in the result.
        segment_samples: length of a segment; by default an eighth of each record.
        overlap: shared part of neighbouring segments, 0 to 0.95.
        window: any window name of scipy.signal.

    Returns:
        The response `(ny, excited inputs, nf)`. Frequencies at which the inputs carry no power are left out.
        The coherence is the ordinary one where a record excites one input; where it excites several at once it is the
        multiple coherence, repeated for each input. Noise at the outputs does not bias H1; noise on the inputs makes it
        too small.

    Raises:
        InputError: no input moves, an input excited in two records, records of different rates or lengths, fewer
            segments than inputs excited together.

    >>> u = np.random.default_rng(0).standard_normal(4096)
    >>> g = frf(Record([u], [2.0 * u], rate_hz=1000.0))
    >>> bool(np.allclose(g.values, 2.0)), g.estimator[:2]
    (True, 'H1')

    Reference: J. S. Bendat, A. G. Piersol, Random Data (2010), chapters 6 and 7, doi:10.1002/9781118032428.
    """
    many = [records] if isinstance(records, Record) else list(records)
    excited = _excited(many)
    parts = [_columns(r, inputs, segment_samples, overlap, window) for r, inputs in zip(many, excited, strict=True)]
    alive = np.logical_and.reduce([p.alive for p in parts])
    return FrequencyResponse(
        parts[0].f_hz[alive],
        np.concatenate([p.values for p in parts], axis=1)[:, :, alive],
        np.concatenate([p.coherence for p in parts], axis=1)[:, :, alive],
        parts[0].text,
        [r.actuators[i] for r, inputs in zip(many, excited, strict=True) for i in inputs],
        many[0].sensors,
        Provenance("spectra.frf", {"window": window, "overlap": overlap}, parents=tuple(r.hash for r in many)),
    )


def _excited(records: list[Record]) -> list[list[int]]:
    """Return the inputs that move in each record, after checking that the records fit together."""
    if not records:
        raise InputError("frf: it needs at least one record, got none.")
    first, taken, excited = records[0], set[int](), []
    for record in records:
        same_rate("frf", "the first record", first.rate_hz, "another", record.rate_hz)
        if record.samples != first.samples or len(record.sensors) != len(first.sensors):
            raise InputError("frf: all records must have equally many samples and sensors; cut them to one length.")
        moving = [i for i, u in enumerate(record.inputs) if np.ptp(u) > 0]
        if not moving or taken & set(moving):
            raise InputError(
                f"frf: each record must excite inputs of its own, got inputs {[i + 1 for i in moving]} after "
                f"{[i + 1 for i in sorted(taken)]}."
            )
        taken |= set(moving)
        excited.append(moving)
    return excited


def _columns(record: Record, inputs: list[int], segment_samples: int | None, overlap: float, window: str) -> _Columns:
    """Return the columns of the excited inputs."""
    from scipy.signal import csd, welch

    length, shared, averages = segments("frf", record.samples, segment_samples, overlap)
    if averages < len(inputs):
        raise InputError(
            f"frf: {averages} segments cannot separate {len(inputs)} inputs excited together; shorten the segments."
        )
    settings = {"fs": record.rate_hz, "window": window, "nperseg": length, "noverlap": shared}
    u, y = record.inputs[inputs], record.outputs
    f, S_uu = csd(u[:, np.newaxis], u[np.newaxis], **settings)
    S_uu, S_uy = np.asarray(S_uu), np.asarray(csd(u[:, np.newaxis], y[np.newaxis], **settings)[1])
    S_yy = np.asarray(welch(y, **settings)[1])
    weakest = np.linalg.eigvalsh(np.moveaxis(S_uu, -1, 0))[:, 0]
    alive = weakest > SILENT * weakest.max()
    # csd conjugates its first argument: S_uy[l, i] = sum_j S_uu[l, j] G[i, j].
    G = np.zeros((f.size, len(inputs), len(y)), dtype=np.complex128)
    G[alive] = np.linalg.solve(np.moveaxis(S_uu, -1, 0)[alive], np.moveaxis(S_uy, -1, 0)[alive])
    explained = np.abs(np.einsum("fli,lif->if", G, S_uy.conj()))
    coherence = np.clip(np.divide(explained, S_yy, out=np.zeros_like(S_yy), where=S_yy > 0), 0.0, 1.0)
    kind = "coherence" if len(inputs) == 1 else "multiple coherence"
    text = f"H1, {averages} segments of {length} samples, window {window}, overlap {overlap:g}, {kind}"
    shared_by_all = np.broadcast_to(coherence[:, np.newaxis], (len(y), len(inputs), f.size))
    return _Columns(np.asarray(f, dtype=np.float64), np.transpose(G, (2, 1, 0)), shared_by_all, alive, text)
