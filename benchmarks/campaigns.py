"""The packaged study's quiet law on drawn benches: a thousand on the truth, a hundred measured, others tuned in place.

Half of the benches are of each unit, spread 1. Measured ones have hysteresis, noise and limits on. Tuned in place: each
bench is recorded, identified, and gets a law of its own, every strut another, that begins with the general one; all are
judged on the truth, some measured. Minutes are those of the clock, on the cores of this machine. ULTRAQUIET_DEMO names
the folder of a study walked before.
"""

import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import ultraquiet as uq
from benchmarks.law_levels import law as quiet_law
from benchmarks.quiet_law import BAND_HZ, BENCHES, LAW, UNITS, of_drawn, shares
from ultraquiet.identify import Rational
from ultraquiet.pipeline.study import packaged_study
from ultraquiet.simulate.campaigns import findings
from ultraquiet.simulate.campaigns.evaluation import Campaign, Row, Tuning
from ultraquiet.simulate.campaigns.run import run_campaign

MEASURED, IN_PLACE, IN_PLACE_MEASURED = 100, 200, 20
# what a record leaves open of its own unit, in place of what tolerances do
OWN = {"draws": 0, "gain_spread": 0.03, "mode_spread": 0.01, "structure": "decentralised"}
# likewise of its peak, over Hz: what a record with hysteresis in it has wrong of its unit comes on top, most above 400
OWN_PEAK_DB = (
    [4.0, 5.5, 8.5, 11.0, 180.0, 230.0, 330.0, 420.0, 550.0],
    [5.2, 3.0, 1.5, 5.3, 5.3, 5.42, 5.42, 4.92, 4.9],
)

Printed = tuple[str, str, str, bool]


def measure() -> Iterator[Printed]:
    seed = int(np.random.default_rng().integers(2**30))
    print(f"# seed {seed}", flush=True)
    design = packaged_study("suite").controllers[LAW].design.make("design")
    law = quiet_law(seed)
    yield from _general(law, seed)
    yield from _in_place(design, law, seed)


def _drawn(campaign: Campaign, cases: int) -> list[Row]:
    with tempfile.TemporaryDirectory() as folder:
        return run_campaign(campaign, cases, Path(folder) / "results")


def _units() -> tuple[tuple[str, uq.bench.Hexapod], ...]:
    return tuple((unit, uq.bench.Hexapod(unit=unit, hysteresis=True, spread=1.0)) for unit in UNITS)


def _general(law: uq.StateSpace, seed: int) -> Iterator[Printed]:
    began = time.monotonic()
    true = _drawn(Campaign(_units(), law, BAND_HZ, first_seed=seed), BENCHES)
    heard = _drawn(Campaign(_units(), law, BAND_HZ, on="bench", first_seed=seed), MEASURED)
    minutes = (time.monotonic() - began) / 60
    yield f"{BENCHES} on the truth, {MEASURED} measured", f"{minutes:.1f} min", "15 min", minutes <= 15.0
    yield from of_drawn(true)
    yield from shares(f"{MEASURED} measured", heard, 19.0, 7.0)


def _in_place(design, law: uq.StateSpace, seed: int) -> Iterator[Printed]:
    own = replace(design, **OWN, peak_db=OWN_PEAK_DB)
    tuning = Tuning(own, Rational(zeros_at_dc=1))
    began = time.monotonic()
    campaign = Campaign(_units(), law, BAND_HZ, first_seed=seed, tuning=tuning, measured=IN_PLACE_MEASURED)
    true = _drawn(campaign, IN_PLACE)
    heard = findings.measured(true)
    minutes = (time.monotonic() - began) / 60
    yield f"{IN_PLACE} tuned in place, {IN_PLACE_MEASURED} measured", f"{minutes:.1f} min", "20 min", minutes <= 20.0
    kept = sum(row["tuned"].startswith("ok") for row in true)
    yield f"{IN_PLACE} tuned in place: ok", f"{kept} of {IN_PLACE}", f"{IN_PLACE} of {IN_PLACE}", kept == IN_PLACE
    for rows, name in (
        (true, f"{IN_PLACE} in place, on the truth"),
        (heard, f"{IN_PLACE_MEASURED} in place, measured"),
    ):
        least, most = min(row["attenuation_db"] for row in rows), max(row["peak_db"] for row in rows)
        yield f"{name}: least attenuation", f"{least:.2f} dB", "21 dB", least >= 21.0
        yield f"{name}: largest peak", f"{most:.2f} dB", "6 dB", most <= 6.0
