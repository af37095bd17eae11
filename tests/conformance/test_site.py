"""The documentation as a site: every public name has its page, nothing is broken, nothing is fetched from elsewhere."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import time
from html import unescape
from pathlib import Path
from urllib.parse import urlsplit

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
LONGEST_S = 120.0
FETCHED = re.compile(r'<(?:script|img|link)[^>]+(?:src|href)="(https?:[^"]+)"')


@pytest.fixture(scope="module")
def api():
    spec = importlib.util.spec_from_file_location("api_pages", DOCS / "api_pages.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_public_name_is_documented(api, tmp_path):
    public = api.public()
    assert len(public) > 300
    assert not [path for path, thing in public.items() if not api.documentation(thing).strip()]
    api.write(tmp_path)
    pages = "".join(page.read_text() for page in tmp_path.glob("*.md"))
    described = set(re.findall(r"^:+\{py:\w+\} ([\w.]+)", pages, re.MULTILINE))
    assert set(public) <= described, sorted(set(public) - described)


def test_shapes_and_units_reach_the_page(api):
    import ultraquiet as uq

    page = api.entry("ultraquiet.Record", uq.Record)
    assert "* `inputs`: `(nu, n)`, the commands as they were sent, in the unit of each actuator." in page
    assert "`rate_hz`: samples per second" in page
    assert "* `InputError`:" in page
    assert "```pycon\n>>> record = Record(" in page


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The pages as `make docs` builds them, from a copy, so that nothing that lies about helps."""
    tree = tmp_path_factory.mktemp("site")
    left_out = shutil.ignore_patterns("_build", "api", "gallery", "__pycache__")
    shutil.copytree(ROOT / "docs", tree / "docs", ignore=left_out)
    shutil.copytree(ROOT / "src", tree / "src", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "CHANGELOG.md", "SECURITY.md"):
        shutil.copy(ROOT / name, tree)
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-n", "-q", "-b", "html", "docs", "out"]
    begun = time.perf_counter()
    before = os.times()
    done = subprocess.run(command, cwd=tree, capture_output=True, text=True, check=False)
    after = os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    print(f"pages built in {used:.0f} processor seconds, {time.perf_counter() - begun:.0f} s by the clock")
    assert done.returncode == 0, done.stderr
    assert used < LONGEST_S
    return tree / "out"


@pytest.mark.slow
@pytest.mark.docs
def test_the_site_is_built_without_a_warning(site, api):
    pages = list(site.rglob("*.html"))
    assert len(pages) > 60
    text = "".join(page.read_text() for page in (site / "reference" / "api").glob("*.html"))
    missing = [path for path in api.public() if f'id="{path}"' not in text]
    assert not missing, missing


@pytest.mark.slow
@pytest.mark.docs
def test_links_lead_somewhere_and_nothing_comes_from_elsewhere(site):
    broken, foreign = [], []
    for page in site.rglob("*.html"):
        text = page.read_text()
        ids = set(re.findall(r'\bid="([^"]+)"', text))
        foreign += [f"{page.name}: {url}" for url in FETCHED.findall(text)]
        for link in re.findall(r'<a[^>]+href="([^"]*)"', text):
            if re.match(r"[a-z]+:", link):
                continue
            path, _, anchor = link.partition("#")
            target = (page.parent / path).resolve() if path else page
            if not target.exists():
                broken.append(f"{page.name}: {link}")
            elif anchor and target.suffix == ".html":
                known = ids if target == page else set(re.findall(r'\bid="([^"]+)"', target.read_text()))
                if anchor not in known:
                    broken.append(f"{page.name}: {link}")
    assert not foreign, foreign[:10]
    assert not broken, broken[:10]


@pytest.mark.slow
@pytest.mark.docs
def test_addresses_of_other_machines_are_whole(site):
    """They are not called, which a test without a network cannot; each names a machine, and a DOI its paper."""
    found = {link for page in site.rglob("*.html") for link in re.findall(r'href="([a-z]+:[^"]*)"', page.read_text())}
    print(len(found), "addresses")
    assert found
    assert not [link for link in found if not whole(unescape(link))]


def whole(address):
    """Whether an address can be one: https or mail, a machine of two parts, no space and no bracket left open."""
    parts = urlsplit(address)
    if parts.scheme == "mailto":
        return re.fullmatch(r"[^@\s]+@[\w-]+(\.[\w-]+)+", parts.path) is not None
    machine = re.fullmatch(r"[\w-]+(\.[\w-]+)+(:\d+)?|127\.0\.0\.1:\w+", parts.netloc)
    paper = parts.netloc != "doi.org" or re.match(r"/10\.\d{4,}/\S+", parts.path)
    shut = address.count("(") == address.count(")")
    return bool(parts.scheme in ("http", "https") and machine and paper and shut and not re.search(r"\s", address))


@pytest.mark.parametrize("address", ["https://doi.org/10.1109/x", "https://a.org/b_(c)", "mailto:a@b.org"])
def test_a_whole_address_is_one(address):
    assert whole(address)


@pytest.mark.parametrize(
    "address", ["https://doi.org/11.1/x", "https://a", "http://a.org/b c", "ftp://a.org", "https://a.org/b(c"]
)
def test_a_torn_address_is_none(address):
    assert not whole(address)


def anchors(text):
    """The anchors that a forge gives the headings of a Markdown file."""
    heads = re.findall(r"^#+ +(.+?)\s*$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", re.sub(r"[`*]", "", head).lower()).replace(" ", "-") for head in heads}


def test_links_of_the_pages_beside_the_code_lead_somewhere():
    """README and its neighbours, as a reader of the repository follows them: files, and headings in them."""
    broken = []
    for page in (*ROOT.glob("*.md"), *DOCS.rglob("*.md")):
        if {"_build", "api", "gallery"} & set(page.relative_to(ROOT).parts):
            continue
        text = re.sub(r"```.*?```|`[^`\n]*`", "", page.read_text(), flags=re.DOTALL)
        for link in re.findall(r"\]\(([^)\s]+)\)", text):
            path, _, anchor = link.partition("#")
            if re.match(r"[a-z]+:", link):
                broken += [] if whole(link) else [f"{page.name}: {link}"]
                continue
            target = (page.parent / path).resolve() if path else page
            made = {"api", "gallery"} & set(Path(path).parts)  # when the site is built, which checks them
            if (not target.exists() and not made) or (
                anchor and target.suffix == ".md" and target.exists() and anchor not in anchors(target.read_text())
            ):
                broken.append(f"{page.name}: {link}")
    assert not broken


@pytest.mark.slow
@pytest.mark.docs
def test_search_and_pictures_are_there(site):
    assert (site / "searchindex.js").stat().st_size > 10_000
    pictures = list(site.rglob("*.svg"))
    assert len([p for p in pictures if p.stat().st_size > 5_000]) >= 10
