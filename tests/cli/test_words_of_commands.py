"""What commands print for a reader: no field name, no constant of Python, no change by less than zero."""

import re

import numpy as np
import pytest

import ultraquiet as uq
from raw_words import raw_words

RATE = 1000.0


@pytest.fixture
def files(tmp_path):
    """A plant, a law that makes its band louder, one that quietens it, and a record, none of them with a unit."""
    G = uq.StateSpace([[0.9, 0.1], [-0.1, 0.9]], [[0.0], [0.1]], [[1.0, 0.0]], [[0.0]], rate_hz=RATE)
    for name, gain in (("louder", 0.3), ("quieter", -0.3)):
        law = uq.StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[gain]], rate_hz=RATE)
        uq.files.save(law, tmp_path / f"{name}.h5")
    uq.files.save(G, tmp_path / "plant.h5")
    u = np.random.default_rng(1).standard_normal((1, 2000))
    uq.files.save(uq.Record(u, G.simulate(u), rate_hz=RATE), tmp_path / "run.h5")


COMMANDS = {
    "inspect": "inspect run.h5",
    "analyse louder": "analyse plant.h5 louder.h5 --band 1 5",
    "analyse quieter": "analyse plant.h5 quieter.h5 --band 1 5",
    "tones": "simulate louder.h5 --plant plant.h5 --tones 5 --duration 2",
    "word lengths": "deploy quieter.h5 --word-lengths --plant plant.h5",
    "records": "records .",
}


@pytest.mark.parametrize("words", COMMANDS.values(), ids=COMMANDS)
def test_a_reader_meets_words(files, run, words):
    _, out, said = run(*words.split())
    print(out, said)
    assert out.strip()
    assert raw_words(out + said) == []


def test_a_louder_band_is_called_so(files, run):
    assert "amplification of the worst direction" in run("analyse", "plant.h5", "louder.h5", "--band", "1", "5")[1]
    assert "attenuation of the worst direction" in run("analyse", "plant.h5", "quieter.h5", "--band", "1", "5")[1]


def test_settings_are_listed_as_they_are_typed(run):
    """Names of settings are what `--set` takes; their values are those of a study file, none where data decide."""
    out = run("methods")[1]
    assert "tune=false" in out
    assert not re.findall(r"=(?:True|False|None)\b", out)
