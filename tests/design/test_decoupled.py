"""Decoupled designs against the full one: small, and as good where the symmetry holds."""

import numpy as np
import pytest
from named_plants import bench_like, sensitivity_db

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.design import BandAttenuation, Decoupled, threefold
from ultraquiet.testing.problems import damped_plant
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import append, gain, series


@pytest.fixture(scope="module")
def ground():
    return uq.bench.Hexapod(unit="ground").linear_model()


@pytest.mark.parametrize("unit", ["ground", "flight"])
def test_threefold_splits_the_hexapod(unit):
    plant = uq.bench.Hexapod(unit=unit).linear_model()
    T = threefold()
    H = np.einsum("ji,jkf,kl->ilf", T, plant.frequency_response(np.geomspace(5, 300, 40)), T)
    inside = np.zeros((6, 6), dtype=bool)
    for block in ([0], [1], [2, 3], [4, 5]):
        inside[np.ix_(block, block)] = True
    left = np.abs(H[~inside]).max() / np.abs(H).max()
    twice = np.abs(H[2:4, 2:4] - H[4:6, 4:6]).max() / np.abs(H).max()
    print(f"{unit}: outside the blocks {left:.1e}, between the two 2x2 {twice:.1e}")
    assert left < 1e-9
    assert twice < 1e-9


def test_the_hexapod_is_split_by_its_response_as_by_its_symmetry(ground):
    """Two singular values that coincide leave axes open: rounding, which each BLAS does its own way, may not choose."""
    result = Decoupled(method="lqg", band_hz=(10.0, 100.0)).design(ground)
    print(f"blocks {result.details['blocks']}, residue {result.details['residue']:.1e}, {result.status}")
    assert sorted(map(len, result.details["blocks"])) == [1, 1, 2, 2]
    assert result.details["residue"] < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("transform", ["threefold", "data"])
def test_decoupled_is_a_check_on_the_full_design(ground, transform):
    asked = {"band_hz": (9.0, 108.0), "height": 12.0, "order": 4}
    small = Decoupled(transform, band_hz=(10.0, 100.0), settings=asked).design(ground)
    full = BandAttenuation(**asked).design(ground)
    band = np.geomspace(10, 100, 300)
    worst = [-sensitivity_db(ground, r.controller, band).max() for r in (small, full)]
    print(
        f"{transform}: {worst[0]:.2f} dB at {small.peak_sensitivity_db:.2f} dB of peak, gamma {small.gamma:.4f}; full "
        f"{worst[1]:.2f} dB at {full.peak_sensitivity_db:.2f} dB, gamma {full.gamma:.4f}"
    )
    assert small.status.ok, small.status
    assert small.details["residue"] < 1e-6
    # the norm of the whole is the greatest of the blocks
    assert small.gamma == pytest.approx(full.gamma, rel=0.01)
    assert worst[0] == pytest.approx(worst[1], abs=1.0)
    assert small.details["attenuation_db"] == pytest.approx(worst[0], abs=0.05)


@pytest.mark.slow
def test_equal_blocks_share_their_law(ground):
    result = Decoupled(transform="threefold", settings={"band_hz": (9.0, 108.0), "height": 12.0}).design(ground)
    loops = result.details["loops"]
    assert loops[2] is loops[3]


def test_a_hidden_transform_is_found(rng):
    T = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    parts = [
        StateSpace([[a]], [[1 - a]], [[g]], [[0.0]], rate_hz=3500.0) for a, g in ((0.9, 1.0), (0.95, 3.0), (0.8, 0.3))
    ]
    plant = series(series(gain(T.T, 3500.0), append(*parts)), gain(T, 3500.0))
    result = Decoupled(settings={"band_hz": (9.0, 108.0), "height": 12.0}).design(plant)
    print(f"residue {result.details['residue']:.1e}, blocks {result.details['blocks']}")
    assert result.status.ok, result.status
    assert len(result.details["blocks"]) == 3
    assert result.details["residue"] < 1e-6


@pytest.mark.gate("3867583413")
@pytest.mark.parametrize("number", [3867583413, 700242])
def test_what_does_not_split_is_designed_as_it_is(number):
    """Shapes that no axes part; and, second, a weak loop that coupling of 9.5 % of the strong one upsets."""
    result = Decoupled().design(damped_plant(number))
    margins = [f"{end.disk_all:.3f}" for end in result.margins.values()]
    print(f"blocks {result.details['blocks']}, disk margins {margins}, {result.status}")
    assert result.status.ok, result.status
    assert result.details["blocks"] == [[0, 1]]
    for T in result.details["transform"]:
        np.testing.assert_array_equal(T, np.eye(2))


@pytest.mark.slow
def test_residue_tells_when_no_transform_fits(rng):
    result = Decoupled(transform="svd", settings={"band_hz": (9.0, 108.0), "height": 12.0}).design(bench_like(rng, 6))
    print(f"a plant without symmetry: residue {result.details['residue']:.2f}, {result.status}")
    assert result.details["residue"] > 0.05


@pytest.mark.slow
def test_other_methods_and_bad_input(ground):
    result = Decoupled(transform="threefold", method="lqg").design(ground)
    assert result.status.ok, result.status
    with pytest.raises(InputError, match="six struts"):
        Decoupled(transform="threefold").design(
            append(*[BandAttenuation(band_hz=(9.0, 108.0), height=12.0).weights(ground)["performance"]] * 2)
        )
    with pytest.raises(InputError, match="orthonormal"):
        Decoupled(transform=((1.0, 1.0), (0.0, 1.0))).design(ground)
    with pytest.raises(InputError, match="no setting 'wrong'"):
        Decoupled(settings={"wrong": 1.0}).design(ground)
    with pytest.raises(InputError, match="Nyquist"):
        Decoupled(band_hz=(10.0, 3000.0)).design(ground)


@pytest.mark.gate("100.0-1.01-1.0")
@pytest.mark.parametrize(("rate_hz", "pole", "unit"), [(100.0, 1.01, 1.0), (100.0, 1.0, 1e-6), (None, 1.0, 1e5)])
def test_unstable_modes_of_other_channels_are_none_of_a_channel(rng, rate_hz, pole, unit):
    """Channels of one unstable or integrating mode each, mixed: every one gets the law that it gets alone."""
    one = StateSpace([[pole]], [[0.1 if rate_hz else 1.0]], [[unit]], [[0.0]], rate_hz=rate_hz)
    T = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    three = append(one, one, one)
    mixed = StateSpace(three.A, three.B @ T.T, T @ three.C, three.D, rate_hz)
    method = Decoupled(settings={"band_hz": (1.0, 5.0)})
    alone, apart, together = (method.design(plant) for plant in (one, three, mixed))
    f = np.geomspace(0.1, 40.0, 20)
    law = alone.controller.frequency_response(f)[0, 0]
    for result in (apart, together):
        print(result.status)
        assert result.status.word == alone.status.word
        off = result.controller.frequency_response(f) - np.eye(3)[:, :, None] * law
        assert np.abs(off).max() < 1e-5 * np.abs(law).max()


def test_unstable_modes_that_differ_stay_with_their_channels(rng):
    parts = [
        StateSpace([[a]], [[0.1]], [[c]], [[0.0]], rate_hz=100.0) for a, c in ((1.02, 1.0), (1.0, 2.0), (0.9, 0.5))
    ]
    T = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    plant = series(series(gain(T.T, 100.0), append(*parts)), gain(T, 100.0))
    result = Decoupled(settings={"band_hz": (1.0, 5.0)}).design(plant)
    assert result.status.ok, result.status
    assert len(result.details["blocks"]) == 3
