"""Forms and word lengths: what a bank saves, what float32, Q31 and Q15 lose in the loop, whether anything overflows."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import ultraquiet as uq
from ultraquiet.deploy.fixed_point.deployment import measurements
from ultraquiet.deploy.toolchain.targets import missing_program
from ultraquiet.deploy.verification.bench_tones import on_bench

LOSS_DB = 0.5
STEPS = 20_000
TONES_HZ = (5.0, 25.0, 100.0)

Promise = tuple[str, str, str, bool]


def measure() -> Iterator[Promise]:
    plant = uq.bench.Hexapod(unit="ground").linear_model()
    laws = {
        "repeated": uq.design.BandAttenuation(band_hz=(9.0, 108.0), structure="repeated").design(plant).controller,
        "LQG": uq.design.Lqg(band_hz=(9.0, 108.0), control_weight=1e-8).design(plant).controller,
    }
    with tempfile.TemporaryDirectory() as work:
        yield from bank(laws["repeated"], plant, Path(work))
        for name, law in laws.items():
            yield from table(name, law, plant)
            yield from whole_numbers(name, law, plant, Path(work) / name)


def bank(law: uq.StateSpace, plant: uq.StateSpace, work: Path) -> Iterator[Promise]:
    """A law of six alike channels as a bank, beside what it was without."""
    made = uq.deploy.generate(law, work / "bank", plant=plant, name="bank")
    full = uq.deploy.generate(law, work / "modal", plant=plant, name="modal", form="modal")
    cycles = [m.tables["c31_kernel_cycles"] for m in (made, full)]
    said = f"{cycles[0]} cycles ({law.states} states)"
    yield "six alike channels as a bank, C31 kernel", said, "< 900", made.law.form == "bank" and cycles[0] < 900
    yield "  against modal form", f"{cycles[0] / cycles[1]:.2f}", "< 0.5", cycles[0] < 0.5 * cycles[1]
    if missing_program() is None:
        steps = []
        for each in (made, full):
            found = each.verify(steps=2000)
            assert found.ok, found.status
            assert found.cortex_m7 is not None
            steps.append(found.cortex_m7.step)
        ratio = steps[0] / steps[1]
        yield "  Cortex-M7 instructions against modal", f"{steps[0]} of {steps[1]} ({ratio:.2f})", "< 0.6", ratio < 0.6


def table(name: str, law: uq.StateSpace, plant: uq.StateSpace) -> Iterator[Promise]:
    """The word-length table: the best form of each precision, in the loop."""
    rows = uq.deploy.word_lengths(law, plant)
    best = {p: next(r for r in rows if r.precision == p) for p in ("float64", "float32", "q31", "q15")}
    for precision, row in best.items():
        what = f"{name} in {precision}, {row.form}: loop louder by at most"
        loss = np.inf if row.degradation_db is None else row.degradation_db
        if precision == "q15":
            # Nothing is promised of sixteen bits but that the table says what they cost.
            kept = not row.status.ok or loss < LOSS_DB
            yield what, f"{loss:.3g} dB, {row.status.word}", "said, not hidden", kept
        else:
            yield what, f"{loss:.1e} dB", f"< {LOSS_DB} dB", row.status.ok and loss < LOSS_DB


def whole_numbers(name: str, law: uq.StateSpace, plant: uq.StateSpace, folder: Path) -> Iterator[Promise]:
    """Q31 on the bench through its compiled code, and its bound under the largest measurements."""
    made = uq.deploy.generate_fixed(law, folder, "q31", plant=plant)
    found = made.verify(steps=STEPS)
    yield f"{name} in Q31: words of C and twin", f"equal over {STEPS} steps", "all", found.bit_exact is True
    twin = uq.deploy.FixedTwin(made.law)
    twin.reset()
    largest, top = 0, 2 ** (made.law.bits - 1) - 1
    for y in measurements(made.law, STEPS, 0).T:
        twin.output(y)
        twin.update()
        largest = max(largest, int(np.abs(twin.x).max()))
    said = f"{largest / top:.3f} seen, {made.law.peak:.4f} proven"
    yield f"{name} in Q31: states, of full scale", said, "<= 1", largest / top <= made.law.peak <= 1.0
    there = on_bench(lambda: uq.bench.Hexapod(unit="ground", seed=0), law, made.controller, TONES_HZ)
    loss = float(there.loss_db.max())
    tones = " ".join(f"{db:.1f}" for db in there.worst_code_db)
    yield f"{name} in Q31 on the bench: dB lost", f"{loss:.3f} ({tones} dB)", f"< {LOSS_DB}", loss < LOSS_DB
