"""An hour of six commands and six readings on disk: a Box-Jenkins channel and the 6 x 6 model, in bounded memory.

The record is simulated in blocks into a temporary folder; each identification runs in a process of its own, whose
largest resident size is what the system counted for it, Python and libraries included.
"""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

RATE_HZ, HOUR_S, WIRES, MODES = 3500.0, 3600, 6, 15
BLOCK = 65_536
SNR_DB = 30.0
LIMIT_GB = 2.0
# Time per sample may scatter with the load of the machine, and short records pay for what is done once per pass.
LENGTHS = (10_000, 100_000, 1_000_000, 10_000_000)
CONSTANT_WITHIN = 2.0
STEADY = 500_000  # samples at least that a time is taken over: short records are read again and again
LAGS = 180


class Plant:
    """15 modes, 8-350 Hz, behind six wires each way; readings carry an autoregressive noise of order two."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        f = np.geomspace(8, 350, MODES) * np.exp(0.05 * rng.standard_normal(MODES))
        zeta = rng.uniform(0.005, 0.03, MODES)
        self.poles = np.exp(2 * np.pi * f * (-zeta + 1j * np.sqrt(1 - zeta**2)) / RATE_HZ)
        self.f_hz = f
        size = np.sqrt(1 - np.abs(self.poles) ** 2)
        self.into = rng.standard_normal((MODES, WIRES)) * size[:, None]
        self.out = rng.standard_normal((WIRES, MODES))
        self.state = np.zeros(MODES, dtype=complex)
        self.noise_filter = np.array([1.0, -1.2, 0.5])
        self.noise_state = np.zeros((WIRES, 2))
        self.level = np.linalg.norm(self.out @ np.diag(np.linalg.norm(self.into, axis=1) / size), axis=1) / np.sqrt(2)

    def block(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Inputs, readings and innovations of the next n samples."""
        from scipy.signal import lfilter

        u = self.rng.standard_normal((WIRES, n))
        driven = self.into @ u
        y = np.zeros((WIRES, n))
        for k, p in enumerate(self.poles):
            # The state before the first sample, then one sample late.
            s, _ = lfilter([1.0], [1.0, -p], driven[k].astype(complex), zi=[p * self.state[k]])
            y += np.outer(self.out[:, k], np.concatenate([[self.state[k]], s[:-1]]).real)
            self.state[k] = s[-1]
        e = 10 ** (-SNR_DB / 20) * self.level[:, None] * self.rng.standard_normal((WIRES, n))
        v, self.noise_state = lfilter([1.0], self.noise_filter, e, zi=self.noise_state)
        return u, y + v, e


def channel_truth(rng: np.random.Generator, path: Path, samples: int) -> float:
    """Write a record of the paper's kind (12 and 55 Hz, a pole at 200 Hz, coloured noise); return mean e^2."""
    from scipy.signal import lfilter

    import ultraquiet as uq

    truth = json.loads((Path(__file__).parents[1] / "tests/data/known_truths.json").read_text())["suite_rate"]

    def polynomial(part: dict) -> np.ndarray:
        roots = [np.exp(2 * np.pi * f / RATE_HZ * (-z + 1j * np.sqrt(1 - z * z))) for f, z in part["modes"]]
        reals = [np.exp(-2 * np.pi * f / RATE_HZ) for f in part["reals"]]
        return np.poly([*roots, *np.conj(roots), *reals]).real

    b, f, c, d = (polynomial(truth[k]) for k in "BFCD")
    pulse = np.eye(1, 200_000)[0]
    b = np.r_[0.0, b] / np.linalg.norm(lfilter(np.r_[0.0, b], f, pulse))
    size = 10 ** (-truth["snr_db"] / 20) / np.linalg.norm(lfilter(c, d, pulse))
    zf = np.zeros(max(b.size, f.size) - 1)
    _, zd = lfilter(c, d, size * rng.standard_normal(20_000), zi=np.zeros(d.size - 1))
    power = 0.0
    with uq.files.LongWriter(path, RATE_HZ, 1, 1) as file:
        for at in range(0, samples, BLOCK):
            n = min(BLOCK, samples - at)
            u, e = rng.standard_normal(n), size * rng.standard_normal(n)
            w, zf = lfilter(b, f, u, zi=zf)
            v, zd = lfilter(c, d, e, zi=zd)
            file.append(u, w + v)
            power += float(e @ e)
    return power / samples


def write_hour(rng: np.random.Generator, path: Path, seconds: float) -> Plant:
    """Write the 6 + 6 channels."""
    import ultraquiet as uq

    plant = Plant(rng)
    samples = round(seconds * RATE_HZ)
    with uq.files.LongWriter(path, RATE_HZ, WIRES, WIRES) as file:
        for at in range(0, samples, BLOCK):
            file.append(*plant.block(min(BLOCK, samples - at))[:2])
    return plant


PROBE = """
import json, os, resource, sys, time
for library in ("OPENBLAS", "MKL", "OMP"):
    os.environ[library + "_NUM_THREADS"] = "1"
import numpy as np
import ultraquiet as uq
path, what = sys.argv[1:3]
record = uq.files.LongRecord(path)
begun = time.perf_counter()
if what == "box-jenkins":
    result = uq.identify.BoxJenkins(order=5).identify(record)
    extra = {"passes": result.details["passes"][0]}
else:
    result = uq.identify.Subspace(order=30, refine=True).identify(record)
    poles = result.model.poles()
    extra = {"f_hz": sorted(float(abs(np.log(p)) * record.rate_hz / 2 / np.pi) for p in poles if p.imag > 0),
             "horizon": result.details["horizon"]}
print(json.dumps({
    "seconds": time.perf_counter() - begun,
    "gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9,
    "fit": [float(x) for x in result.fit_percent], "loss": [float(x) for x in result.loss],
    "status": str(result.status), **extra}))
"""


def probe(path: Path, what: str) -> dict:
    """Identify in a process of its own."""
    done = subprocess.run([sys.executable, "-c", PROBE, str(path), what], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr[-2000:])
    return json.loads(done.stdout)


def nanoseconds(folder: Path, rng: np.random.Generator, samples: int) -> tuple[float, float, float]:
    """Return the time per sample of a pass of BJ5, of the products at all lags, and of the modal least squares."""
    import ultraquiet as uq
    from ultraquiet.identify.long_record_statistics import survey
    from ultraquiet.identify.prediction_error.disk import passes
    from ultraquiet.identify.prediction_error.parameterisation import Parameterisation
    from ultraquiet.identify.subspace.disk import long_record_bank
    from ultraquiet.identify.subspace.disk.long_record import ScaledStream
    from ultraquiet.linalg.lagged import Lagged

    method = uq.identify.BoxJenkins(order=5)
    path = folder / "some.h5"
    plant = write_hour(rng, path, samples / RATE_HZ)
    record = uq.files.LongRecord(path)
    single = record.pick(inputs=[0])
    data = passes.Stream(single, 0, survey(single))
    signals = passes.signals_through(method.structure(), 1, (True, True))
    table = Parameterisation.alike(method.structure(), 1).empty()
    table[[2, 4], : plant.noise_filter.size] = plant.noise_filter
    table[3, 0] = 1.0
    stream, sums = ScaledStream(record, survey(record)), Lagged(2 * WIRES, LAGS)

    def modal() -> None:
        long_record_bank.StreamedBank(plant.poles, stream.blocks("bank"), (WIRES, WIRES, record.samples), True, True)

    def lagged() -> None:
        for u, y in stream.blocks("lags"):
            sums.add(np.vstack([u, y]))

    def gram() -> None:
        data.products(table, np.zeros(signals.unknown_past), signals, "pass")

    repeats = max(1, STEADY // samples)
    out = []
    for work in (gram, lagged, modal):
        begun = time.process_time()
        for _ in range(repeats):
            work()
        out.append((time.process_time() - begun) / (repeats * record.samples) * 1e9)
    path.unlink()
    return out[0], out[1], out[2]


def measure() -> Iterator[tuple[str, str, str, bool]]:
    rng = np.random.default_rng()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        samples = int(HOUR_S * RATE_HZ)
        truth = channel_truth(rng, folder / "channel.h5", samples)
        found = probe(folder / "channel.h5", "box-jenkins")
        (folder / "channel.h5").unlink()
        what = f"BJ5 of one channel, {samples / 1e6:.1f} million samples, {found['passes']} passes"
        yield (
            what,
            f"{found['gb']:.2f} GB in {found['seconds']:.0f} s",
            f"under {LIMIT_GB:g} GB",
            found["gb"] < LIMIT_GB,
        )
        excess = found["loss"][0] / truth - 1
        # 20 parameters cost 20 / n of the loss; float32 on disk adds less still.
        yield "its loss above the truth's innovations", f"{excess:.1e}", "under 1e-4", abs(excess) < 1e-4
        plant = write_hour(rng, folder / "hour.h5", HOUR_S)
        mb = (folder / "hour.h5").stat().st_size / 1e6
        found = probe(folder / "hour.h5", "subspace")
        what = f"6 x 6 of order 30 from {mb:.0f} MB, horizon {found['horizon']}"
        yield (
            what,
            f"{found['gb']:.2f} GB in {found['seconds']:.0f} s",
            f"under {LIMIT_GB:g} GB",
            found["gb"] < LIMIT_GB,
        )
        near = [min(abs(np.array(found["f_hz"]) / f - 1), default=1.0) for f in plant.f_hz]
        hits = sum(d < 0.01 for d in near)
        yield "of its modes, within 1 % in frequency", f"{hits} of {MODES}", "all", hits == MODES
        worst = min(found["fit"])
        # Coloured noise at 30 dB leaves about 95 % to any model.
        yield "its simulated fit, worst of six readings", f"{worst:.1f} %", "at least 90 %", worst >= 90.0
        (folder / "hour.h5").unlink()
        nanoseconds(folder, rng, LENGTHS[0])  # compiles
        times = {n: nanoseconds(folder, rng, n) for n in LENGTHS}
    for k, what in enumerate(("pass of BJ5", "products of 12 channels, 180 lags", "modal least squares, order 30")):
        rows = [times[n][k] for n in LENGTHS]
        said = ", ".join(f"{t:.0f}" for t in rows)
        ratio = max(rows) / min(rows)
        yield (
            f"{what}: ns a sample at 1e4, 1e5, 1e6, 1e7: {said}",
            f"{ratio:.2f} times",
            f"within {CONSTANT_WITHIN:g}",
            ratio < CONSTANT_WITHIN,
        )
