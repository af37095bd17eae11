"""The order of a polynomial method that is left to the record: one answer through every door, and a sentence for it."""

import json

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import methods
from ultraquiet.identify.polynomial.methods import PolynomialMethod
from ultraquiet.identify.searched_order import Unasked
from ultraquiet.pipeline import identification
from ultraquiet.pipeline.study import parse

RATE_HZ = 500.0
POLYNOMIAL = [name for name, kind in methods("identify").items() if issubclass(kind, PolynomialMethod)]
STUDY = """
[study]
title = "auto"
[records]
files = ["run.h5"]
[plant]
method = "{method}"
order = "auto"
[controllers.quiet.design]
method = "lqg"
[deploy]
limits = 5.0
"""


def recorded(rng, ny, nu, samples=1200, noise=0.05):
    """Two modes, 0.97 exp(0.2j) and 0.97 exp(0.7j), drawn shapes, white noise at the sensors."""
    A = np.zeros((4, 4))
    for k, z in enumerate(0.97 * np.exp(1j * np.array([0.2, 0.7]))):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[z.real, z.imag], [-z.imag, z.real]]
    B, C = rng.standard_normal((4, nu)), rng.standard_normal((ny, 4))
    u = rng.standard_normal((nu, samples))
    y = uq.StateSpace(A, B, C, np.zeros((ny, nu)), RATE_HZ).simulate(u)
    return uq.Record(u, y + noise * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape), RATE_HZ)


@pytest.mark.gate("3-5-arx", "1-1-box-jenkins")
@pytest.mark.parametrize(("ny", "nu", "method"), [(1, 1, "box-jenkins"), (4, 3, "output-error"), (3, 5, "arx")])
def test_command_line_python_and_study_come_to_one_order(run, tmp_path, rng, ny, nu, method):
    record = recorded(rng, ny, nu, 600)
    uq.files.save(record, tmp_path / "run.h5")
    python = methods("identify")[method](order="auto").identify(record)
    words = ("--method", method, "--order", "auto", "--out", "m.h5", "--json")
    shell = json.loads(run("identify", "run.h5", *words)[1])
    plant = parse(STUDY.format(method=method)).plant
    facts = identification.plant({"run": record}, plant).facts
    print(python.status, shell["status"], facts.status, sep="\n")
    order = python.details["order"]
    assert shell["order"] == order
    assert (shell["samples"], shell["held_out_samples"]) == (600, 0)
    assert list(shell["fit_percent"].values()) == list(python.fit_percent)
    assert list(shell["loss"].values()) == list(python.loss)
    assert uq.files.load(tmp_path / "m.h5").state_space().hash == python.model.state_space().hash
    assert f"Order {order} was chosen" in str(python.status)
    assert facts.status == str(python.status)
    assert str(python.status.sentence) in str(shell["status"])
    if method == "output-error":  # the structure of the truth
        assert 4 <= order <= 5


@pytest.mark.parametrize("name", POLYNOMIAL)
@pytest.mark.parametrize("nonsense", ["three", "", 0, -1, 2.5, True, np.nan, 31, [2], {}])
def test_an_order_that_is_none_gets_a_sentence(name, nonsense):
    with pytest.raises(InputError, match="'order' must be") as refused:
        methods("identify")[name](order=nonsense)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", POLYNOMIAL)
def test_an_order_that_nobody_asked_for_is_told(name, rng):
    record, kind = recorded(rng, 1, 1, 400), methods("identify")[name]
    default, asked = kind().identify(record), kind(order=5).identify(record)
    print(default.status)
    assert default.status.sentence.startswith(asked.status.sentence)
    assert "Order 5 was taken, none was asked for" in default.status.sentence
    assert "none was asked for" not in asked.status.sentence
    assert np.array_equal(default.loss, asked.loss)
    assert kind() == kind(order=5)
    assert isinstance(kind().order, Unasked)
    assert default.provenance.settings["order"] == 5


def test_recursion_says_that_five_was_not_asked_for(rng):
    found = uq.identify.RecursiveArx(start_samples=0).identify(recorded(rng, 1, 1, 600))
    assert "Order 5 was taken, none was asked for." in found.status.sentence
    with pytest.raises(InputError, match="'order' must be a whole number"):
        methods("identify")["recursive-arx"](order="auto")


def test_orders_that_a_record_cannot_carry_are_not_tried(rng):
    record = recorded(rng, 1, 1, 400)
    found = uq.identify.OutputError(order="auto").identify(record.part(0, 120))
    print(found.status)
    assert found.details["order"] <= 3
    with pytest.raises(InputError, match="two thirds of the record"):
        uq.identify.OutputError(order="auto").identify(record.part(0, 30))


def test_a_record_without_noise_takes_no_larger_order_than_it_needs(rng):
    found = uq.identify.OutputError(order="auto").identify(recorded(rng, 1, 1, 600, noise=0.0))
    print(found.status)
    assert found.details["order"] == 4


def test_several_records_and_known_parts_are_asked_together(rng):
    one, other = recorded(rng, 1, 1, 900), recorded(rng, 1, 1, 900)
    method = uq.identify.Arx(order="auto", delay=[1])
    joint = method.identify([one.part(0, 500), one.part(500)])
    assert "last third of 900 samples" in joint.status.sentence
    matrix = uq.identify.identify_matrix(uq.identify.OutputError(order="auto", delay=[1, 2]), [one, other])
    print(joint.status, matrix.status, sep="\n")
    assert "was chosen" in matrix.status.sentence
    assert "last third of 1800 samples" in matrix.status.sentence
    plain = uq.identify.identify_matrix(uq.identify.OutputError(order="auto"), [one, other])
    order = plain.provenance.settings["order"]
    assert plain.status.sentence.startswith("Converged") or "channels" in plain.status.sentence
    assert f"Order {order} was chosen" in plain.status.sentence
    known = uq.identify.OutputError(order="auto", known_poles=[0.9, 0.8]).identify(one)
    assert "orders 2 to 7" in known.status.sentence


def test_a_structure_without_a_record_asks_for_a_number():
    with pytest.raises(InputError, match="give it a number"):
        uq.identify.Arx(order="auto").structure()
