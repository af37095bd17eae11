"""`order="auto"`: wherever a method looks for its order, in Python and in the tables of a study."""

from dataclasses import fields

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet._base.errors import InputError
from ultraquiet._base.registry import methods
from ultraquiet._base.tables import Method
from ultraquiet.identify.searched_order import SearchedOrder

SEARCHED = [name for name, kind in methods("identify").items() if issubclass(kind, SearchedOrder)]


def test_every_method_that_looks_for_its_order_takes_the_word():
    able = [
        n for n, k in methods("identify").items() if any(f.name == "order" and "None" in str(f.type) for f in fields(k))
    ]
    print(able)
    assert able
    assert sorted(able) == sorted(SEARCHED)


@pytest.mark.parametrize("name", SEARCHED)
def test_the_word_is_none(name):
    kind = methods("identify")[name]
    assert kind(order="auto") == kind(order=None)
    assert Method(method=name, order="auto").make("identify") == kind(order=None)
    with pytest.raises(InputError, match="order"):
        kind(order="automatic")


def test_a_subspace_finds_its_order():
    plant = uq.StateSpace([[0.9, 0.3], [-0.3, 0.9]], [[1.0], [0.5]], [[1.0, 0.0]], [[0.0]], rate_hz=100.0)
    rng = np.random.default_rng(0)
    u = rng.standard_normal((1, 1500))
    record = uq.Record(u, plant.simulate(u) + 0.01 * rng.standard_normal((1, 1500)), 100.0)
    found = uq.identify.Subspace(order="auto").identify(record)
    print("order", found.details["order"], "fit", found.fit_percent)
    assert found.details["order"] == 2
