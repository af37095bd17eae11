"""Fixtures of the deployment tests: random laws and the C compiler."""

import shutil

import pytest
from deploy_laws import random_law


@pytest.fixture
def law_of(rng):
    """Return a maker of random laws, drawn from the run's seed."""
    return lambda states, inputs=6, outputs=6: random_law(rng, states, inputs, outputs)


@pytest.fixture
def cc():
    """Return the C compiler; a test that needs one says so when it is missing."""
    found = next((p for p in map(shutil.which, ("cc", "gcc", "clang")) if p), None)
    if found is None:
        pytest.skip("no C compiler (cc, gcc, clang) on this machine")
    return found
