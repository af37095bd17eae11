"""What a study refuses before anything moves, and which records it takes for its own."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet import pipeline
from ultraquiet._base.errors import InputError
from ultraquiet.pipeline import preflight
from ultraquiet.pipeline.stage import Cache, Outcome
from ultraquiet.pipeline.store import entry as entries
from ultraquiet.pipeline.store.contents import hashes_of
from ultraquiet.pipeline.store.sources import Sources, list_of, sources
from ultraquiet.pipeline.study import StudyError, parse
from ultraquiet.pipeline.tables.blending import with_matrices
from ultraquiet.pipeline.walk import _located, walk

SUITE = (Path(pipeline.__file__).parent / "suite.toml").read_text()
LIST = """
[[commands]]
do = "excite"
name = "push"
signal = { method = "chirp" }
samples = 500
actuator = 1
"""
WRONG = {
    "unit": ('units = ["ground", "flight"]', 'units = ["moon"]', "'moon'"),
    "falling band": ("band_hz = [10.0, 100.0]", "band_hz = [100.0, 10.0]", "band_hz"),
    "tone": ("tones_hz = [5.0, 25.0, 100.0]\namplitude", "tones_hz = [5000.0]\namplitude", "5000 Hz"),
    "records": ('records = "noise"', 'records = "nosie"', "'nosie'"),
    "held out": ('held_out = "judge"', 'held_out = "jugde"', "'jugde'"),
    "judged by what was fitted": (
        'held_out = "judge"',
        'held_out = "noise"',
        "fitted to 'noise-1', which cannot judge",
    ),
    "simulated records": ('simulated = ["step", "tone"]', 'simulated = ["step", "tnoe"]', "no record 'tnoe'"),
    "paper's records": ('["chirp", "noise", "prbs"]', '["chrip"]', "'chrip'"),
    "plant's records": ('["lowest", "low", "high"]', '["loewst"]', "'loewst'"),
    "structure": ('["arx", "armax", "output-error", "box-jenkins"]', '["rational"]', "'rational'"),
    "paper's structure": ('structure = "box-jenkins"', 'structure = "box-jenkin"', "'box-jenkin'"),
    "a path for a name": ("controllers.lqg-ltr", 'controllers."../../x"', "../../x"),
}


@pytest.mark.parametrize("culprit", WRONG)
def test_a_mistake_stops_the_study_before_it_begins(culprit, tmp_path):
    old, new, named = WRONG[culprit]
    assert old in SUITE
    (tmp_path / "study.toml").write_text(SUITE.replace(old, new))
    with pytest.raises(StudyError) as refused:
        walk(pipeline.load_study(tmp_path / "study.toml"), tmp_path / "out", say=lambda _: None)
    print(refused.value)
    line = SUITE[: SUITE.index(old)].count("\n") + 1
    assert any(named in sentence for at, sentence in refused.value.mistakes if at == line)
    assert all(at == line for at, _ in refused.value.mistakes)
    assert not (tmp_path / "out").exists()


MANY = """\
[study]
title = "many"
sede = 3

[bench]
method = "hexapodd"

[identify]
structures = ["arx", "rational"]
paper_structure = 5

[plant]
method = "rational"
records = ["low"]
period = 7000

[controllers.one.design]
method = "mixed-sensitivity"
form = "five-block"
tilt = 2
peak_db = "high"
[controllers.one.reduce]
method = "closed-loop-weighted"
states = 2.5
[controllers.two]
design = "lqg"

[closed_loop]
tones_hz = [5.0, -5.0]
band_hz = [
  100.0,
  10.0,
]
[closed_lop]
"""


def test_every_mistake_of_a_study_has_its_line():
    with pytest.raises(StudyError) as refused:
        parse(MANY)
    print(refused.value)
    expected = {
        3: "no key 'sede' here; did you mean 'seed'? Known are title, seed",
        6: "no method 'hexapodd'; did you mean 'hexapod'?",
        9: "'rational' is no polynomial structure",
        10: "'structure' should be a valid string, got 5",
        15: "identify 'rational' has no setting 'period'",
        19: "'form' must be one of",
        20: "design 'mixed-sensitivity' has no setting 'tilt'",
        21: "no setting 'peak_db'",
        24: "reduce 'closed-loop-weighted': 'states' should be a valid integer",
        26: "'design' must be a table, got 'lqg'",
        29: "'tones_hz[1]' should be greater than 0, got -5.0",
        30: "'band_hz' is [100.0, 10.0]; the band must rise",
        34: "no key 'closed_lop' here; did you mean 'closed_loop'?",
    }
    mistakes = dict(refused.value.mistakes)
    for line, words in expected.items():
        assert words in mistakes[line], (line, mistakes.get(line))
    assert set(mistakes) == set(expected)


@pytest.mark.parametrize(("text", "line"), [("a = 1\nb = \n", 2), ("[study]\ntitle = 1.e\n", 2)])
def test_a_study_that_is_no_toml_says_where(text, line):
    with pytest.raises(StudyError, match="not TOML") as refused:
        parse(text)
    assert [at for at, _ in refused.value.mistakes] == [line]


def test_report_finds_the_list_that_stands_beside_the_study(tmp_path):
    (tmp_path / "mine.toml").write_text(LIST)
    (tmp_path / "study.toml").write_text(SUITE.replace('list = "suite"', 'list = "mine.toml"'))
    left = _located(pipeline.load_study(tmp_path / "study.toml"), tmp_path).model_dump_json()
    (tmp_path / "study.json").write_text(left)
    again = pipeline.reload_study(tmp_path)
    assert Path(list_of(again, tmp_path / "out")) == tmp_path / "mine.toml"


def test_report_finds_the_matrices_that_stand_beside_the_study(tmp_path):
    (tmp_path / "Ts.csv").write_text("0.5,0.5\n")
    blending = '[blending]\nsensors = "Ts.csv"\nactuators = [[1.0], [2.0]]\nnames = ["heave"]\n'
    (tmp_path / "study.toml").write_text(SUITE + blending)
    (tmp_path / "out").mkdir()
    left = _located(pipeline.load_study(tmp_path / "study.toml"), tmp_path).model_dump_json()
    (tmp_path / "out" / "study.json").write_text(left)
    read = with_matrices(pipeline.reload_study(tmp_path / "out").blending, tmp_path / "out")
    assert (read.sensors, read.actuators) == ([[0.5, 0.5]], [[1.0], [2.0]])


@pytest.mark.parametrize("path", ["../outside.h5", "models/../../outside.h5", "{absolute}", "models/link.h5", "", 3])
def test_a_stage_reads_back_nothing_from_outside_its_folder(path, tmp_path):
    folder, outside = tmp_path / "out", tmp_path / "outside.h5"
    record = uq.Record([[1.0, 0.0]], [[0.1, 0.3]], rate_hz=3500.0)
    uq.files.save(uq.Record([[9.0, 9.0]], [[9.0, 9.0]], rate_hz=3500.0), outside)
    cache, computed = Cache(folder), []

    def compute():
        computed.append(1)
        return Outcome({"plant": record}, {})

    def take():
        return cache.stage("plant", "models", "key", compute)

    take(), take()
    assert len(computed) == 1
    (folder / "models" / "link.h5").symlink_to(outside)
    # Whole and sealed, as nobody writes it by accident.
    entry = entries.read(folder, "plant")
    named = str(outside) if path == "{absolute}" else path
    entry = replace(entry, values={"plant": named}, left={named: hashes_of(outside)})
    entries.path_of(folder, "plant").write_bytes(entries.sealed(entry))
    assert take().values["plant"].hash == record.hash
    assert len(computed) == 2
    assert uq.files.load(outside).outputs.max() == 9.0


def test_a_bench_seen_through_another_is_as_its_units():
    ground = uq.bench.Hexapod(unit="ground", seed=1)
    slow = uq.bench.Decimated(ground, uq.values.Decimation(2))
    assert preflight.units_of(pipeline.study.ClosedLoop(), slow) == ("ground",)
    flown = preflight.as_unit(slow, "flight")
    assert (flown.bench.unit, flown.decimation, slow.bench.unit) == ("flight", slow.decimation, "ground")
    with pytest.raises(InputError, match="moon"):
        preflight.as_unit(slow, "moon")


def test_a_bench_that_is_called_a_unit_is_its_own_and_no_other():
    class Named:
        unit = "left"

    bench = Named()
    assert preflight.units_of(pipeline.study.ClosedLoop(), bench) == ("left",)
    assert preflight.as_unit(bench, "left") is bench
    with pytest.raises(InputError, match="none is 'right'"):
        preflight.as_unit(bench, "right")


DESIGNS = {
    'method = "decoupled"': True,
    'method = "band-attenuation"': False,
    'method = "band-attenuation"\npeak_db = 6.0': True,
    'method = "fixed-structure"': False,
    'method = "fixed-structure"\nstructure = "repeated"': True,
    'method = "lead-lag"': True,
    'method = "peak-bounded"\nstructure = "decentralised"': True,
    'method = "lqg"': False,
}


@pytest.mark.parametrize("table", DESIGNS)
def test_a_design_for_square_plants_is_refused_before_another_is_measured(table):
    """Each as its `design` refuses it, of one record and three outputs."""
    given = '[study]\ntitle = "wide"\nseed = 1\n[records]\nfiles = ["a.csv"]\n[plant]\nmethod = "subspace"\n'
    text = f'{given}records = ["a"]\n[controllers.one.design]\n{table}\n'
    study = parse(text)
    wide = uq.Record(np.zeros((3, 10)), np.zeros((2, 10)), 500.0)
    if not DESIGNS[table]:
        preflight.check(study, None, ["a"], seen=wide)
        return
    with pytest.raises(StudyError) as refused:
        preflight.check(study, None, ["a"], seen=wide)
    print(refused.value)
    (line, sentence), *_ = refused.value.mistakes
    assert line == text[: text.index(table)].count("\n") + 1
    assert "takes a square plant, here are" in sentence
    plant = uq.StateSpace([[0.5]], np.ones((1, 2)), np.ones((3, 1)), np.zeros((3, 2)), 500.0)
    with pytest.raises(InputError, match=r"square|as many outputs as inputs"):
        study.controllers["one"].design.make("design").design(plant)


def test_a_blending_that_does_not_fit_is_refused_with_its_line_and_in_the_words_of_its_table(tmp_path):
    uq.files.save(uq.Record(np.ones((2, 50)), np.ones((2, 50)), 500.0), tmp_path / "a.h5")
    text = (
        '[study]\ntitle = "b"\nseed = 1\n[records]\nfiles = ["a.h5"]\n[plant]\nmethod = "subspace"\nrecords = ["a"]\n'
    )
    text += '[controllers.one.design]\nmethod = "lqg"\n'
    text += "[blending]\nsensors = [[1.0, 2.0, 3.0]]\n"
    (tmp_path / "study.toml").write_text(text)
    with pytest.raises(StudyError) as refused:
        walk(pipeline.load_study(tmp_path / "study.toml"), tmp_path / "out", tmp_path, say=lambda _: None)
    ((line, sentence),) = refused.value.mistakes
    print(sentence)
    assert line == text.count("\n")
    assert "blending: 'sensors' must be (modes, sensors), (1, 2) here, got (1, 3)" in sentence
    assert not (tmp_path / "out").exists()


BESIDE = """
[study]
title = "files beside a bench"
[bench]
object = "bench.py:make"
[records]
files = ["run.csv"]
{more}
[plant]
method = "subspace"
order = 2
records = ["run"]
[controllers.k.design]
method = "lqg"
"""
BENCH = """
import numpy as np, ultraquiet as uq
def make():
    names = [[f"{{side}} {{k}}" for k in range(1, n + 1)] for side, n in (("force", {nu}), ("speed", {ny}))]
    return uq.bench.Wrapped(lambda u, d: np.zeros({ny}), lambda: None, 1000.0, *names)
"""


def beside_a_bench(folder: Path, ny: int, nu: int, more: str, columns: list[str]) -> Sources:
    """What a study takes its records from whose file has these columns; the bench has forces and speeds in order."""
    (folder / "bench.py").write_text(BENCH.format(ny=ny, nu=nu))
    rows = np.random.default_rng(1).standard_normal((50, len(columns)))
    np.savetxt(folder / "run.csv", rows, delimiter=",", header=",".join(columns), comments="")
    (folder / "study.toml").write_text(BESIDE.format(more=more))
    study = pipeline.load_study(folder / "study.toml")
    mistakes = study.mistakes()
    found = sources(study, folder, mistakes)
    preflight.check(study, found.bench, found.names, found.listed, found.seen, mistakes)
    return found


def sides(ny: int, nu: int, turned: str = "") -> str:
    """Both sides of a table of records, one of them from its last name to its first."""
    names = {"inputs": [f"force {k + 1}" for k in range(nu)], "outputs": [f"speed {k + 1}" for k in range(ny)]}
    return "\n".join(f"{key} = {each[::-1] if key == turned else each}" for key, each in names.items())


SIZES = [(1, 1), (4, 3), (3, 5)]


@pytest.mark.parametrize(("ny", "nu"), SIZES)
def test_files_of_the_channels_and_the_rate_of_the_bench_are_taken(ny, nu, tmp_path):
    columns = [f"force {k + 1}" for k in range(nu)][::-1] + [f"speed {k + 1}" for k in range(ny)][::-1]
    found = beside_a_bench(tmp_path, ny, nu, f"rate_hz = 1000.0\n{sides(ny, nu)}", columns)
    assert found.said == ()


@pytest.mark.parametrize(("ny", "nu"), SIZES)
def test_files_of_another_rate_than_the_bench_are_refused(ny, nu, tmp_path):
    columns = [f"force {k + 1}" for k in range(nu)] + [f"speed {k + 1}" for k in range(ny)]
    with pytest.raises(StudyError) as refused:
        beside_a_bench(tmp_path, ny, nu, f"rate_hz = 2000.0\n{sides(ny, nu)}", columns)
    ((line, sentence),) = refused.value.mistakes
    assert line == BESIDE[: BESIDE.index("{more}")].count("\n") + 1
    assert "'run' is sampled at 2000 Hz but the bench is sampled at 1000 Hz" in sentence


@pytest.mark.parametrize(
    ("ny", "nu", "key"), [(4, 3, "inputs"), (4, 3, "outputs"), (3, 5, "inputs"), (3, 5, "outputs")]
)
def test_channels_of_the_bench_in_another_order_are_refused(ny, nu, key, tmp_path):
    columns = [f"force {k + 1}" for k in range(nu)] + [f"speed {k + 1}" for k in range(ny)]
    with pytest.raises(StudyError) as refused:
        beside_a_bench(tmp_path, ny, nu, f"rate_hz = 1000.0\n{sides(ny, nu, key)}", columns)
    ((line, sentence),) = refused.value.mistakes
    text = (tmp_path / "study.toml").read_text()
    assert line == text[: text.index(f"{key} =")].count("\n") + 1
    last, of = (f"force {nu}", "actuator") if key == "inputs" else (f"speed {ny}", "sensor")
    n = nu if key == "inputs" else ny
    assert f"'{last}' is {key[:-1]} 1 of 'run' and {of} {n} of the bench" in sentence
    assert f"name '{key}' in the order of the bench, {last[:-1]}1, " in sentence


def test_channels_of_other_names_are_taken_for_those_in_their_places_and_said(tmp_path):
    more = 'rate_hz = 1000.0\ninputs = ["force 1"]\noutputs = ["a", "speed 2"]'
    found = beside_a_bench(tmp_path, 2, 1, more, ["force 1", "a", "speed 2"])
    assert found.said == ("the bench's sensors speed 1, speed 2 are taken for a, speed 2 of the files",)
