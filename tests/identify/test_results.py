"""What every identification hands over, and how it is put together."""

from dataclasses import fields

import numpy as np
import pytest

import ultraquiet as uq
from ultraquiet.identify.regularised.posterior import ResponseResult


def test_results_take_no_field_by_position(rng):
    u = rng.standard_normal((1, 300))
    y = np.concatenate([[0.0], u[0, :-1]])[None] + 0.1 * rng.standard_normal((1, 300))
    result = uq.identify.Arx(order=1).identify(uq.Record(u, y, 100.0))
    values = {field.name: getattr(result, field.name) for field in fields(result)}
    again = uq.identify.Result(**values)
    assert again.model is result.model
    assert again.statuses == result.statuses
    for kind in (uq.identify.Result, ResponseResult):
        with pytest.raises(TypeError, match="positional"):
            kind(*values.values())
