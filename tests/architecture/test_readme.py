"""The README's Python runs as it stands, and reaches what the README says."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

README = Path(__file__).parents[2] / "README.md"


BLOCKS = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)


def ran(block, folder):
    """Run a block as a reader would who stands in the repository; returns what it printed."""
    (folder / "tests").symlink_to(README.parent / "tests")
    done = subprocess.run([sys.executable, "-c", block], cwd=folder, capture_output=True, text=True, check=False)
    print(done.stdout, done.stderr)
    assert done.returncode == 0
    return done.stdout


@pytest.mark.slow
@pytest.mark.docs
def test_one_s_own_data_become_verified_code(tmp_path):
    said = ran(BLOCKS[0], tmp_path).splitlines()
    assert said[0].startswith("not white")
    assert said[-2].startswith("ok: The loop is stable")
    assert said[-1].startswith("ok:") or "missing" in said[-1]
    assert (tmp_path / "code" / "controller.c").exists()


@pytest.mark.slow
@pytest.mark.docs
def test_one_s_own_bench_becomes_quiet(tmp_path):
    assert float(ran(BLOCKS[1], tmp_path).split()[0]) >= 12.0


def test_the_readme_is_read_in_a_minute():
    """Words outside code, at the 240 a minute of a technical reader."""
    text = re.sub(r"```.*?```|!\[[^]]*\]|\([^)]*\)|[*`\[\]#-]", " ", README.read_text(), flags=re.DOTALL)
    print(len(text.split()), "words")
    assert len(text.split()) <= 300
    first, second = (len(block.strip().splitlines()) for block in BLOCKS)
    assert first <= 10
    assert len(BLOCKS) == 2
    assert second <= 18


def test_the_readme_names_files_that_exist():
    for link in re.findall(r"\]\(([^)#]+)\)|`(src/[^`]+)`", README.read_text()):
        path = README.parent / (link[0] or link[1])
        assert path.exists(), path
