"""A law against tones is told which: none is a default, and a design that gets none says so in a sentence."""

import numpy as np
import pytest

from ultraquiet._base.errors import InputError
from ultraquiet.design import AdaptiveFeedforward, Resonators, YoulaKucera
from ultraquiet.testing.problems import damped_plant


@pytest.mark.parametrize("method", [Resonators(), AdaptiveFeedforward(), YoulaKucera()], ids=lambda m: type(m).__name__)
def test_a_law_without_tones_is_refused_in_a_sentence(method, seed):
    with pytest.raises(InputError, match="'tones_hz' names no tone to work against") as caught:
        method.design(damped_plant(seed))
    print(caught.value)
    assert str(caught.value).startswith(type(method).__name__)


def test_laguerre_filters_take_their_corner_from_tones_or_are_refused():
    with pytest.raises(InputError, match="needs 'pole_hz' or the 'tones_hz'"):
        YoulaKucera(basis="laguerre").filters(1000.0)
    from_tones = YoulaKucera(basis="laguerre", tones_hz=(10.0, 40.0)).filters(1000.0)
    named = YoulaKucera(basis="laguerre", pole_hz=20.0).filters(1000.0)
    gap = max(float(np.abs(a - b).max()) for a, b in zip(from_tones, named, strict=True))
    print(f"corner of tones at 10 and 40 Hz, off a corner of 20 Hz by {gap:.1e}")
    assert gap < 1e-12
