"""What is emitted for a law of given blocks is the same text whichever kernels the BLAS takes, self-tests included."""

import json
import os
import subprocess
import sys
from fractions import Fraction

import numpy as np
import pytest
from deploy_laws import random_law

from kernel_families import FAMILIES, flags
from ultraquiet.deploy.fixed_point.exact import least_squares

SHAPES = (
    (12, 3, 2, 1.0),
    (7, 1, 4, 1.0),
    (2, 1, 2, 8.0),
    (6, 3, 3, 16.0),
    (6, 2, 4, 64.0),
)  # states, inputs, outputs, gain
# Every NumPy that sorts by vectors of its own may order equal numbers otherwise.
PLAIN_SORT = "AVX512F AVX512CD AVX512_SKX AVX2 FMA3"
CHILD = """
import hashlib, json, sys, tempfile
from pathlib import Path
import numpy as np
from ultraquiet._base.errors import UltraquietError
from ultraquiet.deploy import generate, generate_fixed
from ultraquiet.deploy.fixed_point import reach
from ultraquiet.values import StateSpace

found, tried, real = {}, [], reach._others_at_rest
reach._others_at_rest = lambda *a: tried.append(real(*a)) or tried[-1]
with np.load(sys.argv[1]) as kept:
    for k in range(len(kept) // 4):
        law = StateSpace(*(kept[f"{k}{name}"] for name in "ABCD"), rate_hz=3500.0)
        for word in ("q31", "q15", "float32"):
            folder = Path(tempfile.mkdtemp()) / "code"
            try:
                if word == "float32":
                    generate(law, folder, limits_v=10.0, targets=("c99", "c31"), form="modal")
                else:
                    generate_fixed(
                        law, folder, word, form="modal", tolerance=1.0, ramp_s=0.01, input_v=10.0, output_v=25.0
                    )
            except UltraquietError as refusal:
                found[f"{k} {word}"] = type(refusal).__name__
            for path in folder.glob("*"):
                if path.name != "manifest.json":  # holds errors of the law with all their digits
                    found[f"{k} {word} {path.name}"] = hashlib.sha256(path.read_bytes()).hexdigest()
print(json.dumps([found, sum(one is not None for one in tried)]))
"""


@pytest.mark.slow
def test_the_same_text_with_every_family_of_kernels(rng, tmp_path):
    laws = {}
    for k, (states, inputs, outputs, loud) in enumerate(SHAPES):
        law = random_law(rng, states, inputs, outputs, mixed=False)
        for name, gain in (("A", 1.0), ("B", 1.0), ("C", loud), ("D", loud)):
            laws[f"{k}{name}"] = gain * getattr(law, name)
    np.savez(tmp_path / "laws.npz", **laws)
    texts, known = {}, flags()
    runs = {family: {"OPENBLAS_CORETYPE": family} for family, needed in FAMILIES.items() if needed <= known}
    runs["no vectors of NumPy's"] = {"NPY_DISABLE_CPU_FEATURES": PLAIN_SORT}
    for name, settings in runs.items():
        command = [
            sys.executable,
            "-W",
            "error",
            "-W",
            "ignore::ImportWarning",
            "-c",
            CHILD,
            str(tmp_path / "laws.npz"),
        ]
        environment = {**os.environ, **settings}
        told = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert told.returncode == 0, told.stderr
        texts[name], solved = json.loads(told.stdout)
        print(f"{name}: {len(texts[name])} texts, {solved} times words by least squares")
        assert solved
    first = next(iter(texts.values()))
    for name, others in texts.items():
        assert [key for key in first if others.get(key) != first[key]] == [], name


def test_least_squares_are_exact_and_the_least(rng):
    for rows, columns in ((1, 4), (3, 7), (4, 4), (5, 2)):
        R = rng.integers(-(2**31), 2**31, (rows, columns))
        R[-1] = R[0]  # from two rows on never of full rank
        t, powers = rng.integers(-(2**62), 2**62, rows), rng.integers(0, 9, rows)
        x = least_squares(R, t.tolist(), powers.tolist())
        weight = [4 ** int(p) for p in powers]
        off = [int(t[i]) - sum(int(R[i, j]) * x[j] for j in range(columns)) for i in range(rows)]
        assert all(
            sum(w * o * int(r) for w, o, r in zip(weight, off, R[:, j], strict=True)) == 0 for j in range(columns)
        )
        scale = np.exp2(powers)
        expected = np.linalg.lstsq(R * scale[:, None], t * scale, rcond=1e-10)[0]
        np.testing.assert_allclose([float(one) for one in x], expected, rtol=1e-6, atol=1e-6 * abs(expected).max())
        assert isinstance(x[0], Fraction)
