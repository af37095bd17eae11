"""Campaigns of drawn benches: against algebra, sealed against kills, the same table whoever runs it."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from drawable import LAW, Drawable

import ultraquiet as uq
from ultraquiet._base.errors import BenchError, InputError
from ultraquiet.analyse import peak_sensitivity
from ultraquiet.bench.from_file import from_file
from ultraquiet.simulate import Campaign, drawn_bench, drawn_parameters, is_of, run_campaign
from ultraquiet.simulate.campaigns import findings
from ultraquiet.simulate.campaigns.ledger import Ledger
from ultraquiet.simulate.campaigns.run import write_table
from ultraquiet.simulate.campaigns.told import told
from ultraquiet.values import Blending, StateSpace
from ultraquiet.values.interconnect import feedback

BAND_HZ = (3.0, 8.0)
HERE = Path(__file__).parent
UNITS = (("one", Drawable()), ("two", Drawable()))


def campaign(**change):
    return Campaign(**{"units": UNITS, "law": LAW, "band_hz": BAND_HZ} | change)


def plain(rows):
    return json.dumps(rows, sort_keys=True)


def test_rows_are_what_algebra_says_and_units_change_nothing():
    found = [campaign().evaluate(case) for case in range(12)]
    for case, row in enumerate(found):
        model = Drawable().drawn(case).linear_model()
        assert row["stable"] == feedback(model, LAW).is_stable()
        assert row["unit"] == UNITS[case % 2][0]
        if row["stable"]:
            assert row["peak_db"] == pytest.approx(max(peak_sensitivity(model, LAW)[0], 0.0), abs=0.02)
    assert {row["stable"] for row in found} == {True, False}  # both kinds are drawn
    for gain in (1e9, 1e-9):
        scaled = Campaign(
            (("one", Drawable(gain=gain)),), StateSpace(LAW.A, LAW.B, LAW.C / gain, LAW.D, 200.0), BAND_HZ
        )
        for case in range(3):
            one, other = Campaign((("one", Drawable()),), LAW, BAND_HZ).evaluate(case), scaled.evaluate(case)
            assert one["stable"] == other["stable"]
            if one["stable"]:
                assert one["attenuation_db"] == pytest.approx(other["attenuation_db"], abs=1e-6)


@pytest.mark.parametrize("band_hz", [(60.0, 120.0), (120.0, 150.0)])
@pytest.mark.parametrize("on", ["truth", "bench"])
def test_a_band_that_ends_beyond_nyquist_is_refused_before_any_case(band_hz, on):
    with pytest.raises(InputError, match="not below Nyquist's 100 Hz; end it lower"):
        campaign(band_hz=band_hz, on=on)


def test_some_of_the_cases_are_measured_besides(tmp_path):
    both = run_campaign(campaign(measured=3), 5, tmp_path / "both.jsonl", workers=1)
    for row in both[3:]:
        assert row == campaign().evaluate(row["case"])
    heard = findings.measured(both)
    assert [row["case"] for row in heard] == [0, 1, 2]
    for row in heard:
        alone = campaign(on="bench").evaluate(row["case"])
        assert row == {name: value for name, value in alone.items() if not name.startswith("drawn: ")}
    assert findings.measured(both[3:]) == []
    with pytest.raises(InputError, match="every case is measured"):
        campaign(on="bench", measured=1)


def test_results_that_were_sealed_stay_and_a_torn_line_is_cut_off(tmp_path):
    whole = plain(run_campaign(campaign(), 9, tmp_path / "a.jsonl", workers=1))
    path = tmp_path / "b.jsonl"
    run_campaign(campaign(), 5, path, workers=1)
    content = path.read_bytes()
    for cut in (1, 7, 40):
        path.write_bytes(content[:-cut])
        rows = run_campaign(campaign(), 9, path, workers=1, resume=True)
        assert plain(rows) == whole
        cases = [json.loads(line.partition(b" ")[2])["case"] for line in path.read_bytes().splitlines()[1:]]
        assert sorted(cases) == list(range(9))
    with pytest.raises(InputError, match="results of another law"):
        run_campaign(campaign(first_seed=1), 9, path, workers=1, resume=True)
    kept = [path.read_bytes()]
    for first_seed in (1, 2, 3):
        run_campaign(campaign(first_seed=first_seed), 2, path, workers=1)
        kept.append(path.read_bytes())
    names = ("b.before.jsonl", "b.before-2.jsonl", "b.before-3.jsonl", "b.jsonl")
    assert [(tmp_path / name).read_bytes() for name in names] == kept


RIG = """
from dataclasses import dataclass

import numpy as np
import ultraquiet as uq

SPREAD = 0.0

DECORATED
class Rig:
    gain: float = 1.0
    rate_hz = 200.0

    def __init__(self, gain=1.0):
        self.gain, self.noise, self.of = gain, np.random.default_rng(1), {"itself": self}

    def drawn(self, seed):
        return Rig(self.gain * (1 + SPREAD * np.random.default_rng(seed).uniform(-1, 1)))

    def linear_model(self):
        return uq.StateSpace([[0.5]], [[self.gain]], [[1.0]], [[0.0]], self.rate_hz)

    actuators = property(lambda self: self.linear_model().actuators)
    sensors = property(lambda self: self.linear_model().sensors)

    def run(self, actuation, disturbance=None, controller=None):
        return uq.bench.LinearBench(self.linear_model()).run(actuation, disturbance, controller)
"""


@pytest.mark.parametrize("decorated", ["", "@dataclass(init=False)"], ids=["a class", "a dataclass"])
@pytest.mark.parametrize("around", [False, True], ids=["itself", "blended"])
def test_a_bench_is_known_again_until_its_file_changes(decorated, around, tmp_path):
    file, path, law = tmp_path / "rig.py", tmp_path / "results.jsonl", uq.values.interconnect.gain([[-0.2]], 200.0)
    file.write_text(RIG.replace("DECORATED", decorated))

    def made(gain=1.0):
        bench = from_file("rig.py:Rig", tmp_path, {"gain": gain})
        if around:
            bench = uq.bench.Blended(bench, Blending([[2.0]], [[1.0]], bench.sensors, bench.actuators))
        return Campaign((("one", bench),), law, BAND_HZ)

    rows = run_campaign(made(), 3, path, workers=1)
    assert is_of(made(), path)
    assert plain(run_campaign(made(), 3, path, workers=1, resume=True)) == plain(rows)
    assert not is_of(made(2.0), path)
    file.write_text(file.read_text().replace("SPREAD = 0.0", "SPREAD = 0.75"))
    assert not is_of(made(), path)
    with pytest.raises(InputError, match="results of another law, bench"):
        run_campaign(made(), 3, path, workers=1, resume=True)
    fresh = run_campaign(made(), 3, path, workers=1)
    assert len({row["attenuation_db"] for row in rows}) == 1
    assert len({row["attenuation_db"] for row in fresh}) == 3


def test_what_a_study_says_of_its_bench_stands_for_what_the_bench_holds():
    """A bench that has run holds other numbers than a fresh one; a study knows that both are one."""

    class Counting(Drawable):
        runs = 0

    fresh, used = Counting(), Counting()
    object.__setattr__(used, "gain", 2.0)
    one, other = (campaign(units=(("one", bench),), bench_key={"object": "a.py"}) for bench in (fresh, used))
    assert one.digest == other.digest
    assert one.digest != replace(other, bench_key={"object": "b.py"}).digest
    assert replace(one, bench_key=None).digest != replace(other, bench_key=None).digest


def test_functions_are_told_by_what_they_do_and_what_they_hold():
    def scaled(gain):
        return lambda u: gain * u

    assert told(scaled(2.0)) == told(scaled(2.0)) != told(scaled(3.0))
    written = [eval(text, {"__name__": "here"}) for text in ("lambda u: 2 * u", "lambda u: 2 * u", "lambda u: 3 * u")]
    assert told(written[0]) == told(written[1]) != told(written[2])
    assert told(partial(np.clip, 1.0, 2.0)) == told(partial(np.clip, 1.0, 2.0)) != told(partial(np.clip, 1.0, 3.0))
    assert told(Drawable().drawn) == told(Drawable().drawn) != told(Drawable(gain=2.0).drawn)
    assert "0x" not in json.dumps(told([scaled, Drawable(), np.random.default_rng(1), {1, 2}, json, len]))


def test_a_line_that_was_edited_is_evaluated_again(tmp_path):
    path = tmp_path / "c.jsonl"
    whole = plain(run_campaign(campaign(), 6, path, workers=1))
    path.write_bytes(path.read_bytes().replace(b'"case": 3', b'"case": 4'))
    assert plain(run_campaign(campaign(), 6, path, workers=1, resume=True)) == whole
    with Ledger(path, campaign().digest, resume=True) as sealed:
        before = path.stat().st_size
        sealed.add(sealed.rows[2])
        assert path.stat().st_size == before  # nothing is doubled


def test_what_drives_a_figure_is_found_and_failures_are_named():
    rows = [campaign().evaluate(case) for case in range(60)]
    strong = findings.drivers(rows, "peak_db")
    print(strong)
    assert strong[0].parameter == "drawn: mass"
    assert strong[0].correlation < -0.5  # light ones peak
    failed = [row for row in rows if not row["stable"]]
    named = findings.causes(rows, failed, "peak_db")
    assert {cause.parameter for cause in named} == {"drawn: mass"}
    worst = findings.worst_cases(rows, 4)
    assert not worst[0]["stable"]
    assert findings.spread(rows, "peak_db")["100%"] == np.inf
    noise = [{**row, "drawn: idle": float(k * 7919 % 61)} for k, row in enumerate(rows)]
    assert "drawn: idle" not in {driver.parameter for driver in findings.drivers(noise, "peak_db")}


def test_a_bench_that_fails_costs_its_case_and_no_other():
    class Loose(Drawable):
        def drawn(self, seed):
            def pulled(u, d):
                raise BenchError("Rig: the cable was pulled.")

            return uq.bench.Wrapped(pulled, lambda: None, 200.0, ["coil"], ["gap"])

    row = campaign(units=(("loose", Loose()),), on="bench").evaluate(0)
    assert not row["stable"]
    assert row["status"] == "not measured: Rig: the cable was pulled."


def test_the_table_is_read_back_by_others(tmp_path):
    import pandas as pd

    rows = run_campaign(campaign(), 4, tmp_path / "d.jsonl", workers=1)
    read = pd.read_parquet(write_table(rows, tmp_path / "campaign.parquet"))
    assert read["case"].tolist() == [0, 1, 2, 3]
    assert read["drawn: mass"].tolist() == [row["drawn: mass"] for row in rows]


def test_what_cannot_be_drawn_or_judged_is_said():
    pair = uq.bench.Wrapped(lambda u, d: [0.0], lambda: None, 100.0, ["a"], ["b"])
    with pytest.raises(InputError, match=r"give it a method 'drawn\(seed\)'"):
        drawn_bench(pair, 1)
    with pytest.raises(InputError, match='take on = "bench"'):
        campaign(units=(("pair", pair),))
    with pytest.raises(InputError, match="at least one bench"):
        campaign(units=())
    with pytest.raises(InputError, match="'band_hz' ends at 100 Hz, not below Nyquist's 100 Hz"):
        campaign(band_hz=(50.0, 100.0))
    with pytest.raises(InputError, match="'on' must be"):
        campaign(on="paper")


def test_the_hexapod_is_drawn_and_says_what_was_drawn():
    one, two = (drawn_bench(uq.bench.Hexapod(unit="flight", hysteresis=True), seed) for seed in (1, 2))
    assert one.hysteresis
    assert one.unit == "flight"
    assert drawn_parameters(one) != drawn_parameters(two)
    assert {"payload mass_kg", "stage_stiffness_n_per_m, mean"} <= set(drawn_parameters(one))
    assert drawn_bench(uq.bench.Hexapod(spread=0.5), 3).spread == 0.5


@dataclass(frozen=True)
class Slow(Campaign):
    """A campaign whose cases take a while, so that a kill strikes among them."""

    def evaluate(self, case):
        time.sleep(0.05)
        return super().evaluate(case)


SCRIPT = f"""
import sys; sys.path.insert(0, {str(HERE)!r})
from pathlib import Path
from test_drawn_benches import Slow, UNITS, LAW, BAND_HZ
from ultraquiet.simulate import run_campaign
run_campaign(Slow(UNITS, LAW, BAND_HZ), 40, Path(sys.argv[1]), workers=int(sys.argv[2]), resume=True)
"""


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("workers", [1, 2])
def test_a_campaign_that_is_killed_again_and_again_comes_to_the_same_table(tmp_path, workers):
    wanted = plain(run_campaign(campaign(), 40, tmp_path / "whole.jsonl", workers=1))
    path, kills = tmp_path / "killed.jsonl", 0
    rng = np.random.default_rng(1)
    for _ in range(6):
        words = [sys.executable, "-c", SCRIPT, str(path), str(workers)]
        with subprocess.Popen(words, env={**os.environ, "PYTHONWARNINGS": "ignore"}, start_new_session=True) as process:
            try:
                process.wait(timeout=float(rng.uniform(2.0, 6.0)))
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)  # the session that this test started, and no other
                kills += 1
    rows = run_campaign(campaign(), 40, path, workers=1, resume=True) if path.exists() else []
    print(f"{workers} workers: {kills} kills")
    assert plain(rows) == wanted
    lines = [json.loads(line.partition(b" ")[2]) for line in path.read_bytes().splitlines()[1:]]
    assert sorted(line["case"] for line in lines) == list(range(40))


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_cores_and_a_dask_cluster_give_the_same_table(tmp_path):
    tables = {
        how: plain(run_campaign(campaign(), 30, tmp_path / f"{how}.jsonl", workers=2 if how else 1, cluster=cluster))
        for how, cluster in (("", None), ("cores", None), ("dask", "local"))
    }
    assert tables[""] == tables["cores"] == tables["dask"]
