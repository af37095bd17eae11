"""`analyse` and `simulate`: the numbers of a loop by its channels' names, in any units, and nothing written over."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet.cli.deploy.margins import rounded_loop
from ultraquiet.cli.loop.facts import slowest_sentence
from ultraquiet.design.loop_analysis import SlowestMode, analyse_loop

RATE = 1000.0
SHAPES = ((1, 1), (4, 3), (3, 5))


def plant_and_law(rng, ny, nu, unit=1.0):
    """Four damped modes and a law by LQG; readings in multiples of `unit`."""
    poles = [np.exp(2 * np.pi * f / RATE * (-0.05 + 1j)) for f in (20.0, 35.0, 60.0, 90.0)]
    A, B, C = np.zeros((8, 8)), np.zeros((8, nu)), np.zeros((ny, 8))
    for k, z in enumerate(poles):
        rows = slice(2 * k, 2 * k + 2)
        A[rows, rows] = [[z.real, z.imag], [-z.imag, z.real]]
        B[2 * k] = rng.uniform(0.5, 1.0, nu) * 0.05
        C[:, 2 * k] = rng.uniform(0.5, 1.0, ny)
    actuators = [uq.Channel(f"coil [{k + 1}]", "N") for k in range(nu)]
    sensors = [uq.Channel(f"geophone {k + 1}", "m/s") for k in range(ny)]
    G = uq.StateSpace(A, B, unit * C, np.zeros((ny, nu)), RATE, actuators, sensors)
    return G, uq.design.Lqg().design(G).controller


@pytest.fixture(params=SHAPES, ids=str)
def loop(request, rng, tmp_path):
    G, K = plant_and_law(rng, *request.param)
    uq.files.save(G, tmp_path / "plant.h5")
    uq.files.save(K, tmp_path / "law.h5")
    return G, K


@pytest.mark.gate("(4, 3)")
def test_what_analyse_says_is_what_the_rooms_below_say(run, loop):
    G, K = loop
    code, out, err = run("analyse", "plant.h5", "law.h5", "--band", "15", "70", "--json")
    assert code in (0, 1), err
    said = json.loads(out)
    print(said["status"])
    assert said["stable"]
    assert code == (said["status"]["word"] != "ok")
    assert said["band_hz"] == [15.0, 70.0]
    for end in ("input", "output"):
        found = uq.analyse.end_margins(G, K, end)
        wires = G.actuators if end == "input" else G.sensors
        assert [c["name"] for c in said["margins"][end]["channels"]] == [w.name for w in wires]
        assert said["margins"][end]["disk_all"] == pytest.approx(found.disk_all)
        assert [c["phase_deg"] or np.inf for c in said["margins"][end]["channels"]] == pytest.approx(found.phase_deg)
    S = uq.analyse.gang_of_four(G, K)
    for name in ("S", "T", "KS"):
        assert said["peaks"][name]["gain"] == pytest.approx(uq.analyse.hinf_norm(S[name])[0], rel=1e-6)
    assert said["peaks"]["KS"]["unit"] == "N/(m/s)"
    assert said["peaks"]["S"]["gain_db"] == pytest.approx(uq.analyse.peak_sensitivity(G, K)[0], abs=1e-6)
    f = np.linspace(15, 70, 2001)
    inside, reached = (np.moveaxis(s.frequency_response(f), 2, 0) for s in (S["S"], G))
    if G.D.shape[0] > G.D.shape[1]:
        inside = inside @ np.linalg.qr(reached)[0]
    worst = np.linalg.norm(inside, 2, axis=(1, 2)).max()
    assert said["attenuation_db"] == pytest.approx(-20 * np.log10(worst), abs=0.02)


def test_a_law_against_tones_says_what_it_does_at_each(run, rng):
    G, _ = plant_and_law(rng, 1, 1)
    uq.files.save(G, "plant.h5")
    settings = ("--method", "resonators", "--set", "tones_hz=[25.0, 70.0]")
    words = ("design", "plant.h5", *settings, "--out", "K.h5", "--force")
    told = json.loads(run(*words, "--json")[1])
    made = uq.design.Resonators(tones_hz=(25.0, 70.0)).design(G)
    assert [each["f_hz"] for each in told["tones"]] == [25.0, 70.0]
    for name in ("depth_db", "settling_s", "phase_margin_deg", "directions", "slowed"):
        assert [each[name] for each in told["tones"]] == pytest.approx(list(made.details[name].values()))
    page = run(*words)[1]
    assert re.search(rf"25 Hz +{made.details['depth_db'][25.0]:.2f} dB", page)
    quick = run(*words, "--set", "settling_s=1e-3", "--json")
    assert quick[0] == 1
    assert json.loads(quick[1])["status"]["word"] == "short"


def test_a_real_pole_is_no_pair():
    assert slowest_sentence(SlowestMode(146.1, 0.0, -1.0)) == "slowest pole: real, grows by 146.1 e-folds a second"
    assert slowest_sentence(SlowestMode(-2.0, 5.0, 0.06)) == (
        "slowest pair: 5 Hz, decays by 2 e-folds a second, damping 0.06"
    )


@pytest.mark.gate("(4, 3)")
def test_a_readers_table_names_channels_and_units(run, loop):
    G, _ = loop
    out = run("analyse", "plant.h5", "law.h5")[1]
    print(out)
    for wire in (*G.actuators, *G.sensors):
        assert f"{wire.name}" in out
    assert "coil [1]" in out  # a bracket is no markup
    assert slowest_sentence(analyse_loop(*loop).slowest).partition(",")[0] in out
    assert re.search(r"(attenuation|amplification) of the worst direction over .* Hz: \d", out)


@pytest.mark.gate("1e-09")
@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_other_units_of_the_readings_change_nothing_but_them(rng, unit):
    G, K = plant_and_law(rng, 4, 3)
    H = uq.StateSpace(G.A, G.B, unit * G.C, G.D, RATE, G.actuators, G.sensors)
    L = uq.StateSpace(K.A, K.B / unit, K.C, K.D / unit, RATE)
    one, other = analyse_loop(G, K), analyse_loop(H, L)
    assert other.status.word == one.status.word
    assert other.band_hz == pytest.approx(one.band_hz)
    assert other.attenuation_db == pytest.approx(one.attenuation_db, abs=1e-6)
    assert other.peaks["S"].gain == pytest.approx(one.peaks["S"].gain, rel=1e-6)
    assert other.peaks["KS"].gain * unit == pytest.approx(one.peaks["KS"].gain, rel=1e-6)
    assert other.slowest.growth_per_s == pytest.approx(one.slowest.growth_per_s)


@pytest.mark.slow
def test_channels_of_several_units_are_weighed_alike_whatever_their_units(rng):
    G, K = plant_and_law(rng, 3, 3)
    sensors = [uq.Channel("a", "m/s"), uq.Channel("b", "g"), uq.Channel("c", "V")]
    scale = np.array([1e6, 1.0, 1e-6])
    G = uq.StateSpace(G.A, G.B, G.C, G.D, RATE, G.actuators, sensors)
    H = uq.StateSpace(G.A, G.B, scale[:, None] * G.C, G.D, RATE, G.actuators, sensors)
    L = uq.StateSpace(K.A, K.B / scale, K.C, K.D / scale, RATE)
    one, other = analyse_loop(G, K), analyse_loop(H, L)
    assert one.even
    assert other.peaks["S"].gain == pytest.approx(one.peaks["S"].gain, rel=1e-6)
    assert other.attenuation_db == pytest.approx(one.attenuation_db, abs=1e-6)


@pytest.mark.gate("(4, 3)")
def test_an_unstable_and_a_fragile_loop_end_with_one(run, loop):
    K = loop[1]
    uq.files.save(uq.StateSpace(K.A, K.B, -40 * K.C, -40 * K.D, RATE), "wild.h5")
    code, out, _ = run("analyse", "plant.h5", "wild.h5", "--json")
    said = json.loads(out)
    assert (code, said["status"]["word"], said["attenuation_db"]) == (1, "unstable", None)
    assert said["slowest"]["growth_per_s"] > 0
    code, out, _ = run("simulate", "wild.h5", "--plant", "plant.h5", "--json")
    said = json.loads(out)
    assert (code, said["status"]["word"], "tones" in said) == (1, "unstable", False)
    code, out, _ = run("analyse", "plant.h5", "law.h5", "--disk-margin", "1.99", "--json")
    assert (code, json.loads(out)["status"]["word"]) == (1, "fragile")


@pytest.mark.gate("q31-loop0")
@pytest.mark.parametrize("loop", [(1, 1)], indirect=True)
@pytest.mark.parametrize("precision", ["float32", "q31"])
def test_code_of_a_fragile_law_ends_with_one(run, loop, precision):
    """As `analyse` does: what the law's own design stated is asked of the rounded one, 0.2 where it stated nothing."""
    G, K = loop
    uq.files.save(uq.StateSpace(K.A, K.B, K.C, K.D, RATE), "nameless.h5")
    more = ("--range", "5") if precision == "q31" else ("--target", "none")
    words = ("--plant", "plant.h5", "--precision", precision, "--limits", "5", *more, "--steps", "1000", "--json")
    code, out, err = run("deploy", "nameless.h5", *words)
    assert (code, json.loads(out)["loop"]["word"]) == (0, "ok"), err
    weak = end_of_stability(G, K)
    uq.files.save(weak_law(K, weak), "weak.h5")
    code, out, err = run("deploy", "weak.h5", *words)
    said = json.loads(out)
    assert (code, said["loop"]["word"], said["verified"]["word"]) == (1, "fragile", "ok"), err
    assert rounded_loop(G, weak_law(K, weak), K).status.word == "fragile"
    bold = uq.design.Lqg(disk_margin=0.0).design(G).controller
    assert rounded_loop(G, weak_law(K, weak), bold).status.ok
    assert rounded_loop(G, weak_law(K, 100.0), K).status is None  # unstable, which others say


def weak_law(K, gain):
    """Return a law at another gain, without what its design stated."""
    return uq.StateSpace(K.A, K.B, gain * K.C, gain * K.D, RATE)


def end_of_stability(G, K):
    """Return a gain at which a loop is stable and keeps a tenth of the margin that is asked."""
    for gain in np.geomspace(1.0, 100.0, 400):
        if 0 < uq.analyse.end_margins(G, weak_law(K, gain), "input").disk_all < 0.1:
            return float(gain)
    raise AssertionError("no gain makes this loop fragile")


@pytest.mark.slow
@pytest.mark.parametrize("loop", [(1, 1)], indirect=True)
def test_figures_of_one_name_stand_side_by_side(run, loop, tmp_path):
    for _ in range(2):
        run("analyse", "plant.h5", "law.h5", "--out", "figures")
    run("analyse", "plant.h5", "law.h5", "--out", "figures", "--format", "png")
    names = sorted(path.name for path in (tmp_path / "figures").iterdir())
    assert names == [
        "law-nyquist-2.svg", "law-nyquist.png", "law-nyquist.svg",
        "law-sensitivity-2.svg", "law-sensitivity.png", "law-sensitivity.svg",
    ]  # fmt: skip
    assert (tmp_path / "figures" / "law-nyquist.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.gate("(4, 3)")
def test_a_model_simulated_shows_the_loop_that_was_analysed(run, loop):
    """Tones to the sensitivity of the loop, noise to its integral, and a step to its own response."""
    G, K = loop
    code, out, err = run("simulate", "law.h5", "--plant", "plant.h5", "--tones", "20,40", "--step", "--json")
    assert code == 0, err
    said = json.loads(out)
    S = uq.analyse.gang_of_four(G, K)["S"]
    for row in said["tones"]:
        f = [row["f_hz"]]
        opened = G.frequency_response(f)[:, :, 0].sum(axis=1)
        closed = S.frequency_response(f)[:, :, 0] @ opened
        for k, wire in enumerate(G.sensors):
            expected = -20 * np.log10(abs(closed[k] / opened[k]))
            assert row["sensors"][wire.name]["reduction_db"] == pytest.approx(expected, abs=0.05)
            assert row["sensors"][wire.name]["unit"] == "m/s"
    step = G.simulate(np.eye(G.D.shape[1])[:, :1] * np.ones((1, 1800)))
    for k, wire in enumerate(G.sensors):
        found = said["step"]["actuators"]["coil [1]"][wire.name]
        assert found["open_peak"] == pytest.approx(np.abs(step[k]).max(), rel=1e-6)
        assert found["closed_settling_s"] < 1.8
    assert "noise" not in said


def test_noise_is_what_the_band_says(rng):
    G, K = plant_and_law(rng, 2, 2)
    bench = uq.bench.LinearBench(G)
    found = uq.simulate.noise_reduction(bench, K, (15.0, 70.0), 2.0, 8.0, seed=1)
    f = np.linspace(15.0, 70.0, 4000)
    GS = uq.analyse.gang_of_four(G, K)["GS"]
    for rms, system in ((found.open_rms, G), (found.closed_rms, GS)):
        expected = 2.0 * np.sqrt(np.mean(np.sum(np.abs(system.frequency_response(f)) ** 2, axis=1), axis=1))
        assert rms == pytest.approx(expected, rel=0.2)  # 220 lines in the measured half


@pytest.mark.slow  # the hexapod rings for seconds
def test_a_bench_of_a_study_file_and_a_unit_of_it(run, tmp_path):
    suite = Path(uq.__file__).parent / "pipeline" / "suite.toml"
    (tmp_path / "study.toml").write_text(suite.read_text())
    law = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, 6)), np.zeros((6, 0)), -1e-3 * np.eye(6), 3500.0)
    uq.files.save(law, tmp_path / "law.h5")
    words = ("--bench", "study.toml", "--tones", "25", "--duration", "0.5", "--json")
    code, out, err = run("simulate", "law.h5", *words, "--unit", "flight")
    assert code == 0, err
    said = json.loads(out)
    assert "flight" in said["on"]
    assert set(said["tones"][0]["sensors"]) == {f"strut {k}" for k in range(1, 7)}
    code, _, err = run("simulate", "law.h5", *words, "--unit", "moon")
    assert (code, "'moon'" in err) == (2, True)


@pytest.mark.parametrize(
    ("force", "motion", "units", "told"),
    [
        ("f", "a", ("N", "m/s^2"), True),
        ("coil", "geophone", ("", ""), True),
        ("force sensor", "position actuator", ("N", "m"), False),
        ("u", "y", ("", ""), False),
    ],
)
def test_a_plant_where_its_law_is_to_stand_is_refused_where_channels_tell(run, tmp_path, force, motion, units, told):
    f, a = uq.Channel(force, units[0]), uq.Channel(motion, units[1])
    uq.files.save(uq.StateSpace([[0.5]], [[1.0]], [[0.1]], [[0.0]], 1000.0, [f], [a]), tmp_path / "pushed.h5")
    uq.files.save(uq.StateSpace([[0.5]], [[1.0]], [[0.1]], [[0.0]], 1000.0, [a], [f]), tmp_path / "law.h5")
    assert run("analyse", "pushed.h5", "law.h5")[0] == 0
    code, _, err = run("analyse", "law.h5", "pushed.h5")
    print(err)
    assert code == (2 if told else 0)
    assert ("PLANT comes first, its law after it" in err) == told
