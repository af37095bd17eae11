"""The packaged study's quiet law: its search, what it reaches on the bench, and on benches drawn afresh.

Designed from records alone: the two models of a study walked before (ULTRAQUIET_DEMO names its folder), else models
identified here. Measured on the bench with hysteresis, noise and limits on; judged on the linear truth of benches that
are drawn within their tolerances.
"""

import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import ultraquiet as uq
from benchmarks.tones import identified
from ultraquiet.pipeline.study import packaged_study
from ultraquiet.simulate.campaigns.evaluation import DRAWN, Campaign, Row

FOLDER = "ULTRAQUIET_DEMO"
LAW, UNITS, BAND_HZ = "quiet", ("ground", "flight"), (10.0, 100.0)
SECONDS, QUIET_DB, PEAK_DB = 20.0, 20.0, 6.0
BENCHES, STABLE, DRAWN_DB, DRAWN_PEAK_DB, WORST_PEAK_DB = 1000, 0.995, 19.5, 6.6, 7.5
SHARE = 5  # per cent of the benches that may fall short
DRIVERS = 3

Printed = tuple[str, str, str, bool]


def plants(seed: int) -> list[uq.StateSpace]:
    """Return the models of both units."""
    if FOLDER in os.environ:
        models = Path(os.environ[FOLDER]) / "models"
        return [uq.files.load(models / name) for name in ("plant.h5", "plant-flight.h5")]
    return [identified(unit, seed) for unit in UNITS]


def measure() -> Iterator[Printed]:
    seed = int(np.random.default_rng().integers(2**30))
    print(f"# seed {seed}", flush=True)
    given = plants(seed)
    method = packaged_study("suite").controllers[LAW].design.make("design")
    started = time.process_time()
    result = method.design(given)
    took = time.process_time() - started
    assert result.controller is not None
    yield "its search", f"{took:.1f} s of processor", f"{SECONDS:g} s", took <= SECONDS
    yield "its search: the verdict", result.status.word, "ok", result.status.ok
    yield from _on_bench(result.controller, seed)
    yield from _on_drawn(result.controller, seed)


def _on_bench(law: uq.StateSpace, seed: int) -> Iterator[Printed]:
    low, high = BAND_HZ
    for unit in UNITS:
        read = uq.simulate.measure_sensitivity(uq.bench.Hexapod(unit=unit, seed=seed), law)
        quiet, peak = read.worst_in_band_db(low, high), read.peak_amplification_db()
        yield f"{unit}, bench: worst direction over {low:g}-{high:g} Hz", f"{quiet:.2f} dB", "20 dB", quiet >= QUIET_DB
        yield f"{unit}, bench: peak", f"{peak:.2f} dB", "6 dB", peak <= PEAK_DB
        yield f"{unit}, bench: lines missing", str(read.lines_missing), "0", read.lines_missing == 0


def _on_drawn(law: uq.StateSpace, seed: int) -> Iterator[Printed]:
    units = tuple((unit, uq.bench.Hexapod(unit=unit, spread=1.0)) for unit in UNITS)
    campaign = Campaign(units, law, BAND_HZ, first_seed=seed)
    yield from of_drawn([campaign.evaluate(case) for case in range(BENCHES)])


def of_drawn(rows: list[Row]) -> Iterator[Printed]:
    """Yield what a law promises of drawn benches, judged on the truth, and print what drives their peaks."""
    stable = [row for row in rows if row["stable"]]
    share = len(stable) / len(rows)
    yield f"{len(rows)} drawn benches: stable", f"{share:.1%}", f"{STABLE:.1%}", share >= STABLE
    yield from shares(f"{len(rows)} drawn benches", rows, DRAWN_DB, DRAWN_PEAK_DB)
    highest = max(stable, key=lambda row: row["peak_db"])
    at = f"{highest['peak_db']:.2f} dB, seed {highest['seed']}"
    yield "all that are stable: peak", at, f"{WORST_PEAK_DB:g} dB", highest["peak_db"] <= WORST_PEAK_DB
    for unit in UNITS:
        print(f"# {unit}: peak driven by {_drivers([row for row in stable if row['unit'] == unit])}", flush=True)


def shares(name: str, rows: list[Row], quiet_db: float, peak_db: float) -> Iterator[Printed]:
    """Yield the attenuation and the peak that all but some per cent of the benches keep."""
    quiet, peak = (np.array([row[key] for row in rows]) for key in ("attenuation_db", "peak_db"))
    least, most = float(np.percentile(quiet, SHARE)), float(np.percentile(peak, 100 - SHARE))
    kept = f"on {100 - SHARE} %"
    yield f"{name}: worst direction, {kept}", f"{least:.2f} dB", f"{quiet_db:g} dB", least >= quiet_db
    yield f"{name}: peak, {kept}", f"{most:.2f} dB", f"{peak_db:g} dB", most <= peak_db


def _drivers(rows: list[Row]) -> str:
    """Return the drawn parameters that go most along with the peak, and how much (their correlation)."""
    peak = np.array([row["peak_db"] for row in rows])
    found: list[tuple[float, str]] = []
    for name in (key for key in rows[0] if key.startswith(DRAWN)):
        values = np.array([row[name] for row in rows])
        if np.ptp(values) > 0:
            found.append((float(np.corrcoef(values, peak)[0, 1]), name.removeprefix(DRAWN)))
    found.sort(key=lambda each: -abs(each[0]))
    return "; ".join(f"{name} ({share:+.2f})" for share, name in found[:DRIVERS])
