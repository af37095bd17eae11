"""Sentences of a report that weigh its numbers: what looks bad is said, and said of what it is."""

from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from ultraquiet.pipeline.facts.limits import DesignLimit, LimitFacts, RefusedBand
from ultraquiet.pipeline.facts.mission import CampaignCurves, CampaignFacts, WorstCase
from ultraquiet.pipeline.facts.models import PlantFacts, PreferredModels, RankedModel, RecordFit, ResidualFacts
from ultraquiet.pipeline.facts.requirements import RequirementFacts, RequirementsFacts
from ultraquiet.pipeline.facts.typed import from_plain, to_plain
from ultraquiet.pipeline.identification import plant
from ultraquiet.pipeline.report.front import _law_in_short, _verdict
from ultraquiet.pipeline.report.limits import limits
from ultraquiet.pipeline.report.mission import campaign
from ultraquiet.pipeline.report.models import _about_zeros, _by_order, _doubted, _of_residuals, _simulating_better
from ultraquiet.pipeline.report.records import _coherence
from ultraquiet.pipeline.study import Plant
from ultraquiet.values import Channel, Record, StateSpace

RATE_HZ, BAND_HZ = 100.0, (5.0, 20.0)


def judged(where, met, requirement="peak_db"):
    return RequirementFacts(requirement=requirement, where=where, asked=6.0, figure=5.0, met=met, sentence="")


@pytest.mark.parametrize(("on_flight", "said"), [(True, "2 of 2 requirements met"), (False, "1 of 2 requirements met")])
def test_the_first_page_counts_the_lines_of_its_table(on_flight, said):
    every = (judged("ground", True), judged("flight", on_flight), judged("input", True, "disk_margin"))
    verdict = _verdict(RequirementsFacts(law="quiet", band_hz=BAND_HZ, judged=every))
    assert verdict.aside == said
    assert verdict.word == ("ok" if on_flight else "not ok")


@pytest.mark.parametrize(
    ("name", "said"), [("lqg", "lqg: one law, 4 states."), ("quiet", "quiet: one law, lqg, 4 states.")]
)
def test_the_first_page_names_a_method_once(name, said):
    facts = SimpleNamespace(method="lqg", states=4)
    result = SimpleNamespace(designs={name: SimpleNamespace(facts=facts)}, deployment={}, loops={})
    assert _law_in_short(result, name) == said


@pytest.mark.parametrize(
    ("white", "free", "said"),
    [(0.4, 0.3, "leaves nothing"), (1e-5, 0.3, "leaves noise of a colour unexplained"), (0.4, 0.0, "leaves motion")],
)
def test_what_a_test_of_residuals_means_is_said(white, free, said):
    text = _of_residuals(ResidualFacts(whiteness_p_median=white, correlation_p_median=free))
    assert said in text
    assert "p-value 0 " not in text


@pytest.mark.parametrize(("tone_hz", "outside"), [(2.0, 100), (10.0, 0), (40.0, 100)])
def test_of_a_bad_fit_it_is_said_how_much_of_it_is_none_of_the_bands(tone_hz, outside):
    t = np.arange(1000) / RATE_HZ
    read = np.sin(2 * np.pi * 3 * t)
    record = Record(read[None], read[None], RATE_HZ)
    said = read + 2 * np.sin(2 * np.pi * tone_hz * t)
    simulated = Record(read[None], np.array([said, read]), RATE_HZ, sensors=[Channel("poor"), Channel("good")])
    fit = RecordFit(channel=0, fit_percent={"poor": -100.0, "good": 100.0}, clipped_samples=0)
    result = SimpleNamespace(
        plan=SimpleNamespace(band_hz=BAND_HZ),
        records={"step": record},
        validation=SimpleNamespace(facts=SimpleNamespace(records={"step": fit})),
        simulated=lambda name: simulated,
    )
    (text,) = _doubted(result)
    assert f"'step' look bad, a constant would have 0 %: poor -100 % ({outside} % of its error); in brackets" in text
    assert "good" not in text


@pytest.mark.parametrize(
    ("at", "said"),
    [
        ([(3.0, False)], "1 transmission zero (conjugates counted once): outside the unit circle none up to Nyquist."),
        (
            [(0.0, False), (3.0, True), (60.0, True)],
            "circle at 3 Hz up to Nyquist, 1 at 0 Hz, 1 real one beyond Nyquist, as sampling makes them.",
        ),
    ],
)
def test_of_zeros_only_those_are_counted_that_there_are(at, said):
    zeros = [SimpleNamespace(frequency_hz=f, outside=outside) for f, outside in at]
    assert _about_zeros(zeros, 50.0).endswith(said)


def test_a_coherence_that_a_sharp_mode_lowers_is_not_said_to_be_noise(rng):
    pole = 0.9995 * np.exp(2j * np.pi * 10.0 / RATE_HZ)
    u = rng.standard_normal(6000)
    y = lfilter([0.0, 1.0], np.poly([pole, pole.conj()]).real, u)
    result = SimpleNamespace(
        study=SimpleNamespace(identify=SimpleNamespace(records="quiet")),
        records={"quiet": Record(u[None], y[None], RATE_HZ)},
        plan=SimpleNamespace(band_hz=BAND_HZ),
        analysis=SimpleNamespace(facts=SimpleNamespace(f_hz=np.array([0.1, 49.0]))),
    )
    caption = _coherence(result).caption
    print(caption)
    assert "noise, or leaks from modes narrower than the resolution" in caption


@pytest.mark.parametrize(("fit", "said"), [(-4.0, True), (93.0, False)])
def test_a_model_preferred_one_step_ahead_that_simulates_badly_is_said_to(fit, said):
    blank = dict.fromkeys((f.name for f in fields(RankedModel)), 0.0)
    rows = [("arx", 4, fit), ("box-jenkins", 6, 96.0)]
    table = [
        RankedModel(**blank | {"structure": name, "order": order, "median_fit_percent": percent})
        for name, order, percent in rows
    ]
    best = PreferredModels(structure="arx", order=4, by_channel=(("arx 4",),), verdicts={"ok": 1})
    sentences = _simulating_better(best, table)
    assert bool(sentences) is said
    assert not said or "by arx 4 to -4.0 % and by box-jenkins 6 to 96.0 %" in sentences[0]


@pytest.mark.parametrize(("ny", "nu"), [(1, 1), (4, 3), (3, 5)])
@pytest.mark.parametrize(("band_hz", "narrow"), [((48.2, 49.8), True), ((47.9, 48.1), False)])
def test_a_band_between_the_lines_of_a_coherence_is_said_to_hold_none(ny, nu, band_hz, narrow, rng):
    """A study about one tone: of 4000 samples at 1 kHz the coherence has a line every 2 Hz."""
    wires = [Channel(f"push {k}", "kN") for k in range(nu)], [Channel(f"place {k}", "um") for k in range(ny)]
    u = rng.standard_normal((nu, 4000))
    records = {"all": Record(u, rng.standard_normal((ny, nu)) @ u, 1000.0, *wires)}
    study = SimpleNamespace(identify=SimpleNamespace(records=None))
    facts = SimpleNamespace(facts=SimpleNamespace(f_hz=np.linspace(1.0, 490.0, 50)))
    plan = SimpleNamespace(band_hz=band_hz)
    caption = _coherence(SimpleNamespace(study=study, records=records, analysis=facts, plan=plan)).caption
    print(caption)
    none = f"From {band_hz[0]:.4g} to {band_hz[1]:.4g} Hz there is no line of it."
    assert caption.endswith(none) if narrow else "Hz the least is 1.00, " in caption


PLANTS = {
    "rational": {"floor": 0.01},
    "weighted-rational": {"highest_order": 6, "criterion": "aic"},
    "structured": {"known": {}, "band_hz": (1.0, 45.0), "iterations": 2},
    "structured-modal": {"modes": 1, "band_hz": (1.0, 45.0), "iterations": 2},
}


@pytest.mark.parametrize("method", PLANTS)
def test_what_the_order_was_chosen_by_is_called_what_it_is_with_each_method(method, rng):
    """Held-out lines are named where lines were held out, a criterion where it chose, and nothing where nothing did."""
    truth = StateSpace([[0.9, 0.2], [-0.2, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], rate_hz=RATE_HZ)
    u = np.tile(rng.standard_normal(400), 6)[None]
    y = truth.simulate(u)
    records = {"periods": Record(u, y + 0.02 * np.std(y) * rng.standard_normal(y.shape), RATE_HZ)}
    settings = Plant.model_validate({"method": method, "records": ["periods"], "period_samples": 400} | PLANTS[method])
    facts = from_plain(PlantFacts, to_plain(plant(records, settings).facts))
    said = " ".join(picture.caption for picture in _by_order(facts))
    named = {*to_plain(facts)} & {"held_out_error", "misfit_in_noise"}
    print(named, said)
    if method == "rational":
        assert named == {"held_out_error"}
        assert f"order {facts.order} meets them within {100 * facts.errors_by_order[facts.order]:.2g} %" in said
    elif method == "weighted-rational":
        assert named == {"misfit_in_noise"}
        assert facts.misfit_in_noise == pytest.approx(1.0, abs=0.3)
        first, second = sorted(facts.criterion_by_order.values())[:2]
        assert first == facts.criterion_by_order[facts.order] == 0.0
        assert "AIC by order" in said
        assert f"chose order {facts.order}; the next best is order" in said
        assert f", {second:.3g} above." in said
        assert "%" not in said
    else:
        assert not named
        assert not said


def cells(section):
    return [str(cell) for table in section.tables for row in table.rows for cell in row]


def test_a_law_whose_loop_is_unstable_has_no_figures_beside_its_limit():
    nothing = dict.fromkeys(("attenuation_db", "peak_db", "control_gain", "limit_db", "left_db", "alone_db"), np.nan)
    band = RefusedBand(band_hz=BAND_HZ, peak_db=6.0, control_gain=1.0, status="refused: no.")
    facts = LimitFacts(
        bands=(band,), designs={"sky": DesignLimit(band_hz=BAND_HZ, status="unstable: it grows.", **nothing)}
    )
    wires = {"actuators": (Channel("push", "N"),), "sensors": (Channel("place", "um"),)}
    result = SimpleNamespace(
        limits=SimpleNamespace(facts=facts),
        plan=SimpleNamespace(band_hz=BAND_HZ),
        design_plant=SimpleNamespace(**wires),
        study=SimpleNamespace(blending=None),
    )
    assert cells(limits(result)) == ["sky", *"------"]


def test_of_drawn_benches_the_unstable_ones_are_called_so():
    shares = dict.fromkeys(("0%", "5%", "50%", "95%", "100%"), 6.0)
    quiet, loud = shares | {"0%": -np.inf}, shares | {"100%": np.inf}
    spread = {"attenuation_db": quiet, "peak_db": loud, "stable_share": {"share": 0.9}}
    ran = {"case": 3, "seed": 4, "unit": "bench", "stable": False, "status": "unstable", "replay": "campaign --case 3"}
    case = WorstCase(attenuation_db=-np.inf, peak_db=np.inf, **ran)
    facts = CampaignFacts(
        law="quiet",
        on="truth",
        benches=10,
        first_seed=1,
        band_hz=BAND_HZ,
        stable=9,
        stable_share=0.9,
        stable_interval=(0.6, 1.0),
        attenuation_db=quiet,
        peak_db=loud,
        by_unit={"bench": spread},
        drivers={},
        worst=(case,),
        campaign="",
        status="unstable: no.",
    )
    figures = {"bench": np.linspace(5.0, 6.0, 9)}
    found = cells(campaign(facts, CampaignCurves(attenuation_db=figures, peak_db=figures, f_hz=np.ones(1))))
    print(found)
    assert found.count("unstable") == 4
    assert not {"inf", "-inf", "nan"} & set(found)
