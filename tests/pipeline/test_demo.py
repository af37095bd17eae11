"""The embedded study, once through in its quick form: what it leaves and what it reaches."""

import json
import re
import shutil
from pathlib import Path

import jsonschema
import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet.pipeline import reload_study, walk
from ultraquiet.values import StatusWord

SCHEMA = Path(__file__).parents[2] / "docs" / "summary.schema.json"
FIRST_TARGET_DB, LARGEST_PEAK_DB = 12.0, 8.0


def test_it_leaves_what_the_contract_says(demo):
    folder, summary, _ = demo
    for name in ("summary.json", "report.html", "records", "models", "controllers", "code"):
        assert (folder / name).exists(), name
    assert {"identification", "design", "closed_loop", "deployment", "limits", "versions", "seed"} <= set(summary)
    jsonschema.validate(summary, json.loads(SCHEMA.read_text()))
    for facts in summary["closed_loop"].values():
        ground = facts["ground"]
        keys = {"broadband_5_100_db", "broadband_10_60_db", "peak_amplification_db"}
        assert keys <= set(ground)
        assert {"reduction_db", "paper_db"} <= set(ground["tones"]["25"])
    for tables in summary["deployment"].values():
        keys = {"states", "form", "c31_cycles", "c31_budget", "cortex_m7_instructions", "flash_bytes", "ram_bytes"}
        assert keys | {"bit_exact"} <= set(tables)


# Of 11 demos one bound, on a grid that is coarse for the sake of time, was not certified.
@pytest.mark.draws(false_alarm=0.1)
def test_no_design_is_beyond_its_limit(demo):
    folder, summary, _ = demo
    limits = summary["limits"]
    page = (folder / "report.html").read_text()
    for told in limits["bands"]:
        print(f"{told['band_hz']}: {told['status']}")
        assert 0 < told["attenuation_db"] <= told["bound_db"]
        assert f"{told['bound_db']:.1f} dB cannot be exceeded" in page
    assert set(limits["designs"]) == set(summary["closed_loop"])
    for name, told in limits["designs"].items():
        print(f"{name}: {told['attenuation_db']:.2f} dB; {told['status']}")
        assert told["left_db"] is None or told["left_db"] > -0.02, name
        assert (told["left_db"] is None) == told["status"].startswith("not certified"), name


def test_every_controller_settles_on_the_bench_and_claims_what_it_achieves(demo):
    folder, summary, _ = demo
    for name, facts in summary["closed_loop"].items():
        design = summary["design"][name]
        print(f"{name}: gamma {design['gamma']:.6g}, achieved {design['achieved']:.6g}; {facts['ground']['status']}")
        assert facts["ground"]["stable"], name
        assert design["achieved"] == pytest.approx(design["gamma"], rel=1e-3), name
        law = uq.files.load(folder / "controllers" / f"{name}.h5")
        assert law.rate_hz == 3500.0


@pytest.mark.slow
def test_every_controller_flown_unchanged_is_judged_as_the_flight_unit_s_own_model_has_it(demo):
    """The flight unit is in the whole study; the quick one leaves it out, its controllers are tried here.

    Only what grows or decays by less than an e-fold in ten records may be left open.
    """
    folder, summary, _ = demo
    flight = uq.bench.Hexapod(unit="flight", seed=summary["seed"])
    for name in summary["closed_loop"]:
        law = uq.files.load(folder / "controllers" / f"{name}.h5")
        verdict = uq.simulate.check_stability(flight, law, model=flight.linear_model())
        print(f"{name} in flight: {verdict.status}")
        if verdict.status.word is StatusWord.NOT_KNOWN:
            assert abs(verdict.model_growth_per_s) < 1 / (10 * verdict.duration_s), name
        else:
            assert verdict.status.ok == (verdict.model_growth_per_s < 0), name


def test_the_report_says_what_each_reaches_at_each_tone(demo):
    folder, summary, _ = demo
    page = (folder / "report.html").read_text()
    for facts in summary["closed_loop"].values():
        assert set(facts["ground"]["tones"]) == {"5", "25", "100"}
        for tone in facts["ground"]["tones"].values():
            for key in ("reduction_db", "paper_db"):
                assert f"<td>{round(tone[key], 1) + 0.0:.1f}</td>" in page  # no -0.0


def test_one_controller_quietens_every_direction(demo):
    """At least 12 dB in the worst direction over the whole of 10-100 Hz with at most 8 dB of peak, on the bench."""
    folder, summary, _ = demo
    reached = {
        n: (f["ground"]["worst_direction_band_db"], f["ground"]["peak_amplification_db"])
        for n, f in summary["closed_loop"].items()
    }
    for name, (worst, peak) in reached.items():
        print(f"{name}: worst direction {worst:.1f} dB over 10-100 Hz, peak amplification {peak:.1f} dB")
    good = [n for n, (worst, peak) in reached.items() if worst >= FIRST_TARGET_DB and peak <= LARGEST_PEAK_DB]
    assert good
    # The same from the bench's own linear model, which hides nothing below the lines that noise leaves.
    truth = uq.bench.Hexapod(unit="ground").linear_model()
    f = np.concatenate([np.arange(0.25, 130, 0.25), np.geomspace(130, 1749, 1500)])
    for name in good:
        law = uq.files.load(folder / "controllers" / f"{name}.h5")
        GK = np.einsum("ijf,jkf->fik", truth.frequency_response(f), law.frequency_response(f))
        size = 20 * np.log10(np.linalg.norm(np.linalg.inv(np.eye(6) - GK), 2, axis=(1, 2)))
        worst, peak = -size[(f >= 10) & (f <= 100)].max(), size.max()
        print(f"{name}, bench's linear model: worst direction {worst:.1f} dB, peak {peak:.1f} dB")
        assert worst >= FIRST_TARGET_DB
        assert peak <= LARGEST_PEAK_DB


def test_the_report_shows_each_model_s_error_against_the_bench(demo):
    """The promise itself, over all orders from 2 to 8, is held by `identify/test_on_the_bench.py` and `make bench`."""
    folder, summary, _ = demo
    against = summary["identification"]["against_bench"]
    page = (folder / "report.html").read_text()
    for name, facts in against.items():
        print(f"{name}: off by {facts['diagonal_gain_db']:.2f} dB, {facts['diagonal_phase_deg']:.1f} degrees")
        assert facts["band_hz"] == [20.0, 200.0]
        assert f"<td>{facts['diagonal_gain_db']:.2f}</td>" in page
    assert {"preferred", "paper-chirp", "plant"} <= set(against)
    assert against["plant"]["diagonal_gain_db"] <= 1.0
    assert against["plant"]["diagonal_phase_deg"] <= 10.0


def test_code_repeats_python_bit_by_bit_where_there_is_a_compiler(demo):
    _, summary, _ = demo
    for name, tables in summary["deployment"].items():
        print(f"{name}: {tables['c31_cycles']} of {tables['c31_budget']} C31 cycles; {tables['verification']}")
        assert tables["bit_exact"] in (True, None)
        assert tables["c31_budget"] == 2800
        # Reduced laws fit in whatever form their poles leave; the as-printed one keeps the plant's order and may not.
        if "reduction" in summary["design"][name]:
            assert tables["c31_cycles"] <= tables["c31_budget"]


@pytest.mark.slow
def test_the_weights_as_printed_ask_for_nothing(demo):
    _, summary, _ = demo
    assert summary["design"]["hinf-as-printed"]["achieved"] < 1.1e-5
    tones = summary["closed_loop"]["hinf-as-printed"]["ground"]["tones"]
    assert max(abs(t["reduction_db"]) for t in tones.values()) < 1.0


def test_the_report_stands_alone(demo):
    folder, _, _ = demo
    page = (folder / "report.html").read_text()
    print(f"report: {len(page) / 1e6:.1f} MB, {page.count('<figure')} figures, {page.count('<table')} tables")
    fetched = re.findall(r'(?:src|href)\s*=\s*"(?!#)([^"]*)"|@import|url\((?!#)([^)]*)\)', page)
    assert not [f for f in fetched if any(f) and not f[0].startswith("data:")], "only what the page holds"
    for figure in ("test_signals", "responses", "step", "tone", "bode", "singular_values", "sensitivity", "response"):
        assert f'id="{figure}"' in page, figure


def test_records_and_models_reopen(demo):
    folder, _, _ = demo
    assert uq.files.load(folder / "records" / "chirp-1.h5").samples == 4096
    assert uq.files.load(folder / "models" / "paper-chirp.h5").rate_hz == 3500.0
    assert uq.files.load(folder / "models" / "plant.h5").is_stable()


def test_finished_stages_are_reused(demo):
    folder, summary, _ = demo
    before = {
        p: p.stat().st_mtime_ns for room in ("models", "controllers", "stages") for p in (folder / room).iterdir()
    }
    walk(reload_study(folder), folder, say=lambda _: None)
    assert {p: p.stat().st_mtime_ns for p in before} == before
    assert json.loads((folder / "summary.json").read_text()) == summary


@pytest.mark.slow
def test_a_changed_design_leaves_the_rest_alone(demo, tmp_path):
    folder = shutil.copytree(demo[0], tmp_path / "demo")  # copies keep the times of files
    study = reload_study(folder)
    kept = (folder / "stages" / "identify.json").stat().st_mtime_ns
    one = {"hinf-as-printed": study.controllers["hinf-as-printed"]}
    summary = walk(study.model_copy(update={"controllers": one}), folder, say=lambda _: None)
    assert list(summary.design) == ["hinf-as-printed"]
    assert (folder / "stages" / "identify.json").stat().st_mtime_ns == kept
