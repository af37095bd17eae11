"""Frequency responses of other programs."""

import numpy as np
import pytest

from ultraquiet import files
from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.values import Channel, FrequencyResponse


def response(rng, f, ny=3, nu=2, coherence=True):
    values = rng.standard_normal((ny, nu, f.size)) + 1j * rng.standard_normal((ny, nu, f.size))
    quality = rng.uniform(0, 1, (ny, nu, f.size)) if coherence else None
    inputs, outputs = (
        [Channel(f"strut {k}", "V") for k in range(nu)],
        [Channel(f"платформа {k}", "µm") for k in range(ny)],
    )
    return FrequencyResponse(f, values, quality, "H1, hann, 8 averages", inputs, outputs)


GRIDS = {
    "even": np.arange(0, 200) * 0.5,
    "uneven": np.geomspace(1, 1000, 77),
    "a step of many digits": np.arange(1, 300) / 7,
}


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("text", [False, True])
def test_universal_files_there_and_back(tmp_path, rng, grid, text):
    sent = response(rng, GRIDS[grid], coherence=grid != "uneven")
    back = files.read_frf(files.export_frf(sent, tmp_path / "a.uff", text=text))
    # Text keeps twelve digits of the values, and six of an uneven grid.
    np.testing.assert_allclose(back.values, sent.values, rtol=1e-11 if text else 0)
    np.testing.assert_allclose(back.f_hz, sent.f_hz, rtol=5e-6 if text else 1e-14)
    assert (back.actuators, back.sensors, back.estimator) == (sent.actuators, sent.sensors, sent.estimator)
    if sent.coherence is None:
        assert back.coherence is None
    else:
        np.testing.assert_allclose(back.coherence, sent.coherence, rtol=1e-11 if text else 0)


def test_responses_that_lack_something(tmp_path, rng):
    whole = files.export_frf(response(rng, GRIDS["even"], coherence=False), tmp_path / "a.uff").read_bytes()
    ends = [k for k in range(len(whole)) if whole.startswith(b"    -1\n", k)][1::2]
    (tmp_path / "b.uff").write_bytes(whole[: ends[-2] + 7])
    with pytest.raises(InputError, match="lacks the response of"):
        files.read_frf(tmp_path / "b.uff")
    (tmp_path / "c.uff").write_bytes(whole[: ends[-1] - 9])
    with pytest.raises(StorageError, match="cut short"):
        files.read_frf(tmp_path / "c.uff")
    with pytest.raises(InputError, match="holds no signal"):
        files.read_record(tmp_path / "a.uff")
    np.savez(tmp_path / "d.npz", x=1.0)
    with pytest.raises(InputError, match="would take f with values"):
        files.read_frf(tmp_path / "d.npz")
    np.savez(tmp_path / "e.npz", f=np.arange(3.0), csd=np.ones((2, 4)), psd_exc=np.ones(3))
    with pytest.raises(InputError, match="for 3 frequencies"):
        files.read_frf(tmp_path / "e.npz")
    with pytest.raises(InputError, match="none of the suffixes"):
        files.read_frf(tmp_path / "f.csv")
    bad = FrequencyResponse([1.0, 2.0], [[[np.nan, 1.0]]])
    with pytest.raises(InputError, match="not finite"):
        files.export_frf(bad, tmp_path / "g.uff")
    with pytest.raises(InputError, match="two frequencies or more"):
        files.export_frf(FrequencyResponse([1.0], [[[1.0]]]), tmp_path / "g.uff")


def test_npz_of_a_matrix(tmp_path, rng):
    sent = response(rng, GRIDS["even"])
    np.savez(tmp_path / "a.npz", f_hz=sent.f_hz, values=sent.values, coherence=sent.coherence)
    back = files.read_frf(tmp_path / "a.npz")
    assert np.array_equal(back.values, sent.values)
    assert np.array_equal(back.coherence, sent.coherence)
