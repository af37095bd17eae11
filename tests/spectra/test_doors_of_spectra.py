"""Every verb that takes records or responses refuses anything else in a sentence with its own name."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError

RECORD = uq.Record(*np.random.default_rng(1).standard_normal((2, 2, 2000)), rate_hz=1000.0)
RESPONSE = uq.spectra.frf(RECORD)
DOORS = {
    "transmissibility": lambda given: uq.spectra.transmissibility(given, [0], [1]),
    "frf": uq.spectra.frf,
    "coherence": uq.spectra.coherence,
    "cross_spectra": uq.spectra.cross_spectra,
    "psd": uq.spectra.psd,
    "filtered_levels": uq.spectra.filtered_levels,
    "local_polynomial": uq.spectra.local_polynomial,
    "best_linear": lambda given: uq.spectra.best_linear(given, 100),
    "periodic_response": lambda given: uq.spectra.periodic_response(given, 100),
    "convert_response": lambda given: uq.spectra.convert_response(given, "velocity", "displacement"),
    "convert_spectrum": lambda given: uq.spectra.convert_spectrum(given, "velocity", "displacement"),
    "with_coherence_variance": lambda given: uq.spectra.with_coherence_variance(given, 10.0),
    "magnitude_error": lambda given: uq.spectra.magnitude_error(given, 10.0),
    "band_levels": uq.spectra.band_levels,
    "classify": uq.spectra.classify,
    "criteria": uq.spectra.criterion,
}
WRONG = [None, 3, "record", [None], {}, float("nan"), [RECORD, None]]


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("value", WRONG, ids=repr)
def test_what_is_no_record_and_no_response_is_refused_in_a_sentence(door, value):
    with pytest.raises(InputError) as refused:
        DOORS[door](value)
    print(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("side", ["base", "payload"])
@pytest.mark.parametrize("value", [None, float("nan"), RECORD, 2, True, [True], "roof", [0, None]], ids=repr)
def test_what_names_no_sensor_is_refused_by_its_side(side, value):
    with pytest.raises(InputError, match=f"^transmissibility: '{side}' names sensor .*; known are output 1, output 2"):
        uq.spectra.transmissibility(RECORD, **{"base": [0], "payload": [1], side: value})


@pytest.mark.parametrize("degrees", [None, "many", [1.0], 0.0, -1.0, float("nan")])
def test_degrees_of_freedom_are_a_number_above_zero(degrees):
    with pytest.raises(InputError, match=r"^magnitude_error: 'degrees' must be"):
        uq.spectra.magnitude_error(RESPONSE, degrees)


def test_one_record_stands_for_a_list_of_one_period():
    u = np.tile(RECORD.inputs[0, :100], 5)
    record = uq.Record(u, 2.0 * u, rate_hz=1000.0)
    one, listed = (uq.spectra.periodic_response(given, 100) for given in (record, [record]))
    np.testing.assert_array_equal(one.values, listed.values)
