"""Models, laws and responses to MAT and back: every bit, names, units, limits; what MATLAB itself would have saved."""

import numpy as np
import pytest
import scipy.io

import ultraquiet as uq

SHAPES = [(1, 1), (4, 3), (3, 5)]


def wires(count, role):
    units = ("N", "m/s", "", "µm")
    return [uq.Channel(f"{role} {k}", units[k % 4], -float(k + 1), np.inf) for k in range(count)]


def system(rng, ny, nu, states, rate_hz):
    A, B = rng.standard_normal((states, states)), rng.standard_normal((states, nu))
    C, D = 1e-9 * rng.standard_normal((ny, states)), rng.standard_normal((ny, nu))
    return uq.StateSpace(A, B, C, D, rate_hz, wires(nu, "u"), wires(ny, "y"))


@pytest.mark.parametrize(("ny", "nu"), SHAPES)
@pytest.mark.parametrize("states", [0, 1, 5])
@pytest.mark.parametrize("rate_hz", [None, 3500.0, 1000.0 / 3])
def test_a_system_comes_back_bit_for_bit(ny, nu, states, rate_hz, tmp_path):
    G = system(np.random.default_rng(1), ny, nu, states, rate_hz)
    back = uq.files.load(uq.files.save(G, tmp_path / "law.mat"))
    assert back.hash == G.hash
    assert (back.actuators, back.sensors, back.rate_hz) == (G.actuators, G.sensors, G.rate_hz)


@pytest.mark.parametrize(("ny", "nu"), SHAPES)
@pytest.mark.parametrize("lines", [1, 6])
@pytest.mark.parametrize("quality", [False, True])
def test_a_response_comes_back_bit_for_bit(ny, nu, lines, quality, tmp_path):
    rng, shape = np.random.default_rng(2), (ny, nu, lines)
    known = (rng.uniform(size=shape), rng.uniform(size=shape)) if quality else (None, None)
    values = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    ends = wires(nu, "u"), wires(ny, "y")
    G = uq.FrequencyResponse(np.arange(1.0, lines + 1), values, known[0], "H1", *ends, variance=known[1])
    for back in (
        uq.files.load(uq.files.save(G, tmp_path / "g.mat")),
        uq.files.read_frf(uq.files.export_frf(G, tmp_path / "h.mat")),
    ):
        assert np.array_equal(back.values, G.values)
        assert np.array_equal(back.f_hz, G.f_hz)
        assert (back.actuators, back.sensors, back.estimator) == (G.actuators, G.sensors, "H1")
        assert (back.coherence is None) != quality
        assert not quality or np.array_equal(back.variance, G.variance)


def test_noise_and_records_come_back(tmp_path):
    model = uq.InnovationForm([[0.5]], [[0.5]], [[1.0]], [[0.0]], [[0.2]], [[2.0]], 10.0, ["force"], ["speed"])
    back = uq.files.load(uq.files.save(model, tmp_path / "m.mat"))
    assert isinstance(back, uq.InnovationForm)
    assert back.hash == model.hash
    record = uq.Record(np.arange(6.0).reshape(2, 3), [[0.1, 0.2, 0.3]], 10.0, ["a", "b"], ["c"])
    assert uq.files.load(uq.files.save(record, tmp_path / "r.mat")).hash == record.hash


def test_what_matlab_saves_is_read(tmp_path):
    matrices = {"A": 0.5, "B": [[1.0, 2.0]], "C": 1.0, "D": [[0.0, 0.0]], "Ts": 1 / 3500}
    scipy.io.savemat(tmp_path / "bare.mat", matrices)
    found = uq.files.load(tmp_path / "bare.mat")
    assert (found.states, found.rate_hz, found.actuators[1].name) == (1, 3500.0, "input 2")
    scipy.io.savemat(tmp_path / "struct.mat", {"K": {**matrices, "Ts": 0.0}})
    assert uq.files.load(tmp_path / "struct.mat").rate_hz is None
    response = {"ResponseData": np.ones((2, 1, 3)) * 1j, "Frequency": [1.0, 2.0, 3.0], "FrequencyUnit": "rad/s"}
    scipy.io.savemat(tmp_path / "frd.mat", response)
    assert uq.files.load(tmp_path / "frd.mat").f_hz[0] == pytest.approx(1 / (2 * np.pi), rel=1e-15)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("law.csv", r"must end in one of .h5, .hdf5, .mat.*records go there by export_record"),
        ("law.pkl", "this package does not write values so"),
        ("law", "must end in one of"),
    ],
)
def test_a_suffix_that_would_lie_is_refused(name, words, tmp_path):
    G = uq.StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]])
    with pytest.raises(uq.errors.InputError, match=words):
        uq.files.save(G, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_what_a_mat_file_cannot_hold_is_refused(tmp_path):
    one = uq.PolynomialModel(b=[[0.0, 0.5]], f=[[1.0, -0.5]], rate_hz=1.0)
    with pytest.raises(uq.errors.InputError, match=r"a MAT file takes a StateSpace .* got PolynomialModel"):
        uq.files.save(one, tmp_path / "one.mat")
    with pytest.raises(uq.errors.InputError, match="one value"):
        uq.files.save_many({"a": one}, tmp_path / "one.mat")
    scipy.io.savemat(tmp_path / "odd.mat", {"A": np.eye(2), "B": np.ones((3, 1)), "C": np.ones((1, 2)), "D": 0.0})
    with pytest.raises(uq.errors.InputError, match="do not fit together"):
        uq.files.load(tmp_path / "odd.mat")
