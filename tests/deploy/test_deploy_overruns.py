"""The self-test reaches any limit of overruns from close by: as short for millions of them, and as sharp."""

import subprocess
import time

import pytest
from deploy_laws import random_law

from ultraquiet.deploy import generate
from ultraquiet.deploy.c_code.self_test import MOST_OVERRUNS, script_calls
from ultraquiet.deploy.toolchain.compiler import CONTRACT_OFF

BUILD = (
    "-std=c99",
    "-O1",
    *CONTRACT_OFF,
    "-w",
    "-DCONTROLLER_MAIN",
    "controller.c",
    "controller_selftest.c",
    "-o",
    "run",
)
FAULTS = [
    ("s->late >= (2U * CONTROLLER_OVERRUN_LIMIT)", "s->late > (2U * CONTROLLER_OVERRUN_LIMIT)"),
    ("s->late >= (2U * CONTROLLER_OVERRUN_LIMIT)", "s->late >= ((2U * CONTROLLER_OVERRUN_LIMIT) - 1U)"),
    ("s->late >= (2U * CONTROLLER_OVERRUN_LIMIT)", "s->late >= ((2U * CONTROLLER_OVERRUN_LIMIT) + 2U)"),
    ("s->late = s->late + 2U;", "s->late = s->late + 1U;"),
    ("s->late = s->late - 1U;", "s->late = s->late - 2U;"),
    ("s->late = s->late - 1U;", ""),
    ("        s->late = 0U;\n", ""),
    ("s->late = s->late + 2U;", "s->late = (s->late + 2U) & 0xFFFFFFU;"),
]


def passes(folder, cc):
    subprocess.run([cc, *BUILD], cwd=folder, check=True)
    return subprocess.run([folder / "run"], capture_output=True, check=False).returncode == 0


@pytest.mark.gate("9", "16777216")
@pytest.mark.parametrize("limit", [1, 2, MOST_OVERRUNS, MOST_OVERRUNS + 1, 2**24])
def test_no_limit_makes_the_self_test_long(limit, rng, tmp_path, cc):
    begun = time.process_time()
    made = generate(random_law(rng, 2, 1, 1), tmp_path / "code", limits_v=5.0, overrun_limit=limit)
    assert time.process_time() - begun < 5.0
    calls = [call for call in script_calls(made.law, 1.0, 1.0) if call[0] in ("FRAME", "LAG")]
    assert max(count for op, count, _ in calls if op == "FRAME") <= 2 * MOST_OVERRUNS
    assert any(op == "LAG" for op, *_ in calls) == (limit > MOST_OVERRUNS)
    assert passes(made.folder, cc)


@pytest.mark.slow
@pytest.mark.parametrize("limit", [2, 4, MOST_OVERRUNS + 1, 1000, 2**24])
def test_faults_around_the_limit_are_caught_wherever_it_is(limit, rng, tmp_path, cc):
    made = generate(random_law(rng, 2, 1, 1), tmp_path / "code", limits_v=5.0, overrun_limit=limit)
    source = made.folder / "controller.c"
    text = source.read_text()
    for was, fault in FAULTS:
        assert was in text
        if "0xFFFFFF" in fault and limit < 2**23:
            continue  # the same for every score that is reached
        source.write_text(text.replace(was, fault))
        assert not passes(made.folder, cc), fault
