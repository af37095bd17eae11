"""One real file of each kind that could be had: read, carried through every format, and found unchanged."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io

from ultraquiet import files
from ultraquiet.linalg.vector_fitting import fit

DATA = Path(__file__).parents[1] / "data"
read = files.read_record

# File, rate, inputs, outputs, and what it holds: MAT v5 by number and by name, plain text, MAT with an object inside.
RECORDS = {
    "steel frame": ("daisy/flexibleStructure.mat", 1024.0, "1-2", "3-30", (2, 28, 8523)),
    "hair dryer": ("hairdryer.mat", 12.5, "1", "2", (1, 1, 1000)),
    "CD player": ("daisy/CD_player_arm.dat", 2048.0, "1-2", "3-4", (2, 2, 2048)),
    "two inertias": ("two_inertia_cut.mat", None, "iq_adx", "omega_max,omega_may", (1, 2, 2500)),
}


@pytest.mark.parametrize("name", RECORDS)
def test_real_records_through_every_format(tmp_path, name):
    path, rate_hz, inputs, outputs, shape = RECORDS[name]
    record = read(DATA / path, rate_hz, inputs, outputs)
    assert (len(record.actuators), len(record.sensors), record.samples) == shape
    back = record
    for suffix in ("csv", "mat", "uff", "parquet", "h5"):
        back = read(files.export_record(back, tmp_path / f"run.{suffix}"))
        assert back.hash == record.hash, suffix
        assert [c.name for c in (*back.actuators, *back.sensors)] == [
            c.name for c in (*record.actuators, *record.sensors)
        ]
    print(f"{name}: {shape} at {record.rate_hz:g} Hz, the same bits after five formats")


def test_the_steel_frame_against_scipy():
    held = scipy.io.loadmat(DATA / "daisy/flexibleStructure.mat")["flexibleStructure"]
    record = read(DATA / "daisy/flexibleStructure.mat", 1024.0, "1-2", "3-30")
    assert np.array_equal(np.vstack([record.inputs, record.outputs]).T, held)


def test_the_cd_player_against_numpy():
    record = read(DATA / "daisy/CD_player_arm.dat", 2048.0, "1-2", "3-4")
    held = np.loadtxt(DATA / "daisy/CD_player_arm.dat")
    assert np.array_equal(np.vstack([record.inputs, record.outputs]).T, held)


def misfit(response, row):
    """Relative error of the best stable model of 20 states, over the coherent lines of one channel."""
    trusted = response.coherence[row, 0] > 0.7
    f, values = response.f_hz[trusted], response.values[row, 0, trusted]
    rate_hz, starts_hz = 40.0, np.geomspace(f[1], f[-1], 10)
    poles = np.exp(2 * np.pi / rate_hz * np.concatenate([(-0.02 + side * 1j) * starts_hz for side in (1, -1)]))
    poles = poles.reshape(2, -1).T.ravel()
    return fit(np.exp(2j * np.pi * f / rate_hz), values[None, None], 1 / np.abs(values), poles, iterations=8).error


def test_the_beam_splitter_of_kagra(tmp_path):
    """diaggui averages u y*: read so, a stable model explains the suspension; read the other way, less well."""
    path = DATA / "kagra/BS_TML_exc_20200730a_frf.npz"
    response = files.read_frf(path, conjugated=True)
    held = np.load(path)
    assert response.values.shape == (12, 1, 1281)
    assert response.actuators[0].name == "K1:VIS-BS_TM_LOCK_L_EXC"
    assert response.sensors[11].name == "K1:VIS-BS_TM_OPLEV_YAW_DIAG"
    assert np.array_equal(response.coherence[:, 0], held["coh"])
    np.testing.assert_allclose(response.values[:, 0], held["csd"].conj() / held["psd_exc"], rtol=1e-6)
    other = files.read_frf(path)
    row = 10
    right, wrong = misfit(response, row), misfit(other, row)
    print(f"{response.sensors[row].name}: a stable model misses {right:.3f}, of the conjugate {wrong:.3f}")
    assert right < 0.8 * wrong
    for suffix in ("uff", "h5"):
        back = files.read_frf(files.export_frf(response, tmp_path / f"k.{suffix}"))
        assert np.array_equal(back.values, response.values)
        assert np.array_equal(back.coherence, response.coherence)
        assert (back.actuators, back.sensors, back.estimator) == (response.actuators, response.sensors, "H1")
        np.testing.assert_allclose(back.f_hz, response.f_hz, rtol=1e-15)
