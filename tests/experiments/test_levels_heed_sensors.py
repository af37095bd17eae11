"""A level that nobody named heeds the ranges of the sensors; where it is named, or no range stated, nothing changes."""

import numpy as np
import pytest

from ultraquiet import experiments
from ultraquiet.bench import Wrapped
from ultraquiet.experiments import journal
from ultraquiet.experiments.levels import SHORTER
from ultraquiet.values import Channel

RATE_HZ, SAMPLES = 1000.0, 4000
SIGNALS = {
    "noise": 'method = "noise"',
    "chirp": 'method = "chirp", start_hz = 5.0, stop_hz = 300.0',
    "prbs": 'method = "prbs"',
    "multisine": 'method = "multisine", start_hz = 1.0, stop_hz = 400.0, period_samples = 1000',
}
COIL = Channel("coil", "N", -50.0, 50.0)


def excite(name, signal, more=""):
    return (
        f'[[commands]]\ndo = "excite"\nname = "{name}"\nsamples = {SAMPLES}\nsignal = {{ {SIGNALS[signal]}{more} }}\n'
    )


class Structure:
    """One mode at 40 Hz from newtons to micrometres; counts its samples."""

    def __init__(self, gain, zeta=0.02, limit=100.0, offset=0.0, noise=0.01, stuck=False):
        self.gain, self.limit, self.offset, self.noise, self.stuck = gain, limit, offset, noise, stuck
        w = 2 * np.pi * 40.0 / RATE_HZ
        self.pole = np.exp(w * (-zeta + 1j * np.sqrt(1 - zeta**2)))
        self.samples = 0

    def reset(self, run_index):
        self.x, self.rng = 0j, np.random.default_rng(run_index)

    def step(self, u, d):
        self.samples += 1
        y = self.gain * self.x.imag + self.offset + self.noise * self.rng.standard_normal()
        self.x = self.pole * self.x + (u[0] + d[0]) * (1 - abs(self.pole))
        read = np.clip(y, -self.limit, self.limit)
        return [read, self.limit] if self.stuck else [read]

    def bench(self):
        gaps = [Channel("gap", "µm", -self.limit, self.limit)]
        stuck = [Channel("dead gap", "µm", -self.limit, self.limit)] * self.stuck
        return Wrapped(self.step, self.reset, RATE_HZ, [COIL], [*gaps, *stuck])


class Told(experiments.Onlooker):
    def __init__(self):
        self.said = []

    def lowers(self, sentence):
        self.said.append(sentence)


def run(structure, text, folder, **how):
    told = Told()
    bench = structure.bench()
    return experiments.run(experiments.parse(text, bench), folder, bench, onlooker=told, **how), told.said


@pytest.mark.parametrize("gain", [1e3, 1e5])
@pytest.mark.parametrize("signal", SIGNALS)
def test_a_bench_of_high_gain_clips_no_sensor(signal, gain, tmp_path):
    records, said = run(Structure(gain, offset=30.0), excite("rough", signal), tmp_path)
    record = records["rough-1"]
    used = np.abs(record.outputs[0] - 30.0).max() / 70.0
    print(f"{said}, readings use {used:.0%} of their room")
    assert not any(record.clipped())
    assert 0.02 < used < 1.0
    assert len(said) == 1
    assert "'rough-1': the level is lowered to" in said[0]
    assert "'gap' might leave its range" in said[0]
    measured = record.provenance.settings["measurement"]["excitation"][0]
    lowered = [value for key, value in measured.items() if key in ("peak_v", "level_v", "start_v")]
    assert all(value < 5.0 for value in lowered)
    assert len(lowered) == 1


@pytest.mark.parametrize("signal", ["noise", "chirp"])
def test_a_mode_that_hardly_decays_leaves_no_range_either(signal, tmp_path):
    records, _ = run(Structure(3e4, zeta=1e-4), excite("rough", signal), tmp_path)
    used = np.abs(records["rough-1"].outputs).max() / 100.0
    print(f"readings use {used:.0%} of their range")
    assert used < 1.0


def test_the_usual_bench_is_probed_for_a_sixteenth_and_left_at_its_level(tmp_path):
    structure = Structure(2.0)
    records, said = run(structure, excite("rough", "noise"), tmp_path)
    print(f"{structure.samples} samples for a record of {SAMPLES}")
    assert said == []
    assert structure.samples == SAMPLES + SAMPLES // SHORTER
    assert np.abs(records["rough-1"].inputs).max() == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("structure", "text"),
    [
        (Structure(1e5, limit=np.inf), excite("rough", "noise")),
        (Structure(1e5), excite("rough", "noise", ", peak = 5.0")),
    ],
    ids=["no range is stated", "the level is named"],
)
def test_nothing_changes_where_nothing_is_to_be_found(structure, text, tmp_path):
    records, said = run(structure, text, tmp_path)
    assert (structure.samples, said) == (SAMPLES, [])
    assert np.abs(records["rough-1"].inputs).max() == pytest.approx(5.0)


def test_a_reading_that_stands_at_its_end_at_rest_asks_for_nothing(tmp_path):
    records, said = run(Structure(2.0, stuck=True), excite("rough", "noise"), tmp_path)
    assert said == []
    assert np.abs(records["rough-1"].inputs).max() == pytest.approx(5.0)


def test_a_level_is_found_once_and_kept_for_a_resumed_list(tmp_path):
    text = '[[commands]]\ndo = "repeat"\ntimes = 2\n' + excite("rough", "noise").replace(
        "[[commands]]", "[[commands.commands]]"
    )
    structure = Structure(1e4)
    records, said = run(structure, text, tmp_path)
    probed = structure.samples - 2 * SAMPLES
    print(f"{probed} samples of probes; {said}")
    assert len(said) == 1
    assert len(set(journal.shares(tmp_path).values())) == 1
    (tmp_path / "rough-1-r2.h5").unlink()
    before = structure.samples
    again, said = run(structure, text, tmp_path, resume=True, repeat=["rough-1-r2"])
    assert structure.samples - before == SAMPLES
    assert said == []
    assert again["rough-1-r2"].hash == records["rough-1-r2"].hash
    # the measurement is still the one that the list plans
    planned = {m.name: m.hash for m in experiments.parse(text, structure.bench()).measurements}
    assert again["rough-1-r2"].provenance.settings["measurement_hash"] == planned["rough-1-r2"]
