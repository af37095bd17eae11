"""Attenuation as the bench reads it against the linear truth: every law of the packaged study, on every unit."""

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import ultraquiet as uq
from ultraquiet import pipeline
from ultraquiet.simulate.open_loop import OpenLoop
from ultraquiet.values.interconnect import feedback

BAND_HZ, APART_DB = (10.0, 100.0), 0.5
# Lines of the truth: closer together than the narrowest mode of a loop is wide.
LINES_HZ = np.unique(np.concatenate([np.arange(0.5, 20.0, 0.005), np.geomspace(20.0, 1745.0, 6000)]))
# A study that was walked before; without it the packaged one is walked first.
FOLDER = "ULTRAQUIET_DEMO"


def laws() -> dict[str, uq.StateSpace]:
    """Return the laws of the packaged study."""
    if FOLDER in os.environ:
        return _kept(Path(os.environ[FOLDER]))
    with tempfile.TemporaryDirectory() as folder:
        suite = Path(pipeline.__file__).parent / "suite.toml"
        pipeline.walk(pipeline.load_study(suite), Path(folder) / "demo", suite.parent, say=print)
        return _kept(Path(folder) / "demo")


def _kept(folder: Path) -> dict[str, uq.StateSpace]:
    paths = sorted((folder / "controllers").glob("*.h5"))
    return {path.stem: uq.files.load(path) for path in paths if "+" not in path.stem}  # beside a law stand its weights


def reduction_db(plant: uq.StateSpace, law: uq.StateSpace, f_hz: np.ndarray) -> np.ndarray:
    """Return the worst direction's reduction, `(nf,)`, of the loop that never is measured."""
    loop = np.einsum("ijf,jkf->fik", plant.frequency_response(f_hz), law.frequency_response(f_hz))
    return -20 * np.log10(np.linalg.norm(np.linalg.inv(np.eye(loop.shape[1]) - loop), 2, axis=(1, 2)))


def measure() -> Iterator[tuple[str, str, str, bool]]:
    designed = laws()
    for unit in ("ground", "flight"):
        seed = int(np.random.default_rng().integers(2**30))
        print(f"# {unit}: seed {seed}", flush=True)
        bench = uq.bench.Hexapod(unit=unit, seed=seed)
        opened, plant = OpenLoop(bench), bench.linear_model()
        for name, law in designed.items():
            watched = uq.simulate.check_stability(bench, law)
            stable = feedback(plant, law).is_stable()
            true = "ok" if stable else "unstable"
            word = str(watched.status.word)
            yield f"{name}, {unit}: verdict", word, f"{true}, or not known", word in (true, "not known")
            if not watched.status.ok:  # the study states no figure of such a loop either
                continue
            yield from _compared(
                f"{name}, {unit}", uq.simulate.measure_sensitivity(bench, law, opened=opened), plant, law
            )


def _compared(
    name: str, read: uq.simulate.MeasuredSensitivity, plant: uq.StateSpace, law: uq.StateSpace
) -> Iterator[tuple[str, str, str, bool]]:
    true = reduction_db(plant, law, LINES_HZ)
    band = (BAND_HZ[0] <= LINES_HZ) & (BAND_HZ[1] >= LINES_HZ)
    pairs = {
        "worst direction over the band": (read.worst_in_band_db(*BAND_HZ), float(true[band].min())),
        "peak": (read.peak_amplification_db(), float(-true.min())),
    }
    for what, (measured, truth) in pairs.items():
        at = f", truth at {LINES_HZ[np.argmin(true)]:.4g} Hz" if what == "peak" else ""
        kept = abs(measured - truth) <= APART_DB
        yield f"{name}: {what}{at}", f"{measured:.2f} dB, true {truth:.2f}", f"within {APART_DB:g} dB", kept
    yield f"{name}: lines missing", str(read.lines_missing), "0", read.lines_missing == 0
