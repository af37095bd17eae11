"""Every Python example of the documentation on control, blending, code and payload runs as it is printed."""

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
BLOCKS = [
    pytest.param(block, id=f"{name}-{k}")
    for name in ("blending.md", "control.md", "deployment.md", "mission.md")
    for k, block in enumerate(re.findall(r"```python\n(.*?)```", (DOCS / name).read_text(), re.DOTALL))
]


@pytest.mark.slow
@pytest.mark.docs
@pytest.mark.parametrize("block", BLOCKS)
def test_example_runs(block, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "docs", "exec"), {})
