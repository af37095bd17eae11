"""Every method that registers itself can be had by its name."""

import ast
import json
import subprocess
import sys

import pytest

from package_source import parsed
from ultraquiet._base.errors import UnknownMethodError
from ultraquiet._base.registry import lookup, methods

# In a process of its own, where no test has imported what a room forgot; a room imports no room above it, so that in
# the order of the layers none can hide the gap of another.
KNOWN = """
import json
from ultraquiet._base.registry import FAMILIES, methods
print(json.dumps({family: list(methods(family)) for family in FAMILIES}))
"""


def registered():
    """(family, name) of every decorated class of the source tree, read without importing it."""
    for _, tree in parsed():
        for node in ast.walk(tree):
            for call in getattr(node, "decorator_list", ()):
                if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "register":
                    yield tuple(ast.literal_eval(argument) for argument in call.args)


def test_every_registered_method_is_reachable():
    done = subprocess.run([sys.executable, "-c", KNOWN], capture_output=True, text=True, check=True)
    reachable = [(family, name) for family, names in json.loads(done.stdout).items() for name in names]
    assert len(reachable) > 40
    assert sorted(registered()) == sorted(reachable)


def test_an_unknown_name_is_answered_with_the_nearest():
    known = f"Known are {', '.join(sorted(methods('identify')))}"
    with pytest.raises(UnknownMethodError, match=rf"no method 'box-jenkin'; did you mean 'box-jenkins'\? {known}"):
        lookup("identify", "box-jenkin")
