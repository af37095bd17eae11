"""Natural mistakes at the command line and in study files: named, with what would do, and nothing is touched."""

import json
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

import ultraquiet as uq

RATE = 1000.0
SUITE = (Path(uq.__file__).parent / "pipeline" / "suite.toml").read_text()
OF_FILES = """[study]
title = "mine"
[records]
files = ["run.csv"]
[plant]
method = "subspace"
order = 2
[controllers.quiet.design]
method = "lqg"
[deploy]
limits = 5.0
"""


def law(nu, ny, rate_hz=RATE):
    return uq.StateSpace([[0.5]], 0.1 * np.ones((1, ny)), -0.1 * np.ones((nu, 1)), np.zeros((nu, ny)), rate_hz)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """What a user has around: records, plants, laws, files of other kinds, and some that are dear to somebody."""
    tmp_path = tmp_path_factory.mktemp("made")
    rng = np.random.default_rng(1)
    u = rng.standard_normal((1, 600))
    plant = uq.StateSpace([[0.8]], [[0.5]], [[1.0]], [[0.0]], RATE)
    y = plant.simulate(u) + 0.01 * rng.standard_normal((1, 600))
    wide = uq.StateSpace([[0.8]], np.ones((1, 2)), np.ones((3, 1)), np.zeros((3, 2)), RATE)
    values = {
        "record": uq.Record(u, y, RATE), "slow-record": uq.Record(u, y, 500.0), "plant": plant, "wide-plant": wide,
        "designed": uq.design.Lqg().design(wide).controller, "law": law(1, 1),
        "wide-law": law(2, 3), "slow-law": law(1, 1, 500.0),
        "still": uq.Record(np.zeros((1, 600)), y, RATE),
    }  # fmt: skip
    for name, value in values.items():
        uq.files.save(value, tmp_path / f"{name}.h5")
    table = np.column_stack([np.arange(600) / RATE, u[0], y[0]])
    for name, rows, head in (
        ("run", table, "time,u,y"),
        ("norate", table[:, 1:], "u,y"),
        ("plain", table, "a,force,b"),
    ):
        np.savetxt(tmp_path / f"{name}.csv", rows, delimiter=",", header=head, comments="")
    lines = (tmp_path / "run.csv").read_text().splitlines()
    cells = lines[5].split(",")
    for name, rows in (
        ("ragged", [*lines[:5], ",".join(cells[:2]), *lines[6:]]),
        ("backward", [*lines[:5], "0.5," + ",".join(cells[1:]), *lines[6:]]),
        ("lone", lines[:2]),
        ("sheet", [*lines[:5], f"{cells[0]},#N/A,{cells[2]}", *lines[6:]]),
        ("gap", [*lines[:5], f"{cells[0]},,{cells[2]}", *lines[6:]]),
    ):
        (tmp_path / f"{name}.csv").write_text("\n".join(rows) + "\n")
    (tmp_path / "notes.txt").write_text("Nothing but words.\n")
    for name in ("mine.h5", "mine.svg", "mine.csv", "mine.fmu"):
        (tmp_path / name).write_bytes(b"mine")
    (tmp_path / "study.toml").write_text(SUITE)
    (tmp_path / "files.toml").write_text(OF_FILES)
    (tmp_path / "list.toml").write_text('[[commands]]\ndo = "record"\nname = "noise"\nseconds = 1.0\n')
    return tmp_path


@pytest.fixture
def folder(made, tmp_path):
    return shutil.copytree(made, tmp_path, dirs_exist_ok=True)


# Words of the command line -> what the answer names: the culprit first, then what would do.
IDENTIFY = "identify record.h5 --method arx --order 2"
LOOP = "simulate law.h5 --plant plant.h5"
COMMANDS = {
    "identfy record.h5": ("identfy", "identify"),
    "identify record.h5 --mehtod arx": ("--mehtod", "--method"),
    "identify": ("record", "-h"),
    "identify absent.h5": ("absent.h5", "no such file"),
    "identify record.h5 --method box-jenkin": ("box-jenkin", "box-jenkins"),
    "identify record.h5 --method arx --order five": ("five", "auto"),
    "identify record.h5 --method arx --order 0": ("'order'", "between 1 and 30"),
    "identify record.h5 --method arx --order 500": ("'order'", "between 1 and 30"),
    "identify record.h5 --method impulse --order auto": ("impulse", "leave --order away"),
    "identify record.h5 --method recursive-arx --order auto": ("recursive-arx", "a number"),
    f"{IDENTIFY} --set dleay=1": ("dleay", "delay"),
    f"{IDENTIFY} --set delay": ("'delay'", "key=value"),
    f"{IDENTIFY} --hold-out 1.5": ("hold-out", "0.9"),
    f"{IDENTIFY} --out model.txt": ("model.txt", ".h5"),
    f"{IDENTIFY} --out mine.h5": ("mine.h5", "--force"),
    f"{IDENTIFY} --out nowhere/m.h5": ("nowhere", "make it"),
    "identify run.csv --method arx --rate 500": ("500 Hz", "1000 Hz", "away"),
    "identify norate.csv --method arx": ("norate.csv", "--rate"),
    "identify norate.csv --method arx --rate -5": ("rate", "above zero"),
    "identify plain.csv --method arx --rate 1000": ("plain.csv", "inputs"),
    "identify plain.csv --method arx --rate 1000 --inputs forse --outputs b": ("forse", "force"),
    "identify plain.csv --method arx --rate 1000 --inputs a b --outputs c": ("--inputs", "separated by commas"),
    "identify plant.h5 --method arx": ("plant.h5", "record"),
    "identify still.h5 --method arx": ("input 1", "constant"),
    "identify notes.txt --method arx --rate 1000": ("notes.txt", "numbers"),
    "identify . --method arx": ("'.'", "a folder"),
    "identify record.h5 --method lqg": ("'lqg'", "one of design", "arx"),
    "identify ragged.csv --method arx": ("ragged.csv", "columns changed from 3 to 2"),
    "identify backward.csv --method arx": ("backward.csv", "at sample 5", "--rate"),
    "identify lone.csv --method arx": ("lone.csv", "single sample"),
    "identify sheet.csv --method arx": ("sheet.csv", "'#N/A'", "line 6", "column 2", "'u'", "write a number there"),
    "identify gap.csv --method arx": ("gap.csv", "'u'", "1 NaN", "line 6", "empty cell"),
    "inspect sheet.csv": ("sheet.csv", "'#N/A'", "line 6", "column 2"),
    "run run.csv": ("run.csv", "a record of measurements", "`ultraquiet identify`", "[records]"),
    "run run.csv --quick": ("run.csv", "a record of measurements", "`ultraquiet identify`"),
    "run record.h5": ("record.h5", "a record of measurements", "`ultraquiet identify`"),
    "run plant.h5": ("plant.h5", "StateSpace", "`ultraquiet design`"),
    "run list.toml": ("list.toml", "an experiment list", "`ultraquiet experiment`"),
    "experiment run.csv": ("run.csv", "a record of measurements", "list of commands"),
    "experiment study.toml": ("study.toml", "a study", "`ultraquiet run`"),
    "simulate law.h5 --bench run.csv": ("run.csv", "a record of measurements", "a study"),
    "identify run.csv --inputs u --outputs u --method arx": ("'u'", "go in and to come out"),
    "design run.csv": ("run.csv", "`identify`"),
    "deploy run.csv": ("run.csv", "`design`"),
    "validate run.csv plant.h5": ("run.csv", "`identify`"),
    f"{LOOP} --duration 1e12": ("--duration", "at most"),
    "deploy law.h5 --steps 100000000000": ("steps", "10000000"),
    "campaign files.toml --benches 3": ("campaign", "no bench"),
    "validate record.h5 record.h5": ("Record", "model"),
    "validate plant.h5 slow-record.h5": ("1000 Hz", "500 Hz"),
    "design record.h5": ("Record", "model"),
    "design plant.h5 --method lqgg": ("lqgg", "lqg"),
    "design plant.h5 --method lqg --set band_hz=[100,10]": ("band_hz", "rising"),
    "design plant.h5 --method lqg --set band_hz=[10,900]": ("900", "500 Hz"),
    "design plant.h5 --method lqg --out K.mat": ("K.mat", ".h5"),
    "design plant.h5 --method lqg --out mine.h5": ("mine.h5", "--force"),
    "design plant.h5 --method resonators --set tones_hz=50": ("tones_hz", "list in brackets", "[50]"),
    "design plant.h5 --method loop-shaping --set height=-1": ("height", "above zero"),
    "design . --method lqg": ("'.'", "a folder"),
    "analyse plant.h5": ("law", "-h"),
    "analyse designed.h5 wide-plant.h5": ("designed.h5", "PLANT comes first"),
    "analyse plant.h5 wide-law.h5": ("takes 3", "1 readings"),
    "analyse plant.h5 slow-law.h5": ("500 Hz", "1000 Hz"),
    "analyse plant.h5 record.h5": ("record.h5", "design"),
    "analyse plant.h5 law.h5 --band 50 10": ("band_hz", "rising"),
    "analyse plant.h5 law.h5 --band 10": ("--band", "2"),
    "analyse plant.h5 law.h5 --out f --format jpg": ("jpg", "png"),
    "analyse plant.h5 law.h5 --disk-margin 3": ("disk_margin", "2"),
    "analyse plant.h5 law.h5 --out mine.h5": ("mine.h5", "--out"),
    "simulate law.h5": ("neither", "--bench", "--plant"),
    f"{LOOP} --bench study.toml": ("both", "--bench", "--plant"),
    f"{LOOP} --unit flight": ("flight", "--bench"),
    f"{LOOP} --tones 5,a": ("5,a", "20,47.5"),
    f"{LOOP} --tones 700": ("700", "500 Hz"),
    f"{LOOP} --tones 5 --duration 0.1": ("tones_hz", "20"),
    f"{LOOP} --amplitude 0": ("--amplitude", "above zero"),
    "simulate slow-law.h5 --plant plant.h5": ("500 Hz", "1000 Hz"),
    "simulate law.h5 --plant record.h5": ("record.h5", "identify"),
    "simulate law.h5 --bench study.toml": ("1000 Hz", "3500 Hz"),
    "spectra record.h5 --show densty": ("densty", "density"),
    "spectra record.h5 --out mine.svg": ("mine.svg", "--force"),
    "spectra record.h5 --out picture.jpg": ("picture.jpg", ".svg"),
    "spectra record.h5 --window hannn": ("hannn", "window"),
    "spectra record.h5 --show response --estimator H3": ("H3", "H1"),
    "deploy record.h5": ("record.h5", "design"),
    "deploy law.h5 --precision float16": ("float16", "float32", "q31"),
    "deploy law.h5 --form diagonal": ("diagonal", "modal"),
    "deploy law.h5 --target cortex-m9": ("cortex-m9", "cortex-m7"),
    "deploy law.h5 --fmu law.zip": ("law.zip", ".fmu"),
    "deploy law.h5 --export law.xls": ("law.xls", ".mat"),
    "deploy law.h5 --fmu mine.fmu": ("mine.fmu", "--fmu", "--force"),
    "deploy law.h5 --export mine.csv": ("mine.csv", "--export", "--force"),
    "deploy law.h5 --project .": ("'.'", "did not write", "another folder"),
    "deploy wide-law.h5 --limits 1,2,3": ("--limits", "1,2,3", "LOW:HIGH"),
    "deploy law.h5 --limits -3": ("--limits", "above zero", "'-3'"),
    "deploy wide-law.h5 --limits=-20,20": ("--limits", "above zero", "LOW:HIGH"),
    "deploy law.h5 --limits 5V": ("--limits", "5V"),
    "deploy law.h5 --range 5": ("--range", "float32"),
    "deploy law.h5 --precision q31 --range -5": ("--range", "above zero"),
    "deploy law.h5 --out .": ("'.'", "did not write", "another folder"),
    "deploy law.h5 --out mine.csv": ("mine.csv", "--out", "a file"),
    "deploy law.h5 --out code --project code/around": ("code/around", "code", "in each other"),
    "deploy law.h5 --out around/code --project around": ("around/code", "in each other"),
    "deploy law.h5 --project mine.csv": ("mine.csv", "--project"),
    "convert record.h5 record.xyz": ("xyz", ".csv"),
    "convert record.h5 mine.csv": ("mine.csv", "--force"),
    "convert record.h5 nowhere/x.csv": ("nowhere", "make it"),
    "report nowhere": ("nowhere", "run --out"),
    "inspect plant.h5": ("plant.h5", "record"),
    "methods cooking": ("cooking", "design"),
    "records nowhere": ("nowhere", "folder"),
    "records --since tomorrow": ("tomorrow", "2"),
    "experiment absent.toml": ("absent.toml", "no such file"),
    "demo --seed -1": ("seed", "at least 0"),
    "report .": ("'.'", "study"),
    "run absent.toml": ("absent.toml", "no such file"),
    "run notes.txt": ("notes.txt", "line 1"),
    "run study.toml --out mine.h5": ("mine.h5", "--out"),
    "run files.toml --out ''": ("'--out'", "given nothing"),
    "run files.toml --out=": ("'--out'", "given nothing"),
    "run ''": ("argument 1", "given nothing"),
    "run .": ("'.'", "is a directory"),
    "report ''": ("argument 1", "given nothing"),
    "identify '' --method arx": ("argument 1", "given nothing"),
    f"{IDENTIFY} --out ''": ("'--out'", "given nothing"),
    f"{IDENTIFY} --order ''": ("'--order'", "given nothing"),
    "design plant.h5 --out ''": ("'--out'", "given nothing"),
    "design plant.h5 --method lqg --set band_hz=[nan,10]": ("band_hz", "NaN"),
    "design plant.h5 --method lqg --set control_hz=-5": ("Lqg: 'control_hz'", "above zero", "got -5"),
    "deploy law.h5 --out ''": ("'--out'", "given nothing"),
    "convert record.h5 ''": ("argument 2", "given nothing"),
    "convert run.csv run.csv --force": ("run.csv", "the file that is read", "another name"),
    "convert run.csv ./run.csv --force": ("run.csv", "the file that is read", "another name"),
    "design plant.h5 --method lqg --set control_weight=1,5": ("control_weight=1,5", "=1.5", "[1,5]"),
    "design plant.h5 --method lqg --set =3": ("'=3'", "key=value"),
    "design plant.h5 --set disk_margin=0.2 --set disk-margin=0.3": ("disk_margin", "twice", "leave one"),
    "design plant.h5 --method filtered-x": ("'input 1'", "'limit'", "the largest command"),
    "design plant.h5 --method filtered-x --set limit=-1": ("'limit'", "above zero"),
    "design wide-plant.h5 --method decoupled": ("3 outputs and 2 inputs", "square", "blend", "'lqg'"),
    "report study.toml": ("study.toml", "is a file", "the folder"),
    "serve record.h5 --no-open": ("record.h5", "is a file", "the folder of a study"),
    "serve --port 99999": ("port", "65535"),
    "identify record.h5 --method arx --order 2,4": ("2,4", "a whole number or 'auto'"),
    "identify run.csv --method arx --rate 1kHz": ("--rate", "number"),
    "spectra norate.csv": ("norate.csv", "--rate"),
    "spectra record.h5 --segment 100000": ("100000", "600", "shorten"),
    "simulate plant.h5 --plant wide-law.h5": ("3 inputs and 2 outputs", "takes 1"),
    "analyse plant.h5 law.h5 --band 10 900": ("900 Hz", "500 Hz", "lower"),
    "campaign study.toml --benches 0": ("--benches", "1"),
    "records --status finishd": ("finishd", "DONE"),
}  # fmt: skip

UNITS = '["ground", "flight"]\n'
TONES = f"{UNITS}tones_hz = [5.0, 25.0, 100.0]"
# What is written in the study -> what was written in its place, and what the answer names, its line first.
STUDIES = {
    "a seed below zero": ("seed = 1", "seed = -1", ("seed", "0")),
    "a bench misspelt": ('"hexapod"', '"hexapodd"', ("hexapodd", "hexapod")),
    "a unit nobody has": ('unit = "ground"', 'unit = "moon"', ("moon", "flight")),
    "a unit of the loop nobody has": ('["ground", "flight"]', '["ground", "moon"]', ("moon", "flight")),
    "a setting of the bench misspelt": ('unit = "ground"', 'untit = "ground"', ("untit", "unit")),
    "a table misspelt": ("[closed_loop] ", "[closed_lop] ", ("closed_lop", "closed_loop")),
    "a key misspelt": ("held_out =", "hold_out =", ("hold_out", "held_out")),
    "a structure misspelt": ('"armax"', '"armx"', ("armx", "armax")),
    "no orders": ("orders = [2, 4, 5, 6, 8]", "orders = []", ("orders", "1")),
    "an order of nothing": ("orders = [2,", "orders = [0,", ("orders", "1")),
    "a group of records nobody leaves": ('records = "noise"', 'records = "nois"', ("nois", "noise")),
    "a list that is not there": ('list = "suite"', 'list = "my.toml"', ("my.toml",)),
    "a period that is no number": ("period_samples = 7000", 'period_samples = "7k"', ("period_samples", "integer")),
    "a period that the list contradicts": ("period_samples = 7000", "period_samples = 6900", ("6900", "7000")),
    "a level beyond the actuators": ("amplitude = 1.0 ", "amplitude = 500.0 ", ("amplitude", "500", "ask less")),
    "a number where a list belongs": (TONES, f"{UNITS}tones_hz = 5.0", ("tones_hz", "list in brackets", "[5.0]")),
    "a decimal comma": ("band_hz = [10.0, 100.0]", "band_hz = [10,0, 100,0]", ("band_hz", "at most 2")),
    "a design misspelt": ('method = "lqg"', 'method = "lgq"', ("lgq", "lqg")),
    "a setting of a design misspelt": ("control_weight =", "control_wieght =", ("control_wieght", "control_weight")),
    "a band that falls": ("band_hz = [10.0, 100.0]", "band_hz = [100.0, 10.0]", ("band", "rise")),
    "a tone below zero": (TONES, f"{UNITS}tones_hz = [-5.0]", ("tones_hz", "greater than 0")),
    "a tone beyond Nyquist": (TONES, f"{UNITS}tones_hz = [9e3]", ("9000", "1750")),
    "a precision nobody knows": ('precision = "float32"', 'precision = "float16"', ("precision", "float32")),
    "a law nobody designs": ('law = "quiet"', 'law = "quit"', ("quit", "quiet")),
    "a requirement nobody measures": ("peak_db = 6.0", "payload_force_db = 6.0", ("payload_force_db",)),
    "a name that is no file's": ("[controllers.lqg-ltr.design]", '[controllers."a/b".design]', ("a/b", "letters")),
    "a bracket forgotten": ("[study]", "[study", ("line", "study.toml")),
    "a text without quotes": ('unit = "ground"', "unit = ground", ("line 10", "study.toml")),
    "a design forgotten": ("[controllers.lqg-ltr.design]", "[controllers.lqg-ltr.desing]", ("desing", "design")),
}  # fmt: skip


def state_of(folder):
    return {
        path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*") if "sqlite" not in path.name
    }


def graded(run, folder, words, named):
    """Run the words; the answer must name all of `named`, the exit code be 2, and the folder as it was."""
    before = state_of(folder)
    code, out, err = run(*words)
    said = " ".join(err.split())
    print(code, said)
    missed = [word for word in named if word not in said]
    assert not missed, f"not named: {missed}"
    assert code == 2
    assert "Traceback" not in said
    assert "Errno" not in said
    assert out == ""
    assert state_of(folder) == before


@pytest.mark.parametrize("words", COMMANDS)
def test_a_mistake_at_the_command_line(run, folder, words):
    graded(run, folder, shlex.split(words), COMMANDS[words])


@pytest.mark.parametrize("mistake", STUDIES)
def test_a_mistake_in_a_study_file(run, folder, monkeypatch, mistake):
    def started(*_, **__):
        pytest.fail("the study was started")

    monkeypatch.setattr("ultraquiet.experiments.run", started)
    right, wrong, named = STUDIES[mistake]
    assert right in SUITE
    (folder / "study.toml").write_text(SUITE.replace(right, wrong, 1))
    graded(run, folder, ("run", "study.toml"), named)


LQG, END = 'method = "lqg"', "limits = 5.0"
# What is written in a study of files, likewise.
FILES = {
    "a file that is none": ("run.csv", "rum.csv", ("rum.csv", "no such file")),
    "one file without brackets": ('["run.csv"]', '"run.csv"', ("one mistake", "list in brackets", '["run.csv"]')),
    "limits below zero": ("limits = 5.0", "limits = -5.0", ("one mistake", "'limits'", "greater than 0")),
    "a limit of a list below zero": ("limits = 5.0", "limits = [-5.0]", ("one mistake", "'limits", "greater than 0")),
    "limits in words": ("limits = 5.0", 'limits = "5 V"', ("'limits'", "number")),
    "records of another name": ("order = 2", 'order = 2\nrecords = ["ran"]', ("ran", "run")),
    "a design without its table": ("quiet.design]", "quiet]", ("'design' is missing", "known are design")),
    "an order that is a fraction": ("order = 2", "order = 2.5", ("'order'", "integer")),
    "an order without end": ("order = 2", "order = inf", ("'order'", "finite")),
    "a column that is none": ('["run.csv"]', '["run.csv"]\ninputs = ["w"]\noutputs = ["y"]', ("'w'", "u (600)")),
    "a rate that the clock contradicts": ('["run.csv"]', '["run.csv"]\nrate_hz = 500.0', ("500 Hz", "1000 Hz", "away")),
    "in and out": ('["run.csv"]', '["run.csv"]\ninputs = ["u"]\noutputs = ["u"]', ("'u'", "name every column once")),
    "a band of NaN": (LQG, f"{LQG}\nband_hz = [nan, 50.0]", ("line 10", "'band_hz'", "NaN")),
    "a band of a design that falls": (LQG, f"{LQG}\nband_hz = [50.0, 10.0]", ("line 10", "'band_hz'", "rising")),
    "a band of one number": (LQG, f"{LQG}\nband_hz = [50.0]", ("line 10", "'band_hz[1]' is missing")),
    "a band from below zero": (LQG, f"{LQG}\nband_hz = [-5.0, 50.0]", ("line 10", "'band_hz'", "below zero")),
    "a band without end": (LQG, f"{LQG}\nband_hz = [5.0, inf]", ("line 10", "'band_hz'", "finite")),
    "a band beyond Nyquist": (LQG, f"{LQG}\nband_hz = [5.0, 600.0]", ("line 10", "600 Hz", "500 Hz")),
    "a band of words": (LQG, f'{LQG}\nband_hz = "low"', ("line 10", "'band_hz'")),
    "a corner below zero": (LQG, f"{LQG}\nintegral_hz = -1.0", ("line 10", "'integral_hz'", "below zero")),
    "a corner of NaN": (LQG, f"{LQG}\nintegral_hz = nan", ("line 10", "'integral_hz'", "NaN")),
    "a tone of a design beyond Nyquist": (LQG, 'method = "resonators"\ntones_hz = [5, 700.0]', ("700 Hz", "500 Hz")),
    "a tone of a design that is NaN": (LQG, 'method = "resonators"\ntones_hz = [nan]', ("line 10", "tones_hz")),
    "a weight of NaN": (LQG, f"{LQG}\ncontrol_weight = nan", ("line 10", "control_weight")),
    "the bands of the limits beyond Nyquist": (END, f"{END}\n[limits]\nbands_hz = [[5, 600]]", ("line 13", "500 Hz")),
    "a limit of the price without end": (END, f"{END}\n[limits]\npeak_db = inf", ("line 13", "'peak_db'", "finite")),
    "limits without end": (END, "limits = inf", ("line 11", "'limits'", "finite")),
    "a loop beyond Nyquist": (END, f"{END}\n[closed_loop]\nband_hz = [5, 600]", ("line 13", "600 Hz", "500 Hz")),
    "a tone without end": (END, f"{END}\n[closed_loop]\ntones_hz = [inf]", ("line 13", "'tones_hz[0]'", "finite")),
    "a validation beyond Nyquist": (END, f"{END}\n[validate]\nband_hz = [5, 600]", ("line 13", "600 Hz", "500 Hz")),
    "a requirement of NaN": (END, f'{END}\n[requirements]\nlaw = "quiet"\ndisk_margin = nan', ("line 14", "disk")),
    "a rate of NaN": ('["run.csv"]', '["run.csv"]\nrate_hz = nan', ("line 5", "'rate_hz'")),
    "a rate without end": ('["run.csv"]', '["run.csv"]\nrate_hz = inf', ("line 5", "'rate_hz'", "finite")),
    "a file without a name": ('["run.csv"]', '[""]', ("line 4", "files", "name")),
    "a file that is a folder": ('["run.csv"]', '["."]', ("a folder", "name a file")),
    "no files": ('["run.csv"]', "[]", ("line 4", "'files'", "1")),
    "the same file twice": ('["run.csv"]', '["run.csv", "run.csv"]', ("'run'", "rename")),
    "a title that is a number": ('title = "mine"', "title = 5", ("line 2", "'title'", "string")),
    "a control rate of nothing": (END, f"{END}\n[blending]\ncontrol_rate_hz = 0", ("line 13", "control_rate_hz")),
    "a blending of NaN": (END, f"{END}\n[blending]\nsensors = [[nan]]", ("line 13", "sensors")),
    "a blending whose file is none": (END, f'{END}\n[blending]\nsensors = "no.csv"', ("no.csv",)),
    "inputs alone": ('["run.csv"]', '["run.csv"]\ninputs = ["u"]', ("inputs", "outputs", "missing")),
}  # fmt: skip


@pytest.mark.parametrize("mistake", FILES)
def test_a_mistake_in_a_study_of_files(run, folder, mistake):
    right, wrong, named = FILES[mistake]
    assert right in OF_FILES
    (folder / "files.toml").write_text("\ufeff" + OF_FILES.replace(right, wrong, 1))
    graded(run, folder, ("run", "files.toml"), named)


BENCH = """import numpy as np
import ultraquiet as uq
def make(gain=1.0):
    x = [0.0]
    def step(u, d):
        y = [x[0]]
        x[0] = 0.9 * x[0] + gain * (u[0] + d[0])
        return y
    coil = uq.values.Channel("coil", "N", -5.0, 5.0)
    return uq.bench.Wrapped(step, lambda: None, 1000.0, [coil], ["gap"])
"""
# The same as a model, which runs quicker, in a file that prints.
TALKING = """import ultraquiet as uq
def make(gain=1.0):
    coil = uq.values.Channel("coil", "N", -5.0, 5.0)
    model = uq.StateSpace([[0.9]], [[gain]], [[1.0]], [[0.0]], 1000.0, actuators=[coil], sensors=["gap"])
    return uq.bench.LinearBench(model)
print("card found")
"""
LIST = """[[commands]]
do = "excite"
name = "rough"
samples = 600
signal = { method = "noise" }
"""
OF_A_BENCH = """[study]
title = "mine"
[bench]
object = "my.py:make"
[experiment]
list = "list.toml"
[plant]
method = "subspace"
records = ["rough-1"]
[controllers.quiet.design]
method = "lqg"
"""
# Which of the three files, what is written in it, in its place, and what the answer names.
BENCHES = {
    "no callable": ("study.toml", "my.py:make", "my.py", ("line 4", '"FILE.py:CALLABLE"')),
    "another file": ("study.toml", "my.py:make", "mine.py:make", ("no file", "mine.py")),
    "a callable misspelt": ("study.toml", "my.py:make", "my.py:mak", ("'mak'", "did you mean 'make'")),
    "an argument misspelt": ("study.toml", "my.py:make\"", "my.py:make\"\ngian = 2.0", ("'gian'", "gain=1.0")),
    "a bench of one only unit": ("study.toml", "[plant]", '[closed_loop]\nunits = ["flight"]\n[plant]', ("flight",)),
    "no list": ("study.toml", '[experiment]\nlist = "list.toml"\n', "", ("'list'", "beside the study")),
    "a list that is not there": ("study.toml", "list.toml", "lst.toml", ("lst.toml", "no such file")),
    "a table misspelt": ("study.toml", "[controllers.", "[controller.", ("'controller'", "did you mean 'controllers'")),
    "an import misspelt": ("my.py", "import numpy", "import numpyy", ("my.py", "line 1", "numpyy")),
    "a bracket forgotten": ("my.py", "gain=1.0)", "gain=1.0", ("my.py", "line 3")),
    "a return forgotten": ("my.py", "return uq", "uq", ("returned nothing", "'return'")),
    "a name misspelt": ("my.py", "Wrapped(step,", "Wrapped(stepp,", ("my.py", "line 10", "stepp")),
    "limits the wrong way round": ("my.py", "-5.0, 5.0", "5.0, -5.0", ("'coil'", "must be below")),
    "two sensors of one name": ("my.py", '["gap"]', '["gap", "gap"]', ("line 3", "two sensors", "'gap'", "of its own")),
    "a rate below zero": ("my.py", "1000.0", "-1000.0", ("rate_hz", "above zero")),
    "one bracket for two": ("list.toml", "[[commands]]", "[commands]", ("line 1", "two brackets", "[[commands]]")),
    "a signal in a word": ("list.toml", '{ method = "noise" }', '"noise"', ("line 5", '{ method = "noise" }')),
    "an actuator misspelt": ("list.toml", "samples", 'actuator = "coill"\nsamples', ("'coill'", "only 1 (coil)")),
    "an actuator counted from zero": ("list.toml", "samples", "actuator = 0\nsamples", ("'actuator'", "from 1")),
    "half a sample": ("list.toml", "600", "600.5", ("line 4", "'samples'", "integer")),
    "seconds for samples": ("list.toml", "samples", "seconds", ("line 4", "'seconds'", "samples")),
    "a command misspelt": ("list.toml", "excite", "excit", ("line 2", "'excit'", "did you mean 'excite'")),
    "a level beyond the actuator": ("list.toml", '"noise" }', '"noise", peak = 50 }', ("line 5", "'coil'", "lower it")),
    "a band beyond Nyquist": ("list.toml", '"noise" }', '"noise", stop_hz = 900 }', ("line 5", "900 Hz", "500 Hz")),
}  # fmt: skip


def write_study_of_a_bench(place, mistake=None):
    which, right, wrong, named = BENCHES[mistake] if mistake else ("", "", "", ())
    for name, text in (("my.py", BENCH), ("list.toml", LIST), ("study.toml", OF_A_BENCH)):
        assert name != which or right in text
        (place / name).write_text(text.replace(right, wrong, 1) if name == which else text)
    return named


@pytest.mark.parametrize("mistake", BENCHES)
def test_a_mistake_in_a_study_of_a_bench(run, tmp_path, mistake):
    graded(run, tmp_path, ("run", "study.toml"), write_study_of_a_bench(tmp_path, mistake))


def test_an_error_of_a_bench_while_it_runs_is_told_with_its_line(run, tmp_path):
    write_study_of_a_bench(tmp_path)
    (tmp_path / "study.toml").write_text(OF_A_BENCH.replace('make"\n', 'make"\ngain = "2"\n', 1))
    code, _, err = run("run", "study.toml")
    print(err)
    assert code == 2
    assert "'my.py' raised TypeError in line 7" in err
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("at", "said"), [("making", "raised SystemExit in line"), ("a sample", "bench: 'my.py' raised")]
)
def test_a_bench_that_exits_is_refused_and_does_not_end_the_command_by_itself(run, tmp_path, at, said):
    write_study_of_a_bench(tmp_path)
    text = (tmp_path / "my.py").read_text()
    first = re.search(r"def make.*\n" if at == "making" else r"def step.*\n", text)
    indent = re.match(r" *", text[first.end() :])[0]
    (tmp_path / "my.py").write_text(f"{text[: first.end()]}{indent}raise SystemExit(3)\n{text[first.end() :]}")
    code, _, err = run("run", "study.toml")
    print(err)
    assert code == 2
    assert said in err


def test_what_a_bench_prints_does_not_join_the_json(run, tmp_path):
    write_study_of_a_bench(tmp_path)
    (tmp_path / "my.py").write_text(TALKING)
    law = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-0.01]], 1000.0)
    uq.files.save(law, tmp_path / "law.h5")
    words = ("simulate", "law.h5", "--bench", "study.toml", "--tones", "20")
    code, out, err = run(*words, "--json")
    print(err)
    assert json.loads(out)
    assert code == 0
    assert "card found" in err
    assert run(*words, "--quiet")[1] == ""
    assert "card found" in run(*words)[1]


def test_there_are_sixty_and_more():
    print(f"{len(COMMANDS)} at the command line, {len(STUDIES) + len(FILES) + len(BENCHES)} in study files")
    assert len(COMMANDS) + len(STUDIES) >= 60
