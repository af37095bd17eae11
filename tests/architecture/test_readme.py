"""The README's Python runs as it stands, and reaches what the README says."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

README = Path(__file__).parents[2] / "README.md"


@pytest.mark.slow
@pytest.mark.docs
def test_the_readme_runs(tmp_path):
    block = re.search(r"```python\n(.*?)```", README.read_text(), re.DOTALL)[1]
    done = subprocess.run([sys.executable, "-c", block], cwd=tmp_path, capture_output=True, text=True, check=False)
    print(done.stdout, done.stderr)
    assert done.returncode == 0
    assert float(done.stdout.split()[0]) >= 12.0
    assert "not compiled" not in done.stdout or "missing" in done.stdout
    assert (tmp_path / "code" / "controller.c").exists()


def test_the_readme_names_files_that_exist():
    for link in re.findall(r"\]\(([^)#]+)\)|`(src/[^`]+)`", README.read_text()):
        path = README.parent / (link[0] or link[1])
        assert path.exists(), path
