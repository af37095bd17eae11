"""`[blending]`: from a table of 20 accelerometers and 4 actuators, one unplugged, to a law that holds on the truth."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from table_of_accelerometers import (
    CONTROL_HZ,
    DRIVEN,
    MODES,
    RATE_HZ,
    delayed,
    drawn_bench,
    drawn_table,
    matrices,
)
from ultraquiet import analyse, experiments
from ultraquiet._base.errors import InputError
from ultraquiet.bench import Decimated, Wrapped
from ultraquiet.design import Lqg
from ultraquiet.identify import Subspace
from ultraquiet.pipeline.tables.blending import BlendingTable, blended, blended_records
from ultraquiet.signals import BandLimitedNoise
from ultraquiet.simulate import check_stability
from ultraquiet.values import Channel, Decimation, Record
from ultraquiet.values.interconnect import feedback

DEAD = 6
ORDER = 42  # 18 of the table, 4 of the amplifiers, the rest for delay, filter and the accelerometers' own poles


def table_for(p, d, **more):
    Ts, Ta = matrices(p, d)
    names = {"names": MODES, "unit": "m/s^2", "actuator_names": [f"push {MODES[k]}" for k in DRIVEN]}
    settings = {"sensors": Ts.tolist(), "actuators": Ta.tolist(), "actuator_unit": "N", "control_rate_hz": CONTROL_HZ}
    return BlendingTable(**names, **(settings | more))


def excited(bench, samples, seed, stop_hz=600.0):
    """Noise on every channel within its limits."""
    signal = BandLimitedNoise(start_hz=2, stop_hz=stop_hz, peak_v=1.0)
    rows = [
        signal.generate(samples=samples, rate_hz=bench.rate_hz, seed=10 * seed + k) for k in range(len(bench.actuators))
    ]
    return np.stack(rows) * np.array([c.high for c in bench.actuators])[:, None]


@pytest.fixture(scope="module")
def recorded(first_seed):
    truth, p, d = drawn_table(first_seed)
    bench, table = drawn_bench(truth, first_seed, DEAD), table_for(p, d)
    seen = blended(bench, table)
    return truth, bench, table, seen, {"noise": seen.run(excited(seen, 2048, first_seed))}


def test_the_dead_accelerometer_is_named_and_left_out(recorded):
    truth, bench, table, seen, records = recorded
    assert seen.rate_hz == CONTROL_HZ
    assert [c.name for c in seen.actuators] == [f"push {MODES[k]}" for k in DRIVEN]
    assert seen.sensors == bench.sensors
    study = blended_records(bench, table, records)
    print(*study.sentences, sep="\n")
    assert study.left_out == ("acc 7",)
    assert "Sensor 'acc 7' is dead" in study.sentences[0]
    record = study.records["noise"]
    assert [(c.name, c.unit) for c in record.sensors] == [(name, "m/s^2") for name in MODES]
    assert {c.unit for c in record.actuators} == {"N"}
    assert np.array_equal(record.inputs, records["noise"].inputs)
    # What the records hold is what the truth does, through the filter and without the dead one.
    blending = study.bench.bench.blending
    assert not blending.sensor_matrix[:, DEAD].any()
    exact = Decimation(4).plant(blending.plant(delayed(truth)))
    clean = exact.simulate(record.inputs)
    miss = np.std(record.outputs - clean, axis=1)
    noise = np.sqrt(np.diag(blending.noise(np.eye(20) * 2e-3**2)) * np.sum(Decimation(4).taps ** 2))
    assert np.allclose(miss, noise, rtol=0.1)
    assert study.bench.run(record.inputs[:, :64]).outputs.shape == (6, 64)
    assert study.bench.sensors == record.sensors
    assert study.bench.actuators == record.actuators


def test_records_at_the_bench_rate_come_to_the_same(recorded, first_seed):
    """Driven by hand at 8 kHz, held at 2 kHz: the same samples as through the table's own bench, but for the noise."""
    truth, bench, table, seen, records = recorded
    held = Decimation(4).held(seen.bench.blending.actuator_matrix @ records["noise"].inputs)
    raw = drawn_bench(truth, first_seed, DEAD).run(held)
    study = blended_records(bench, table, {"raw": raw})
    mine, theirs = study.records["raw"], blended_records(bench, table, records).records["noise"]
    assert study.left_out == ("acc 7",)
    assert np.allclose(mine.inputs, theirs.inputs, rtol=1e-9, atol=1e-12)
    assert np.std(mine.outputs - theirs.outputs) < 0.02 * np.std(theirs.outputs)


def test_a_list_drives_one_mode_a_record(recorded, tmp_path):
    """An experiment list on the bench in modes: each record moves one mode, the others rest to the bit."""
    _, bench, table, seen, _ = recorded
    signal = '{ method = "noise", start_hz = 2, stop_hz = 600, peak_v = 0.25 }'
    text = f'[[commands]]\ndo = "excite"\nname = "noise"\nsamples = 1024\nsignal = {signal}'
    records = experiments.run(experiments.parse(text, bench=seen), tmp_path, seen)
    study = blended_records(bench, table, records)
    assert study.left_out == ("acc 7",)
    moving = [[bool(np.ptp(u)) for u in record.inputs] for record in study.records.values()]
    assert np.array_equal(moving, np.eye(4, dtype=bool))


def test_a_saturated_accelerometer_is_named_and_left_out(recorded, first_seed):
    """Cut at 1.5 standard deviations at 8 kHz, its limits not declared."""
    truth, bench, table, seen, records = recorded
    held = Decimation(4).held(seen.bench.blending.actuator_matrix @ records["noise"].inputs)
    raw = drawn_bench(truth, first_seed, DEAD).run(held)
    y = raw.outputs.copy()
    y[3] = np.clip(y[3], -1.5 * y[3].std(), 1.5 * y[3].std())
    study = blended_records(bench, table, {"raw": Record(raw.inputs, y, RATE_HZ, raw.actuators, raw.sensors)})
    print(*study.sentences, sep="\n")
    assert study.left_out == ("acc 7", "acc 4")
    assert "'acc 4' is saturated" in study.sentences[0]


def test_a_study_may_refuse_instead(recorded):
    _, bench, table, _, records = recorded
    strict = table.model_copy(update={"dead": "refuse"})
    with pytest.raises(InputError, match=r"'acc 7' is dead.*Nothing was identified"):
        blended_records(bench, strict, records)


def test_matrices_may_stand_beside_the_study(recorded, tmp_path):
    _, bench, table, seen, _ = recorded
    np.savetxt(tmp_path / "ts.csv", np.array(table.sensors), delimiter=",", fmt="%.17g")
    np.savez(tmp_path / "ta.npz", actuators=np.array(table.actuators))
    files = table.model_copy(update={"sensors": "ts.csv", "actuators": "ta.npz"})
    beside = blended(bench, files, tmp_path)
    assert np.array_equal(beside.bench.blending.actuator_matrix, seen.bench.blending.actuator_matrix)


def test_a_dead_actuator_cannot_be_left_out(rng):
    """The records were driven with it: every mode that it has a part in did something else than asked."""
    bench = Wrapped(lambda u, d: [u[0], u[0] * 0.5], lambda: None, 100.0, ["a", "b"], ["p", "q"])
    u = rng.standard_normal((2, 2000))
    with pytest.raises(InputError, match="Actuator 'b' is dead: no sensor answers"):
        blended_records(bench, BlendingTable(), {"noise": bench.run(u)})


def test_without_a_word_nothing_is_blended(rng):
    wires = [Channel("u", "N")], [Channel("y", "m/s")]
    bench = Wrapped(lambda u, d: u, lambda: None, 100.0, *wires)
    record = bench.run(rng.standard_normal((1, 1000)))
    study = blended_records(bench, BlendingTable(), {"r": record})
    assert np.array_equal(study.records["r"].outputs, record.outputs)
    assert (study.bench.sensors, study.bench.actuators) == (bench.sensors, bench.actuators)
    assert study.sentences == ()


def test_the_table_of_the_page_is_one():
    page = (Path(__file__).parents[2] / "docs" / "blending.md").read_text()
    tables = [tomllib.loads(text) for text in re.findall(r"```toml\n(.*?)```", page, re.DOTALL)]
    table = BlendingTable.model_validate(tables[0]["blending"])
    assert (table.control_rate_hz, table.dead, len(table.names)) == (2000.0, "leave out", 6)
    assert set(BlendingTable.model_fields) - set(tables[0]["blending"]) == {"latency_samples"}


def test_mistakes_are_named(recorded, tmp_path):
    _, bench, table, _, records = recorded
    (tmp_path / "words.csv").write_text("one,two\n")
    np.savez(tmp_path / "other.npz", Ts=np.eye(2))
    wrong = [
        ({"control_rate_hz": 3000.0}, "no whole fraction of the bench's 8000 Hz; the nearest are 4000"),
        ({"latency_samples": 5}, "'latency' must be between 1 and 4"),
        ({"sensors": [[1.0], [1.0, 2.0]]}, "rows must be of one length, got rows of 1, 2"),
        ({"sensors": [[1.0, 2.0]]}, r"blending: 'sensors' must be \(modes, sensors\), \(1, 20\) here, got \(1, 2\)"),
        ({"names": ["x"]}, "1 names were given for 6 sensor modes"),
        ({"sensors": "none.csv"}, "none.csv' cannot be read"),
        ({"sensors": "words.csv"}, "no table of numbers"),
        ({"sensors": "other.npz"}, "holds no array 'sensors', only Ts"),
        ({"sensors": "other.txt"}, "must end in .csv or .npz"),
    ]
    for update, words in wrong:
        with pytest.raises(InputError, match=words):
            blended(bench, table.model_copy(update=update), tmp_path)
    with pytest.raises(ValidationError, match="extra_forbidden"):
        BlendingTable(sensor=[[1.0]])
    with pytest.raises(InputError, match="no records"):
        blended_records(bench, table, {})
    slow = records["noise"]
    with pytest.raises(InputError, match="sampled at 1000 Hz, neither the bench's 8000 Hz nor the control rate, 2000"):
        blended_records(bench, table, {"r": Record(slow.inputs, slow.outputs, 1000.0, slow.actuators, slow.sensors)})


def rms(x):
    return np.sqrt(np.mean(x**2))


@pytest.mark.slow
@pytest.mark.parametrize("draw", [1, 2, 3])
def test_from_the_table_to_a_law_that_holds_on_the_truth(draw):
    """20 accelerometers, 4 actuators, 8 kHz, one unplugged: recorded, named, blended, identified, closed at 2 kHz."""
    truth, p, d = drawn_table(draw)
    bench, table = drawn_bench(truth, draw, DEAD), table_for(p, d)
    seen = blended(bench, table)
    study = blended_records(bench, table, {"noise": seen.run(excited(seen, 8192, draw))})
    assert study.left_out == ("acc 7",)
    found = Subspace(order=ORDER).identify(study.records["noise"])
    model = found.model.state_space()
    result = Lqg().design(model)
    assert result.status.ok, result.status

    blending, decimation = study.bench.bench.blending, study.bench.decimation
    exact = decimation.plant(blending.plant(delayed(truth)))
    f = np.geomspace(4, 500, 200)
    G, seen_as = (s.frequency_response(f) for s in (exact, model))
    print(f"\nfit {found.fit_percent.min():.2f} %, response off by {np.abs(G - seen_as).max() / np.abs(G).max():.2%}")

    # Mapped back: 20 readings in, 4 voltages out, at 2 kHz; on the truth at 8 kHz it is the same loop, and stable.
    law = blending.law(result.controller)
    assert law.D.shape == (4, 20)
    loops = feedback(decimation.plant(delayed(truth)), law), feedback(exact, result.controller)
    radius = [np.abs(loop.poles()).max() for loop in loops]
    margin = analyse.disk_margin(exact, result.controller)
    print(f"largest pole on the truth {radius[0]:.6f}, in modes {radius[1]:.6f}; {margin}")
    assert max(radius) < 1

    u = excited(seen, 8192, draw + 100, stop_hz=40.0)
    push = blending.actuator_matrix @ u * 0.3
    held = Decimated(bench, decimation).on_the_bench(law)
    readings = [
        blending.sensor_matrix @ bench.run(np.zeros((4, 4 * u.shape[1])), np.repeat(push, 4, axis=1), k).outputs
        for k in (None, held)
    ]
    less = [20 * np.log10(rms(a) / rms(b)) for a, b in zip(*readings, strict=True)]
    print("accelerations of the modes at 8 kHz, 2-40 Hz disturbance, less by", np.round(less, 1), "dB")
    assert rms(readings[1]) < rms(readings[0])

    check = check_stability(study.bench, result.controller)
    print(check.status)
    assert check.status.ok
