"""Slips of a caller: one record stands for a list of one, anything else of another kind is refused in one sentence."""

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError

idn = uq.identify
OE = idn.OutputError(order=1)
METHODS = [
    OE,
    idn.Subspace(order=2),
    idn.PredictorSubspace(order=2),
    idn.Rational(order=2),
    idn.WeightedRational(order=2),
    idn.RegularisedArx(),
    idn.ImpulseResponse(),
    idn.RecursiveArx(order=1),
]


def lag():
    u, e = np.random.default_rng(1).standard_normal((2, 1000))
    return uq.Record(u, np.convolve(u, [0.0, 1.0, 0.5])[:1000] + 0.1 * e, 10.0)


@pytest.mark.parametrize("method", METHODS, ids=lambda m: type(m).__name__)
def test_what_is_no_record_is_named(method):
    response = uq.spectra.frf(lag(), segment_samples=128)
    for wrong, kind in ((None, "NoneType"), (response, "FrequencyResponse"), ([None], "a list of NoneType")):
        with pytest.raises(InputError, match=f"{type(method).__name__}: 'record' must be a Record.*, got {kind}"):
            method.identify(wrong)


@pytest.mark.parametrize(
    "method", [idn.Rational(order=2), idn.WeightedRational(order=2)], ids=lambda m: type(m).__name__
)
def test_what_is_no_response_is_named(method):
    with pytest.raises(InputError, match="'response' must be a FrequencyResponse, got Record"):
        method.identify_response(lag(), 10.0)


def test_one_record_stands_for_a_list_of_one():
    record = lag()
    assert idn.identify_joint(OE, record).fit_percent == idn.identify_joint(OE, [record]).fit_percent
    assert idn.identify_matrix(OE, record).fit_percent == idn.identify_matrix(OE, [record]).fit_percent
    assert idn.channel_health(record).ok
    assert idn.sweep(record, structures=OE, orders=[2]).preferred.method.order == 2


SLIPS = {
    "joint": (lambda: idn.identify_joint(idn.Subspace(), lag()), "identify_joint: 'method' must be .* got Subspace"),
    "matrix": (lambda: idn.identify_matrix(idn.Subspace(), lag()), "identify_matrix: 'method' must be .* got Subspace"),
    "nothing": (lambda: idn.identify_matrix(OE, None), "'records' must be a list of Record, got NoneType"),
    "orders": (lambda: idn.sweep(lag(), orders=2), "sweep: 'orders' must be a list of whole numbers, got 2"),
    "structure": (lambda: idn.sweep(lag(), structures=[idn.Subspace()]), "'Subspace' is no polynomial structure"),
    "workers": (lambda: idn.sweep(lag(), structures=[OE], orders=[1], workers=-1), "'workers' must be at least 0"),
    "workers of a joint fit": (lambda: idn.identify_joint(OE, lag(), workers=-1), "'workers' must be at least 0"),
    "no responses": (lambda: idn.fold([]), "no responses were given"),
    "rate": (lambda: idn.Rational().identify_response(uq.spectra.frf(lag()), None), "'rate_hz' must be a number"),
    "start": (lambda: OE.identify(lag(), start="x"), "OutputError: 'start' must be a PolynomialMatrix .* got str"),
}


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_is_refused_in_one_sentence(slip):
    call, sentence = SLIPS[slip]
    with pytest.raises(InputError, match=sentence):
        call()


@pytest.mark.parametrize(
    ("make", "setting", "value"),
    [
        *((idn.OutputError, "delay", value) for value in (None, ())),
        *((idn.OutputError, "horizons", value) for value in (None, 40, ())),
        *((idn.OutputError, "known_poles", value) for value in (None, 0.5, ["a"])),
        *((idn.OutputError, "fixed", value) for value in ([1], "c")),
        *((idn.OutputError, "offset", value) for value in (None, "x")),
        (idn.OutputError, "b_order", ()),
        *((idn.Subspace, name, 3) for name in ("offset", "refine", "weighted", "feedthrough")),
        *((idn.PredictorSubspace, name, "x") for name in ("offset", "refine", "weighted", "feedthrough", "stable")),
        (idn.WeightedRational, "feedthrough", "x"),
    ],
)
def test_a_setting_of_another_kind_is_named(make, setting, value):
    with pytest.raises(InputError, match=f"{make.__name__}: '{setting}' must be"):
        make(**{setting: value})
