"""Which records of a study are test signals."""

from types import SimpleNamespace

import numpy as np
import pytest

from ultraquiet.pipeline.report.records import _signals
from ultraquiet.plot import study
from ultraquiet.values import Record


@pytest.mark.parametrize("still", [0.0, 2.5])
def test_a_record_of_the_noise_alone_is_no_test_signal(still):
    """A command that stands has no spectral density, which ended the report of a study that was complete."""
    rng = np.random.default_rng(0)
    driven = np.vstack([np.zeros(4000), rng.standard_normal(4000)])
    quiet = Record(np.full((2, 4000), still), rng.standard_normal((1, 4000)), 1000.0)
    records = {"quiet": quiet, "noise": Record(driven, rng.standard_normal((1, 4000)), 1000.0)}
    shown = _signals(SimpleNamespace(study=SimpleNamespace(paper=None), records=records))
    assert {name: actuator for name, (_, actuator) in shown.items()} == {"noise": 1}
    assert len(study.excitation_signals(shown).panels) == 2
