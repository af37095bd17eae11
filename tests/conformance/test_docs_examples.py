"""Every example of the documentation runs as it is printed, page by page as a reader would type it."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import ultraquiet as uq

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
MADE = ("_build", "reference/api", "gallery")
PAGES = sorted(p for p in DOCS.rglob("*.md") if not str(p.relative_to(DOCS)).startswith(MADE))
# A block with its language; a comment in front of it holds what a reader would have: a card, a response, a file.
BLOCK = re.compile(
    r"<!-- before the next block:\n(?P<before>.*?)-->|```(?P<kind>python|toml|sh)\n(?P<body>.*?)```", re.S
)


def blocks(page):
    """Kind, text and line of each block of a page."""
    text = page.read_text()
    for found in BLOCK.finditer(text):
        body = found["body"] if found["kind"] else found["before"]
        yield found["kind"] or "before", body, text[: found.start()].count("\n")


def pages_with(*kinds):
    chosen = [page for page in PAGES if any(kind in kinds for kind, *_ in blocks(page))]
    return [pytest.param(page, id=str(page.relative_to(DOCS))) for page in chosen]


@pytest.mark.slow
@pytest.mark.docs
@pytest.mark.parametrize("page", pages_with("python", "sh"))
def test_a_page_runs_from_top_to_bottom(page, tmp_path, monkeypatch):
    import matplotlib as mpl

    mpl.use("Agg")
    monkeypatch.chdir(tmp_path)
    # given back: a page puts one of this machine in its place
    monkeypatch.setattr(uq.bench, "Process", uq.bench.Process)
    for name in ("docs", "tests"):
        (tmp_path / name).symlink_to(ROOT / name)
    held = {"__name__": "__main__"}
    try:
        for kind, body, line in blocks(page):
            if kind == "sh":
                in_the_shell(body, tmp_path)
            elif kind != "toml":
                exec(compile("\n" * (line + 1) + body, str(page), "exec"), held)
    finally:
        for served in (one for one in held.values() if isinstance(one, subprocess.Popen)):
            with served:
                served.kill()


def in_the_shell(lines, folder):
    own = f'{sys.executable} -c "from ultraquiet.cli import main; main()"'
    script = f'set -e\nultraquiet() {{ {own} "$@"; }}\n{lines}'
    done = subprocess.run(["bash", "-c", script], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("page", pages_with("toml"))
def test_settings_of_a_page_can_be_read(page):
    for kind, body, _ in blocks(page):
        if kind == "toml":
            tomllib.loads(body)
