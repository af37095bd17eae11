"""The gang of six against its identities and against algebra at single frequencies."""

import numpy as np
import pytest

from ultraquiet._base.errors import InputError, RateError
from ultraquiet.analyse import gang_of_four, gang_of_six, hinf_norm, peak_sensitivity
from ultraquiet.testing.problems import damped_plant, observer_law
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import gain

F_HZ = np.array([0.0, 3.0, 15.0, 40.0, 121.0, 400.0, 500.0])


def wide_loop(seed):
    """Three actuators, two sensors, direct part included."""
    rng = np.random.default_rng(seed)
    A = 0.5 * rng.standard_normal((5, 5)) / np.sqrt(5)
    B, C, D = rng.standard_normal((5, 3)), rng.standard_normal((2, 5)), 0.1 * rng.standard_normal((2, 3))
    K = StateSpace(0.3 * np.eye(2), np.eye(2), 0.02 * rng.standard_normal((3, 2)), 0.02 * np.ones((3, 2)), 1000.0)
    return StateSpace(A, B, C, D, 1000.0), K


def at(system):
    return np.moveaxis(system.frequency_response(F_HZ), 2, 0)


def test_members_are_what_their_names_say(seed):
    G, K = wide_loop(seed)
    six = gang_of_six(G, K)
    g, k = at(G), at(K)
    So, Si = np.linalg.inv(np.eye(2) - g @ k), np.linalg.inv(np.eye(3) - k @ g)
    expected = {"So": So, "To": g @ k @ So, "Si": Si, "Ti": k @ g @ Si, "KSo": k @ So, "GSi": g @ Si}
    far = {name: np.abs(at(six.members[name]) - value).max() for name, value in expected.items()}
    print(f"distance from algebra: {max(far.values()):.1e}")
    assert max(far.values()) < 1e-10


def test_identities_of_positive_feedback(seed):
    """So - To = I, Si - Ti = I, K So = Si K, G Si = So G."""
    G, K = wide_loop(seed)
    six = gang_of_six(G, K)
    np.testing.assert_allclose(at(six.So) - at(six.To), np.broadcast_to(np.eye(2), (7, 2, 2)), atol=1e-12)
    np.testing.assert_allclose(at(six.Si) - at(six.Ti), np.broadcast_to(np.eye(3), (7, 3, 3)), atol=1e-12)
    np.testing.assert_allclose(at(six.KSo), at(six.Si) @ at(K), atol=1e-12)
    np.testing.assert_allclose(at(six.GSi), at(six.So) @ at(G), atol=1e-12)


def test_peaks_are_norms_and_their_directions_are_amplified_so(seed):
    plant = damped_plant(seed)
    law = observer_law(plant)
    six = gang_of_six(plant, law)
    assert six.stable
    f, sizes = six.singular_values()
    for name, peak in six.peaks().items():
        system = six.members[name]
        assert peak.gain == pytest.approx(hinf_norm(system)[0], rel=1e-9)
        out = system.frequency_response([peak.f_hz])[:, :, 0] @ peak.inputs
        np.testing.assert_allclose(out, peak.gain * peak.outputs, rtol=1e-6, atol=1e-6 * peak.gain)
        assert sizes[name].shape == (2, f.size)
        assert sizes[name].max() <= peak.gain * (1 + 1e-6)
    assert six.peaks()["So"].gain_db == pytest.approx(peak_sensitivity(plant, law)[0], abs=1e-6)
    four = gang_of_four(plant, law)
    assert list(four) == ["S", "T", "KS", "GS"]
    assert hinf_norm(four["GS"])[0] == pytest.approx(six.peaks()["GSi"].gain)


def test_reference_through_a_prefilter(seed):
    G, K = wide_loop(seed)
    F = StateSpace([[0.8]], [[0.2]], [[1.0], [0.0], [2.0]], np.zeros((3, 1)), 1000.0)
    six = gang_of_six(G, K, F)
    g, k, fr = at(G), at(K), at(F)
    Si = np.linalg.inv(np.eye(3) - k @ g)
    np.testing.assert_allclose(at(six.members["SiF"]), Si @ fr, atol=1e-12)
    np.testing.assert_allclose(at(six.members["GSiF"]), g @ Si @ fr, atol=1e-12)
    with pytest.raises(InputError, match="the prefilter must give 3 commands"):
        gang_of_six(G, K, gain(np.eye(2), 1000.0))


def test_unstable_loops_and_loops_without_states():
    G = StateSpace([[0.9]], [[1.0]], [[1.0]], [[0.0]], rate_hz=1.0)
    six = gang_of_six(G, gain([[5.0]], 1.0))
    assert not six.stable
    assert {peak.gain for peak in six.peaks().values()} == {np.inf}
    still = gang_of_six(gain([[2.0]]), gain([[-1.5]]))
    assert still.stable
    assert still.peaks()["So"].gain == pytest.approx(0.25)
    assert still.singular_values([1.0])[1]["KSo"][0, 0] == pytest.approx(0.375)


def test_what_does_not_fit_is_refused():
    G = gain([[1.0, 2.0]], 10.0)
    with pytest.raises(InputError, match="must take 1 outputs and give 2 commands"):
        gang_of_six(G, gain([[1.0, 2.0]], 10.0))
    with pytest.raises(RateError):
        gang_of_four(G, gain([[1.0], [2.0]], 20.0))
    with pytest.raises(InputError, match="not well posed"):
        gang_of_four(gain([[1.0]]), gain([[1.0]]))
