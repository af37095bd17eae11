"""Every caption of a study's report, read and held against the numbers that the study left."""

import json
import re

import numpy as np
import pytest
from rig_study import LIST, RIG, STUDY

import ultraquiet as uq
from read_page import Page
from report_words import foreign_words
from ultraquiet.pipeline import load_study, walk

TONES, AMPLITUDE = (13.5, 29.0), 2.25
NAMES = {"left force": "north push", "right force": "south push", "left mass": "deck", "right mass": "keel"}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The rig with other names, units, levels, tones and amplitude, its study walked; its folder and report."""
    folder = tmp_path_factory.mktemp("captions")
    rig = RIG.replace('"N", -30.0, 30.0', '"mN", -45.0, 45.0').replace('"m/s"', '"mm/s^2"')
    rig = rig.replace('f"{side} force"', "PUSHES[side]").replace('f"{side} mass"', 'PUSHES[side + "y"]')
    names = {"left": "north push", "right": "south push", "lefty": "deck", "righty": "keel"}
    (folder / "rig.py").write_text(rig.replace("SHAPES =", f"PUSHES = {names}\nSHAPES =", 1))
    (folder / "list.toml").write_text(LIST.replace("peak_v = 20.0", "peak_v = 18.0"))
    study = STUDY.replace("tones_hz = [17.0]", f"tones_hz = {list(TONES)}\namplitude = {AMPLITUDE}")
    (folder / "study.toml").write_text(study)
    walk(load_study(folder / "study.toml"), folder / "out", folder)
    page = (folder / "out" / "report.html").read_text()
    return folder / "out", Page(page), page


def captions(page):
    return {name: text for s in page.sections for name, text in zip(s.figures, s.captions, strict=True)}


def numbers(text):
    return [float(found) for found in re.findall(r"-?\d+\.?\d*", text)]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_no_word_of_another_bench_is_left(made):
    _, page, text = made
    assert not foreign_words(text)
    said = " ".join(captions(page).values())
    print(said)
    assert all(name not in said for name in NAMES)
    assert "m/s " not in said.replace("mm/s", "")


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_captions_of_tones_tell_what_the_records_hold(made):
    folder, page, _ = made
    loop = json.loads((folder / "summary.json").read_text())["closed_loop"]["calm"]["bench"]
    said = captions(page)
    tones = {name: text for name, text in said.items() if name.startswith("closed_loop_calm")}
    assert tones
    for text in tones.values():
        print(text)
        tone = next(f for f in TONES if f"a tone of {f:g} Hz" in text)
        stem = f"calm-{tone:g}hz"
        opened, closed = (uq.files.load(folder / "loops" / f"{stem}{end}.h5").outputs for end in ("-open", ""))
        assert f"{AMPLITUDE:g} mN on all actuators" in text
        assert f"quieter by {loop['tones'][f'{tone:g}']['reduction_db']:.1f} dB" in text
        sensor = re.search(r"gains least, (\w+),", text)[1]
        drop = [
            20 * np.log10(np.std(a[-a.size // 2 :]) / np.std(b[-b.size // 2 :]))
            for a, b in zip(opened, closed, strict=True)
        ]
        assert sensor == ("deck", "keel")[int(np.argmin(drop))]
        assert min(drop) == pytest.approx(loop["tones"][f"{tone:g}"]["reduction_db"], abs=0.5)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_captions_of_models_and_loops_tell_what_is_drawn(made):
    folder, page, _ = made
    summary, said = json.loads((folder / "summary.json").read_text()), captions(page)
    G, law = (uq.files.load(folder / where) for where in ("models/plant.h5", "controllers/calm.h5"))
    f = np.geomspace(0.5, 249.0, 20000)
    values = np.moveaxis(G.frequency_response(f), 2, 0)
    sizes = np.linalg.svd(values, compute_uv=False)
    apart_db, at_hz = numbers(said["singular_values"])[:2]
    spread = 20 * np.log10(sizes[:, 0] / sizes[:, 1])
    assert spread.max() == pytest.approx(apart_db, abs=1.0)
    assert f[np.argmax(spread)] == pytest.approx(at_hz, rel=0.02)
    S = np.linalg.inv(np.eye(2) - values @ np.moveaxis(law.frequency_response(f), 2, 0))
    peak = 20 * np.log10(np.linalg.norm(S, 2, axis=(1, 2)).max())
    assert peak == pytest.approx(float(re.search(r"calm (-?[\d.]+) dB", said["loops"])[1]), abs=0.15)
    margins = uq.analyse.end_margins(G, law, "output"), uq.analyse.end_margins(G, law, "input")
    least = min(float(np.min(m.disk)) for m in margins)
    assert least == pytest.approx(float(re.search(r"The least is ([\d.]+):", said["margins"])[1]), abs=0.01)
    locus = np.linalg.eigvals(-values @ np.moveaxis(law.frequency_response(f), 2, 0))
    assert np.abs(1 + locus).min() == pytest.approx(
        float(re.search(r"passes -1 at (\d+\.\d+)", said["nyquist"])[1]), abs=0.02
    )
    measured = uq.files.load(folder / "loops" / "calm-bench-sensitivity.h5")
    band = summary["closed_loop"]["calm"]["bench"]["band_hz"]
    gains = 20 * np.log10(np.linalg.norm(np.moveaxis(measured.values, 2, 0), 2, axis=(1, 2)))
    inside = (measured.f_hz >= band[0]) & (measured.f_hz <= band[1])
    worst = gains[inside].max()
    word = "quieter" if worst < 0 else "louder"
    print(said["sensitivity"])
    assert f"calm: {abs(worst):.1f} dB {word} at the worst line" in said["sensitivity"]
    assert f"peak {gains.max():.1f} dB" in said["sensitivity"]
    hidden = summary["closed_loop"]["calm"]["bench"]["lines_hidden"]
    assert ("Lines that noise hides" in said["sensitivity"]) == bool(hidden)
    assert float(re.search(r"(\d+) lines from", said["response"])[1]) > 100


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_captions_of_records_tell_their_levels(made):
    folder, page, _ = made
    said = captions(page)
    assert "'rough'" in said["responses"]
    assert "north push" in said["responses"]
    drawn = re.search(
        r"Reading of (\w+) under the tone of ([\d.]+) Hz: ([\d.]+) (\S+) rms open, ([\d.]+)", said["density_calm"]
    )
    print(said["density_calm"])
    sensor, tone, opened, unit, closed = drawn.groups()
    assert unit == "mm/s^2"
    k = ("deck", "keel").index(sensor)
    for end, told in (("-open", opened), ("", closed)):
        y = uq.files.load(folder / "loops" / f"calm-{tone}hz{end}.h5").outputs[k]
        assert float(told) == pytest.approx(np.sqrt(np.mean((y[y.size // 2 :]) ** 2)), rel=0.1)
