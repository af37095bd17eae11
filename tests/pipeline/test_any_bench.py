"""A study of somebody else's bench, a Python function or a table, and a report that speaks of it."""

import json
import re

import numpy as np
import pytest

import ultraquiet as uq
from report_words import foreign_words, visible
from ultraquiet.pipeline import load_study, walk
from ultraquiet.pipeline.study import StudyError

TWO_MASSES = '''
import numpy as np
import ultraquiet as uq


def make_bench(noise, seed):
    """Two masses in a row, each on a spring to its neighbour: newtons in, metres per second out, at 500 Hz."""
    rate_hz, w = 500.0, 2 * np.pi * np.array([9.0, 31.0])
    shapes = np.array([[0.6, 0.8], [0.8, -0.6]])
    blocks = [np.exp(-0.02 * w[k] / rate_hz) * turn(w[k] / rate_hz) for k in range(2)]
    state, rng = np.zeros((2, 2)), np.random.default_rng(seed)

    def reset():
        state[:] = 0.0

    def step(u, d):
        y = shapes @ state[:, 0] + noise * rng.standard_normal(2)
        for k in range(2):
            state[k] = blocks[k] @ state[k] + np.array([0.01 * shapes[:, k] @ (u + d), 0.0])
        return y

    forces = [uq.values.Channel(f"{side} force", "N", -30.0, 30.0) for side in ("left", "right")]
    speeds = [uq.values.Channel(f"{side} mass", "m/s") for side in ("left", "right")]
    return uq.bench.Wrapped(step, reset, rate_hz, forces, speeds)


def turn(angle):
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
'''
LIST = """
title = "two masses"
[[commands]]
do = "configure"
samples = 3000
[[commands]]
do = "excite"
name = "rough"
actuator = "each"
signal = { method = "noise", stop_hz = 150.0, peak_v = 20.0 }
[[commands]]
do = "excite"
name = "sines"
actuator = "each"
signal = { method = "multisine", start_hz = 1.0, stop_hz = 200.0, period_samples = 1000, peak_v = 20.0 }
"""
STUDY = """
[study]
title = "Two masses"
seed = 3
[bench]
object = "two_masses.py:make_bench"
noise = 1e-4
[experiment]
list = "list.toml"
[identify]
structures = ["arx", "output-error"]
orders = [4]
[plant]
method = "rational"
records = ["sines"]
period_samples = 1000
[controllers.quiet.design]
method = "mixed-sensitivity"
[closed_loop]
tones_hz = [11.0]
"""
TABLE = """
[study]
title = "Four by three"
[records]
files = ["run.csv"]
rate_hz = 2000.0
inputs = ["f1", "f2", "f3"]
outputs = ["v1", "v2", "v3", "v4"]
[plant]
method = "subspace"
order = 8
records = ["run"]
[controllers.quiet.design]
method = "lqg"
"""


@pytest.fixture
def masses(tmp_path):
    """A study of a bench that is a Python function beside it."""
    (tmp_path / "two_masses.py").write_text(TWO_MASSES)
    (tmp_path / "list.toml").write_text(LIST)
    (tmp_path / "study.toml").write_text(STUDY)
    return tmp_path


@pytest.fixture
def table(tmp_path, rng):
    """A study of a CSV: three forces in newtons, four speeds in metres per second, at 2 kHz."""
    rate_hz, n = 2000.0, 4000
    w = 2 * np.pi * np.array([40.0, 75.0, 130.0, 210.0]) / rate_hz
    A = np.zeros((8, 8))
    for k, angle in enumerate(w):
        turned = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = np.exp(-0.03 * angle) * turned
    plant = uq.StateSpace(A, 1e-3 * rng.standard_normal((8, 3)), rng.standard_normal((4, 8)), np.zeros((4, 3)), rate_hz)
    u = 10 * rng.standard_normal((3, n))
    y = plant.simulate(u) + 1e-5 * rng.standard_normal((4, n))
    head = ",".join([*(f"f{k + 1} [N]" for k in range(3)), *(f"v{k + 1} [m/s]" for k in range(4))])
    np.savetxt(tmp_path / "run.csv", np.vstack([u, y]).T, delimiter=",", header=head, comments="", fmt="%.17g")
    (tmp_path / "study.toml").write_text(TABLE)
    return tmp_path


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_table_of_another_program_becomes_verified_code(table, run):
    code, _, said = run("run", "study.toml", "--out", "by-command")
    print(said[-2000:])
    assert code == 0
    summary = json.loads((table / "by-command" / "summary.json").read_text())
    assert summary["deployment"]["quiet"]["bit_exact"] is True
    assert summary["closed_loop"] == {}
    assert summary["identification"]["preferred"] is None
    page = (table / "by-command" / "report.html").read_text()
    assert not foreign_words(page)
    assert {"f2", "v4"} <= set(re.findall(r"\w+", visible(page)))
    assert "(m/s)/N" in visible(page)
    walk(load_study(table / "study.toml"), table / "by-python", table, say=print)
    again = json.loads((table / "by-python" / "summary.json").read_text())
    for one in (summary, again):
        one["deployment"]["quiet"].pop("seconds", None)
    assert again == summary
    by_hand(table, summary)
    by_commands(table, run)


def by_commands(table, run):
    """The same walk by one command a stage: the same law to the bit, and code that was proved."""
    wires = ("--rate", "2000", "--inputs", "f1,f2,f3", "--outputs", "v1,v2,v3,v4")
    model = ("--method", "subspace", "--order", "8", "--hold-out", "0", "--out", "plant.h5")
    u = uq.files.read_record(table / "run.csv", 2000.0, ["f1", "f2", "f3"], ["v1", "v2", "v3", "v4"]).inputs
    limits = ",".join(repr(float(size)) for size in np.abs(u).max(axis=1))
    code = ("--plant", "plant.h5", "--limits", limits, "--steps", "2000", "--target", "none", "--out", "by-stages")
    for words in (
        ("identify", "run.csv", *wires, *model),
        ("design", "plant.h5", "--method", "lqg", "--out", "law.h5"),
        ("deploy", "law.h5", *code),
    ):
        ended, out, said = run(*words)
        print(out[-600:], said[-300:])
        assert ended in ((0, 1) if words[0] == "identify" else (0,))  # a model that is not white is used all the same
    law, stored = (uq.files.load(table / place) for place in ("law.h5", "by-command/controllers/quiet.h5"))
    for name in "ABCD":
        assert np.array_equal(getattr(law, name), getattr(stored, name)), name
    assert "All bits of 2000 steps" in out
    assert "v4 (m/s)" in out


def by_hand(table, summary):
    """The same walk by the functions of the package alone: the same law, and code that does what it does."""
    channels = ["f1", "f2", "f3"], ["v1", "v2", "v3", "v4"]
    record = uq.files.read_record(table / "run.csv", 2000.0, *channels)
    plant = uq.identify.Subspace(order=8).identify(record).state_space()
    law = uq.design.Lqg().design(plant).controller
    stored = uq.files.load(table / "by-command" / "controllers" / "quiet.h5")
    print("law by Python", law.hash, "by the command line", stored.hash)
    for name in "ABCD":
        assert np.array_equal(getattr(law, name), getattr(stored, name)), name
    largest = np.abs(record.inputs).max(axis=1)
    limits = np.column_stack([-largest, largest])
    code = uq.deploy.generate(law, table / "by-hand", "float32", limits_v=limits, plant=plant)
    verified = code.verify(steps=2000, fuzz_steps=0)
    print(verified.status)
    assert verified.status.ok
    assert code.tables["bit_exact"] is summary["deployment"]["quiet"]["bit_exact"] is True


def test_without_a_bench_nothing_that_one_measures_is_asked(table):
    text = TABLE + '[requirements]\nlaw = "quiet"\nattenuation_db = 10.0\n'
    (table / "study.toml").write_text(text)
    with pytest.raises(StudyError, match="no bench, so nothing measures it"):
        load_study(table / "study.toml")


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_python_function_walks_the_whole_study(masses, run):
    code, _, said = run("run", "study.toml", "--out", "out")
    print(said[-2000:])
    assert code == 0
    summary = json.loads((masses / "out" / "summary.json").read_text())
    loop = summary["closed_loop"]["quiet"]["bench"]
    print({key: loop[key] for key in ("status", "band_hz", "worst_direction_band_db", "peak_amplification_db")})
    assert loop["stable"]
    assert set(loop["tones"]) == {"11"}
    assert summary["deployment"]["quiet"]["bit_exact"] is True
    page = (masses / "out" / "report.html").read_text()
    assert not foreign_words(page)
    assert "left force" in visible(page)
    assert "(m/s)/N" in visible(page)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_publication_of_another_bench_says_what_its_own_table_says(masses, run):
    """Figures, equations, bands and processors of a publication stand in its table of the study file alone."""
    asked = '[paper]\nstructure = "arx"\norder = 4\nrecords = ["rough"]\nfigures = { bode = "plate 7" }\n[plant]'
    (masses / "study.toml").write_text(STUDY.replace("[plant]", asked, 1))
    code, _, said = run("run", "study.toml", "--out", "out", "--quick")
    print(said[-2000:])
    assert code == 0
    page = visible((masses / "out" / "report.html").read_text())
    print(*re.findall(r"[^.]*[Pp]aper[^.]*\.", page), sep="\n")
    assert "Paper: plate 7." in page
    assert not re.findall(r"Figs?\. \d|eq\. \(|C31|as the paper counts|the physics", page, re.IGNORECASE)


WRONG = {
    "no such file": ("two_masses.py:make_bench", "three_masses.py:make_bench", "no file"),
    "no such function": (":make_bench", ":make_bank", "no callable 'make_bank'"),
    "another argument": ("noise = 1e-4", "noize = 1e-4", "noize"),
    "no bench at all": ("two_masses.py:make_bench", "two_masses.py:turn", "angle"),
    "no callable": ("two_masses.py:make_bench", "two_masses.py", "FILE.py:CALLABLE"),
    "both": ('object = "two', 'method = "hexapod"\nobject = "two', "not both"),
    "a unit it does not have": ("[closed_loop]", '[closed_loop]\nunits = ["ground"]', "knows no units"),
    "no list": ('list = "list.toml"', "", "names no 'list'"),
    "records of one actuator each": ("\nperiod_samples = 1000", "", "these are 2 records (sines-1, sines-2)"),
    "a period without responses": (
        'method = "rational"',
        'method = "subspace"',
        "leave 'period_samples' away",
    ),
    "a period too long for its records": (
        "\nperiod_samples = 1000",
        "\nperiod_samples = 2000",
        "'sines' is 3000 samples long; a response takes three periods, one to settle",
    ),
    "a tone too fast": ("[11.0]", "[260.0]", "half the bench's rate"),
    "files and a list": ("[experiment]", '[records]\nfiles = ["run.csv"]\n[experiment]', "leave one"),
}


@pytest.mark.parametrize("mistake", WRONG)
def test_a_mistake_is_named_before_anything_starts(mistake, masses, run):
    old, new, named = WRONG[mistake]
    assert old in STUDY
    (masses / "study.toml").write_text(STUDY.replace(old, new))
    code, _, said = run("run", "study.toml", "--out", "out")
    print(said)
    assert code == 2
    assert named in said
    assert "Traceback" not in said
    assert not (masses / "out").exists()


def test_what_a_bench_s_file_raises_is_told(masses, run):
    (masses / "two_masses.py").write_text("import nowhere_to_be_found\n")
    code, _, said = run("run", "study.toml", "--out", "out")
    assert code == 2
    assert "nowhere_to_be_found" in said
    (masses / "two_masses.py").write_text("def make_bench(noise, seed):\n    return noise\n")
    code, _, said = run("run", "study.toml", "--out", "out")
    print(said)
    assert code == 2
    assert "float without rate_hz, actuators, sensors, run" in said


def test_the_older_keys_of_a_paper_still_stand(masses):
    older = 'paper_order = 3\npaper_structure = "arx"\npaper_records = ["rough"]\n[plant]'
    (masses / "study.toml").write_text(STUDY.replace("[plant]", older, 1))
    paper = load_study(masses / "study.toml").paper
    assert (paper.order, paper.structure, paper.records) == (3, "arx", ["rough"])


def test_the_older_name_of_an_amplitude_still_stands(masses):
    (masses / "study.toml").write_text(STUDY.replace("[closed_loop]", "[closed_loop]\namplitude_v = 0.5"))
    assert load_study(masses / "study.toml").closed_loop.amplitude == 0.5
