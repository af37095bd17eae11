"""Matrices of many lines: quotients of spectra, inverses, sizes."""

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray


def over(heard: ComplexArray, sent: ComplexArray) -> ComplexArray:
    """Return heard sent^+ at each line, `(ny, nu, lines)`."""
    inverse = inverted(np.moveaxis(sent, 2, 0))
    return np.moveaxis(np.moveaxis(heard, 2, 0) @ inverse, 0, 2).astype(np.complex128)


def inverted(matrices: ComplexArray) -> ComplexArray:
    """Return the inverses, or pseudo-inverses where they are not square, `(lines, columns, rows)`."""
    square = matrices.shape[1] == matrices.shape[2]
    try:
        return (np.linalg.inv(matrices) if square else np.linalg.pinv(matrices)).astype(np.complex128)
    except np.linalg.LinAlgError:  # a line at which nothing is heard
        return np.linalg.pinv(matrices).astype(np.complex128)


def largest(matrices: ComplexArray) -> FloatArray:
    """Return the largest singular values, `(lines,)`, from the smaller of both Gram matrices."""
    turned = np.conj(np.swapaxes(matrices, 1, 2))
    gram = matrices @ turned if matrices.shape[1] < matrices.shape[2] else turned @ matrices
    return np.sqrt(np.maximum(np.linalg.eigvalsh(gram)[:, -1], 0.0))
