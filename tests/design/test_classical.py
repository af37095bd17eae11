"""Lead-lag, notch, skyhook and modal control: the formulas as they stand, and all against one specification."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet.design import LeadLag, Modal, Notch, Skyhook, Specification, common_mode, worst_attenuation_db
from ultraquiet.testing import problems
from ultraquiet.values import StateSpace
from ultraquiet.values.interconnect import append, feedback

GEOPHONE = {"geophone_hz": 12.0, "geophone_zeta": 0.65}


@pytest.fixture(scope="module")
def heave():
    return common_mode(uq.bench.Hexapod(unit="ground").linear_model())


def test_lead_lag_and_notch_are_the_printed_formulas(heave):
    rate = heave.rate_hz
    law = LeadLag(
        gain=-1e-3, zeros_hz=(20.0,), poles_hz=(200.0,), notches_hz=(60.0,), notch_zetas=(0.1,), notch_widths=(0.7,)
    )
    f = np.array([1.0, 20.0, 60.0, 500.0])
    K = law.design(heave).controller.frequency_response(f)[0, 0]

    def corner(hz):  # Tustin's rule, exact at every corner: all in s = tan(pi f / rate)
        return np.tan(np.pi * hz / rate)

    s, z, p, w = 1j * corner(f), corner(20.0), corner(200.0), corner(60.0)
    wanted = -1e-3 * (1 + s / z) / (1 + s / p) * (s * s + 0.2 * w * s + w * w) / (s * s + 1.4 * w * s + w * w)
    np.testing.assert_allclose(K, wanted, rtol=1e-9)


def test_skyhook_moves_the_corner_of_the_geophone(heave):
    law = Skyhook(gain=-1e-3, actuator="force", **GEOPHONE, corrected_hz=4.0).design(heave).controller
    f = np.geomspace(0.5, 100, 30)
    rate = heave.rate_hz

    def geophone(hz, zeta):
        s, w = 1j * np.tan(np.pi * f / rate), np.tan(np.pi * hz / rate)
        return s * s / (s * s + 2 * zeta * w * s + w * w)

    np.testing.assert_allclose(
        law.frequency_response(f)[0, 0] * geophone(12.0, 0.65), -1e-3 * geophone(4.0, 0.7), rtol=1e-9
    )


def test_gain_of_each_channel_of_its_own():
    plant = problems.damped_plant(0)
    K = LeadLag(gain=(-0.01, -0.02)).design(plant).controller
    np.testing.assert_allclose(K.D, [[-0.01, 0.0], [0.0, -0.02]])


def test_a_corner_is_moved_where_there_is_one():
    plant = problems.damped_plant(0)
    plain = Skyhook(gain=-0.01, actuator="force").design(plant).controller
    assert plain.states == 0
    with pytest.raises(InputError, match="geophone"):
        Skyhook(corrected_hz=4.0)


@pytest.mark.slow
def test_tuning_serves_the_specification(heave):
    wanted = Specification(band_hz=(10.0, 100.0), attenuation_db=4.0)
    as_it_stands = Specification(band_hz=(10.0, 100.0))
    first = (
        Skyhook(low_pass_hz=250.0, **GEOPHONE, corrected_hz=5.0, specification=as_it_stands)
        .design(heave)
        .details["score"]
    )
    result = Skyhook(low_pass_hz=250.0, **GEOPHONE, corrected_hz=5.0, tune=True, specification=wanted).design(heave)
    score = result.details["score"]
    print(f"skyhook on the heave: {first.measured} as it stands, {score.measured} tuned, {result.details['values']}")
    assert result.status.ok, result.status
    assert score.met
    assert score.measured["attenuation_db"] > first.measured["attenuation_db"]


@pytest.mark.gate("method0")
@pytest.mark.parametrize("method", [LeadLag(), Notch(), Skyhook()])
def test_a_gain_is_found_for_any_damped_plant(method, seed):
    result = method.design(problems.damped_plant(seed))
    assert result.status.ok, result.status
    assert result.peak_sensitivity_db <= 8.0


def test_modal_damping_is_what_was_asked(seed):
    plant = problems.damped_plant(seed)
    result = Modal(band_hz=(10.0, 200.0), zeta=0.2).design(plant)
    assert result.status.ok, result.status
    poles = np.linalg.eigvals(feedback(plant, result.controller).A)
    # separation: the poles of A + B F are among those of the loop
    for mode in result.details["modes"]:
        s = 2 * np.pi * mode["f_hz"] * (-mode["after"] + 1j * np.sqrt(1 - mode["after"] ** 2))
        assert np.abs(poles - np.exp(s / plant.rate_hz)).min() < 1e-6
        assert mode["after"] == pytest.approx(0.2)


def test_every_mode_is_damped_by_its_own_measure_where_none_is_given(seed):
    """A damping of 0.15 for all left one of nine plants as it was, for their modes have up to 0.1: 0.5 to 0.9 dB."""
    plant = problems.damped_plant(seed)
    result = Modal().design(plant)
    print(f"{result.details['attenuation_rms_db']:.1f} dB, {result.details['modes']}")
    assert result.status.ok, result.status
    assert result.details["attenuation_rms_db"] > 2.5
    for mode in result.details["modes"]:
        assert mode["after"] == pytest.approx(max(0.15, 3 * mode["before"]))
    idle = Modal(zeta=0.06).design(plant)
    assert idle.status.word == "short"
    assert "ask for more damping by 'zeta'" in idle.status.sentence


@pytest.mark.slow
def test_modal_damps_the_bench():
    plant = uq.bench.Hexapod(unit="flight").linear_model()
    result = Modal(band_hz=(20.0, 150.0), zeta=0.2, sensor_noise=1.0).design(plant)
    found = feedback(plant, result.controller).poles()
    s = np.log(found[(np.abs(found) > 1e-3) & (found.imag > 0)]) * plant.rate_hz
    print(f"modal, flight: {len(result.details['modes'])} modes, peak {result.peak_sensitivity_db:.2f} dB")
    assert result.status.ok, result.status
    for mode in result.details["modes"]:
        w = 2 * np.pi * mode["f_hz"]
        near = s[np.abs(np.abs(s) - w) < 1e-3 * w]
        assert np.any(np.abs(-near.real / np.abs(near) - mode["after"]) < 1e-3)


def test_bad_input_is_refused(heave):
    with pytest.raises(InputError, match="Nyquist"):
        LeadLag(gain=-1.0, zeros_hz=(2000.0,), poles_hz=(10.0,)).design(heave)
    with pytest.raises(InputError, match="1 zeros and 2 poles"):
        LeadLag(zeros_hz=(1.0,), poles_hz=(2.0, 3.0)).design(heave)
    with pytest.raises(InputError, match="3 gains for 1"):
        LeadLag(gain=(1.0, 2.0, 3.0)).design(heave)
    with pytest.raises(InputError, match="as many of each"):
        Notch(notches_hz=(50.0,)).design(heave)
    with pytest.raises(InputError, match="dampings"):
        Modal(zeta=(0.1, 0.2, 0.3, 0.4)).design(problems.damped_plant(0))
    with pytest.raises(InputError, match="continuous"):
        Modal().design(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))


def collocated(modes_hz, channels, unit):
    """Velocities at the forces of hardly damped modes, each channel by itself, in continuous time."""
    w = 2 * np.pi * np.array(modes_hz)
    A = np.zeros((2 * w.size, 2 * w.size))
    for k, each in enumerate(w):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0.0, each], [-each, -2e-6 * each]]
    moves = np.tile([0.0, 1.0], w.size)
    return append(*[StateSpace(A, 20.0 * moves[:, None], unit * moves[None], [[0.0]])] * channels)


@pytest.mark.parametrize(("channels", "unit"), [(1, 1.0), (3, 1e-9)])
def test_a_needle_between_lines_of_the_band_breaks_a_specification(channels, unit):
    plant = collocated((8.0, 20.0), channels, unit)
    wanted = Specification(band_hz=(9.0, 19.0), attenuation_db=20.0, control_limit=1e9 / unit)
    found = LeadLag(gain=-1e5 / unit, specification=wanted).design(plant)
    # nothing moves between two modes, where their velocities cancel: S is one there
    silent_hz = np.sqrt((8.0**2 + 20.0**2) / 2)
    at = worst_attenuation_db(plant, found.controller, (silent_hz, silent_hz))
    assert at < 3.0
    assert worst_attenuation_db(plant, found.controller, (9.0, 19.0)) <= at
    assert found.status.word == "short"
    assert found.details["score"].shortfall["attenuation_db"] >= 20.0 - at


def test_a_needle_beyond_the_roll_off_breaks_a_specification():
    plant = collocated((8.0, 60.0), 1, 1.0)
    wanted = Specification(band_hz=(7.0, 9.0), attenuation_db=1e-3, roll_off_hz=30.0, roll_off_db=20.0)
    law = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-2e-2]])
    # |T| at the second mode, where the plant is a damper
    G = abs(plant.frequency_response([60.0])[0, 0, 0])
    assert wanted.score(plant, law).measured["roll_off_db"] == pytest.approx(
        20 * np.log10(1 + 1 / (2e-2 * G)), abs=0.01
    )
