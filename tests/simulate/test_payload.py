"""What the payload feels: against algebra on a linear bench, in any units, through any controller, on any bench."""

import json
from dataclasses import replace

import numpy as np
import pytest
from payload_plants import LISTENED, RATE_HZ, UNDER, Mounted, heard, law, plant

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.pipeline.facts.mission import NoPayload, PayloadFacts, PayloadLoop
from ultraquiet.pipeline.facts.typed import from_plain, to_plain
from ultraquiet.pipeline.mission.payload import OpenPayloads, listened
from ultraquiet.pipeline.preflight import LoopPlan
from ultraquiet.pipeline.requirements import judge
from ultraquiet.pipeline.study import Deploy, Requirements, StudyError, parse
from ultraquiet.pipeline.tables.mission import PayloadTable
from ultraquiet.plot import draw_svg, figure_of
from ultraquiet.plot.pages.payload import Before, payload_chart
from ultraquiet.simulate import PayloadSetup, measure_payload
from ultraquiet.values import SteppedController

BAND_HZ = (4.0, 60.0)
SETUP = PayloadSetup(
    "shaker", LISTENED, BAND_HZ, base=UNDER, force="pusher", tones_hz=(10.0, 25.0), seconds=1.0, settle_s=1.5
)
HEXAPOD = PayloadSetup(
    "base proof mass", ("payload x", "payload y", "payload z"), (5.0, 100.0), ("base x", "base y", "base z"),
    "payload proof mass", (5.0, 25.0, 100.0),
)  # fmt: skip


def test_figures_are_those_of_algebra_for_noise_tones_and_a_force():
    found, model, K = measure_payload(Mounted(), law(), SETUP), plant(), law()
    for part, source in ((found.noise, 2), (found.force, 3)):
        f = part.opened.payload.f_hz
        inside = (f >= BAND_HZ[0]) & (f <= BAND_HZ[1])
        opened, closed = heard(model, K, f[inside], source)
        power = np.abs(part.opened.payload.amplitude[:, inside] / opened) ** 2  # of what was sent, at each line
        wanted = -10 * np.log10((np.abs(closed) ** 2 * power).sum() / (np.abs(opened) ** 2 * power).sum())
        print(f"{part.source}: {part.reduction_db():.4f} dB measured, {wanted:.4f} dB by algebra")
        assert part.reduction_db() == pytest.approx(wanted, abs=0.02)
    for tone, db in found.tones_db.items():
        opened, closed = heard(model, K, np.array([tone]), 2)
        assert db == pytest.approx(-20 * np.log10(np.linalg.norm(closed) / np.linalg.norm(opened)), abs=0.02)
    f, bare, controlled = found.noise.transmissibility
    assert f.shape == bare.shape == controlled.shape
    assert found.noise.reduction_db() > 1.0  # a law that does nothing would pass the rest


@pytest.mark.parametrize(("newtons", "metres"), [(1e9, 1.0), (1e-9, 1e9), (1.0, 1e-9)])
def test_units_change_nothing(newtons, metres):
    setup = PayloadSetup("shaker", LISTENED, BAND_HZ, base=UNDER, seconds=1.0, settle_s=1.0)
    plain = measure_payload(Mounted(), law(), setup).noise
    scaled = measure_payload(Mounted(newtons, metres), law(newtons, metres), setup).noise
    assert scaled.reduction_db() == pytest.approx(plain.reduction_db(), abs=1e-6)
    assert scaled.rms()[0] == pytest.approx(plain.rms()[0] / metres, rel=1e-6)
    assert np.allclose(scaled.transmissibility[2], plain.transmissibility[2], rtol=1e-6)


@pytest.mark.parametrize("seconds", [1.0, 5.0])
def test_a_band_about_one_tone_has_the_figures_of_its_lines(seconds):
    """It holds no mean over the half hertz that others are shown by."""
    setup = PayloadSetup("shaker", LISTENED, (9.95, 10.05), base=UNDER, seconds=seconds, settle_s=1.0)
    found = measure_payload(Mounted(), law(), setup).noise
    (f,), bare, controlled = found.transmissibility
    assert found.worst_db() == (pytest.approx(found.reduction_db()), 10.0)
    assert f == pytest.approx(10.0)
    assert controlled.shape == bare.shape == (1,)
    opened, closed = (
        np.abs(each.payload.amplitude[:, each.payload.f_hz == f]) for each in (found.opened, found.closed)
    )
    assert found.reduction_db() == pytest.approx(20 * np.log10(np.linalg.norm(opened) / np.linalg.norm(closed)))


def test_a_stepped_law_and_one_of_all_channels_do_the_same():
    setup = PayloadSetup("shaker", LISTENED, BAND_HZ, seconds=1.0, settle_s=1.0)
    K = law()
    every = uq.StateSpace(
        K.A, np.hstack([K.B, np.zeros((2, 4))]), np.vstack([K.C, np.zeros((2, 2))]), np.zeros((4, 6)), RATE_HZ
    )
    figures = [
        measure_payload(Mounted(), each, setup).noise.reduction_db() for each in (K, SteppedController(K), every)
    ]
    figures.append(measure_payload(Mounted().full, K, SETUP).noise.reduction_db())
    assert figures[1] == pytest.approx(figures[0], abs=1e-9)
    assert figures[2] == pytest.approx(figures[0], abs=1e-9)
    assert figures[3] == pytest.approx(figures[0], abs=1.0)  # another period of noise


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"shaker": "motor"}, "no channel 'motor'; it has strut a"),
        ({"sensors": ("payload left", "nothing")}, "no channel 'nothing'"),
        ({"sensors": ()}, "at least one sensor"),
        ({"band_hz": (5.0, 400.0)}, "Nyquist"),
        ({"band_hz": (0.2, 40.0)}, "fewer than two periods"),
        ({"band_hz": (10.01, 10.02)}, "8 s holds no line between 10.01 and 10.02 Hz; make it longer or the band wider"),
        ({"level": -1.0}, "above zero"),
        ({"tones_hz": (10.0, 400.0)}, "'tones_hz' must lie below Nyquist's 250 Hz, got 400 Hz"),
        ({"tones_hz": (250.0,)}, "below Nyquist"),
        ({"tones_hz": (249.99,)}, "8 s do not tell from Nyquist's frequency the tone of 249.99 Hz"),
        ({"tones_hz": (0.05,)}, "8 s are less than a period of the tone of 0.05 Hz"),
        ({"tones_hz": (10.0, -3.0)}, "'tones_hz' must be above zero"),
        ({"tones_hz": ("ten",)}, "'tones_hz' must be one number or several"),
    ],
)
def test_what_cannot_be_measured_is_said(change, words):
    with pytest.raises(InputError, match=words):
        measure_payload(
            Mounted(), law(), PayloadSetup(**{"shaker": "shaker", "sensors": LISTENED, "band_hz": BAND_HZ} | change)
        )


def test_a_tone_between_two_lines_is_read_at_the_line_that_it_was_sent_at():
    """Of 3.5 Hz and a period of one second the nearest lines are two."""
    setup = PayloadSetup("shaker", LISTENED, (2.0, 60.0), tones_hz=(3.5, 24.5), seconds=1.0, settle_s=1.0)
    found = measure_payload(Mounted(), law(), setup)
    amplitude = np.abs(found.tones.opened.payload.amplitude).sum(axis=0)
    sent = found.tones.opened.payload.f_hz[np.sort(np.argsort(amplitude)[-2:])]
    for (tone, db), f in zip(found.tones_db.items(), sent, strict=True):
        opened, closed = heard(plant(), law(), np.array([f]), 2)
        assert abs(tone - f) == 0.5
        assert db == pytest.approx(-20 * np.log10(np.linalg.norm(closed) / np.linalg.norm(opened)), abs=0.02)


@pytest.mark.parametrize("band_hz", [(10.0, 10.2), (10.0, 10.1), (30.1, 30.3)])
def test_a_band_narrower_than_what_is_drawn_is_told_line_by_line(band_hz):
    setup = PayloadSetup("shaker", LISTENED, band_hz, base=UNDER, seconds=8.0, settle_s=1.0)
    for found in (measure_payload(Mounted(), law(), s).noise for s in (setup, replace(setup, base=()))):
        f = found.opened.payload.f_hz
        lines = f[(f >= band_hz[0]) & (f <= band_hz[1])]
        reductions = [found.line_db(line) for line in lines]
        assert found.worst_db() == pytest.approx((min(reductions), lines[np.argmin(reductions)]))
        assert np.array_equal(found.transmissibility[0], lines)
        opened, closed = found.transmissibility[1:]
        assert np.isfinite([opened, closed]).all()
    assert -20 * np.log10(closed / opened) == pytest.approx(reductions)  # over the same command where no base is read


def test_a_bench_without_instruments_and_a_law_of_other_channels_are_told_so():
    setup = PayloadSetup("shaker", ("mass 2",), BAND_HZ)
    pair = uq.bench.Wrapped(lambda u, d: [0.0], lambda: None, RATE_HZ, ["shaker"], ["mass 1"])
    with pytest.raises(InputError, match="offers them by a method 'instrumented'"):
        measure_payload(pair, law(), setup)
    wrong = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((1, 0)), np.zeros((1, 3)), RATE_HZ)
    with pytest.raises(InputError, match="takes 3 readings and gives 1 commands; the bench offers"):
        measure_payload(Mounted(), wrong, SETUP)


def test_a_study_listens_through_its_code_and_says_why_where_it_cannot():
    table = PayloadTable(
        shaker="shaker", sensors=list(LISTENED), band_hz=BAND_HZ, force="pusher", seconds=1.0, settle_s=1.0
    )
    plan = LoopPlan(("bench",), (10.0,), 1.0, 2.0, BAND_HZ)
    open_payloads = OpenPayloads(Mounted(), plan, table, 1)
    limits = np.tile([-1e3, 1e3], (2, 1))
    outcome = listened("calm", law(), open_payloads, {}, limits, Deploy())
    assert from_plain(PayloadFacts, json.loads(json.dumps(to_plain(outcome.facts)))).units.keys() == {"bench"}
    loop = outcome.facts.units["bench"]
    assert isinstance(loop, PayloadLoop)
    print(loop)
    assert loop.through.startswith(("float32", "the law itself"))
    assert loop.reduction_db == pytest.approx(
        measure_payload(Mounted(), law(), table.setup(seed=1)).noise.reduction_db(), abs=0.01
    )
    assert loop.broadband_5_100_db is None  # the noise ends at 60 Hz
    curves = outcome.facts.curves["bench"]
    felt = Before(
        curves.f_hz,
        (curves.open_transmissibility, curves.closed_transmissibility),
        (curves.open_cumulative, curves.closed_cumulative),
    )
    drawn = payload_chart("payload", "calm", {"bench": felt}, ("payload over shaker", "", "um/s"), BAND_HZ, "told.")
    assert [curve.name for curve in drawn.panels[0].curves] == ["without", "calm"]
    assert "<svg" in draw_svg(figure_of(drawn))
    asked = Requirements(law="calm", payload_db=loop.reduction_db + 0.1)
    judged = judge(asked, BAND_HZ, None, {}, outcome.facts.units)
    assert len(judged.missed) == 1
    assert judge(asked, BAND_HZ, None, {}, {"bench": NoPayload(status="not shaken: x")}).judged[0].figure is None


STUDY = """
[study]
title = "short"
{bench}
[plant]
method = "subspace"
records = ["all"]
order = 4
[controllers.calm.design]
method = "lqg"
[payload]
shaker = "shaker"
sensors = []
band_hz = [60.0, 4.0]
"""


def test_a_payload_table_is_checked_with_its_lines():
    with pytest.raises(StudyError) as refused:
        parse(STUDY.format(bench='[bench]\nmethod = "hexapod"'))
    assert {line for line, _ in refused.value.mistakes} == {14, 15}
    fine = STUDY.replace("[]", '["a"]').replace("[60.0, 4.0]", "[4.0, 60.0]")
    with pytest.raises(StudyError, match="no bench that could be shaken"):
        parse(fine.format(bench='[records]\nfiles = ["x.h5"]'))


@pytest.mark.slow
@pytest.mark.parametrize("unit", ["ground", "flight"])
def test_the_hexapods_payload_is_quieter_through_compiled_code(unit, tmp_path):
    """Hysteresis and drift on, float32 code in the loop; the law is designed from the ground unit's linear model."""
    plant_of = uq.bench.Hexapod(unit="ground").linear_model()
    result = uq.design.BandAttenuation(band_hz=(9.0, 108.0), height=12.0, structure="repeated").design(plant_of)
    bench = uq.bench.Hexapod(unit=unit, seed=1, hysteresis=True, drift=1.0)
    code = uq.deploy.generate(result.controller, tmp_path / "code", limits_v=25.0)
    found = {
        name: measure_payload(bench, each, HEXAPOD)
        for name, each in (("law", result.controller), ("code", code.instance()))
    }
    for name, each in found.items():
        noise, force = each.noise, each.force
        tones = ", ".join(f"{f:g} Hz {db:.1f}" for f, db in each.tones_db.items())
        print(f"{unit}, {name}: 5-100 Hz {noise.reduction_db():.2f}, 10-100 Hz {noise.reduction_db(10, 100):.2f} dB")
        print(f"  tones {tones} dB; force {force.reduction_db(10, 100):.2f} dB, least {force.worst_db()}")
    assert abs(found["law"].noise.reduction_db() - found["code"].noise.reduction_db()) < 0.1
    assert found["code"].noise.reduction_db() > 16.5


def test_a_law_that_reads_the_payload_itself_answers_a_force_there():
    """Damping by both struts from the payload's own sensors, against algebra: the law is not one of the bench's own."""
    K = law()
    setup = PayloadSetup("shaker", LISTENED, BAND_HZ, force="pusher", seconds=1.0, settle_s=1.5, reads=LISTENED)
    found = measure_payload(Mounted(), K, setup).force
    f = found.opened.payload.f_hz
    inside = (f >= BAND_HZ[0]) & (f <= BAND_HZ[1])
    G, Kf = plant().frequency_response(f[inside]), K.frequency_response(f[inside])
    opened = G[2:4, 3]
    closed = np.array(
        [np.linalg.solve(np.eye(2) - G[2:4, :2, k] @ Kf[:, :, k], opened[:, k]) for k in range(opened.shape[1])]
    ).T
    power = np.abs(found.opened.payload.amplitude[:, inside] / opened) ** 2
    wanted = -10 * np.log10((np.abs(closed) ** 2 * power).sum() / (np.abs(opened) ** 2 * power).sum())
    assert found.reduction_db() == pytest.approx(wanted, abs=0.02)
    with pytest.raises(InputError, match="no channel 'nothing'"):
        measure_payload(Mounted(), K, PayloadSetup("shaker", LISTENED, BAND_HZ, reads=("nothing", "base left")))


@pytest.mark.slow
@pytest.mark.parametrize("unit", ["ground", "flight"])
def test_the_hexapod_with_sensors_on_the_payload(unit):
    """LQG from the payload's three axes to the six struts, designed on the ground unit's linear model alone."""
    full = uq.bench.Hexapod(unit="ground", instruments="all").linear_model()
    axes = [k for k, c in enumerate(full.sensors) if c.name in HEXAPOD.sensors]
    seen = uq.StateSpace(full.A, full.B[:, :6], full.C[axes], full.D[axes][:, :6], full.rate_hz)
    result = uq.design.Lqg(band_hz=(10.0, 100.0)).design(seen)
    bench = uq.bench.Hexapod(unit=unit, seed=1, hysteresis=True, drift=1.0)
    found = measure_payload(bench, result.controller, replace(HEXAPOD, reads=HEXAPOD.sensors))
    force, noise = found.force, found.noise
    print(f"{unit}: force 10-100 Hz {force.reduction_db(10, 100):.1f} dB, least {force.worst_db()}; {result.status}")
    print(f"  the same law with the base shaken: {noise.reduction_db(10, 100):.1f} dB over 10-100 Hz")
    assert result.status.ok
    assert force.reduction_db(10, 100) >= 12.0
