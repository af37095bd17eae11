"""A workbench that is served for a test, and a browser in front of it that notes what must not happen."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from chromium import chromium_started
from page_geometry import WATCH
from ultraquiet.workbench import Session
from ultraquiet.workbench.engine.making.imports import import_step, received

START = "from ultraquiet.cli import main; main()"
PATIENCE_MS = 120_000
RATE = 200.0


def csv_of(path: Path, seed: int, inputs: int = 1, outputs: int = 1, scale: float = 1.0, samples: int = 1500) -> Path:
    """A lightly damped bench, its columns named and in units."""
    draws = np.random.default_rng(seed)
    u = draws.standard_normal((inputs, samples))
    y = 0.01 * draws.standard_normal((outputs, samples))
    for i in range(outputs):
        for j in range(inputs):
            pole = 0.97 * np.exp(2j * np.pi * (8 + 3 * i + 2 * j) / RATE)
            h = np.real(pole ** np.arange(400)) * (1.0 if i == j else 0.3) * 0.1
            y[i, 1:] += np.convolve(u[j], h)[: samples - 1]
    names = [f"force {j + 1} [N]" for j in range(inputs)] + [f"speed {i + 1} [m/s]" for i in range(outputs)]
    rows = np.column_stack([np.arange(samples) / RATE, u.T, scale * y.T])
    path.write_text("time [s]," + ",".join(names) + "\n" + "\n".join(",".join(f"{v:.12g}" for v in r) for r in rows))
    return path


def columns(inputs: int, outputs: int) -> dict[str, list[dict[str, str]]]:
    return {
        "inputs": [{"column": f"force {j + 1}", "unit": "N"} for j in range(inputs)],
        "outputs": [{"column": f"speed {i + 1}", "unit": "m/s"} for i in range(outputs)],
    }


def finished_study(folder: Path, inputs: int, outputs: int, names: Sequence[str] = (), title: str = "") -> Path:
    """Make a study with a record, a model, a law and its code; `names` replace those of its channels."""
    path = csv_of(folder.parent / f"{folder.name}.csv", 1, inputs, outputs, samples=6000)
    made = Session(folder)
    if title:
        made.do({"op": "title", "title": title})
    file = received(folder, path.name, path)
    sides = columns(inputs, outputs)
    for channel, name in zip([*sides["inputs"], *sides["outputs"]], names, strict=False):
        channel["name"] = name
    made.do(import_step(folder, "run", file, sides))
    method = {"method": "subspace", "order": 6 * max(inputs, outputs)}
    made.do({"op": "identify", "name": "model", "records": ["run"], "period_samples": None, "method": method})
    made.do({"op": "design", "name": "quiet", "model": "model", "method": {"method": "lqg"}, "reduce": None})
    made.do({"op": "deploy", "law": "quiet"})
    made.make("codes", "quiet")
    return folder


class Served:
    """One server and what it printed."""

    def __init__(self, folder: Path, *options: str, start: str = START) -> None:
        command = [sys.executable, "-c", start, "serve", str(folder), "--no-open", *options]
        env = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env)
        self.address = self.process.stdout.readline().strip()
        self.root, _, self.token = self.address.partition("/?token=")
        self.port = int(self.root.rpartition(":")[2])

    def stop(self) -> tuple[int, str, str]:
        """End it as Ctrl-C or a service manager does; return its code and what else it said."""
        if self.process.poll() is None:
            self.process.terminate()
        out, err = self.process.communicate(timeout=30)
        return self.process.returncode, out, err


@contextmanager
def served(folder: Path, *options: str, start: str = START) -> Iterator[Served]:
    """Serve a study folder for the length of a block."""
    made = Served(folder, *options, start=start)
    try:
        yield made
    finally:
        made.stop()


class Seen:
    """A page with notes of console errors and of requests that leave this machine."""

    def __init__(self, page: Any, root: str) -> None:
        self.page, self.root = page, root
        self.errors: list[str] = []
        self.outside: list[str] = []
        page.on("console", lambda m: self.errors.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda e: self.errors.append(str(e)))
        page.on("request", self._requested)
        page.set_default_timeout(PATIENCE_MS)

    def _requested(self, request: Any) -> None:
        if not request.url.startswith((self.root, "data:", "blob:")):
            self.outside.append(request.url)

    def go(self, page: str) -> None:
        """Open a page of the workbench."""
        self.page.goto(f"{self.root}/{page}")
        self.find("boards")

    def find(self, mark: str, inner: str = "") -> Any:
        """Wait for a control and return it."""
        return self.page.wait_for_selector(f"[data-testid='{mark}'] {inner}".strip(), state="attached")

    def click(self, mark: str) -> None:
        """Press a control."""
        self.page.click(f"[data-testid='{mark}']")

    def fill(self, mark: str, text: str) -> None:
        """Write into a field."""
        self.page.fill(f"[data-testid='{mark}']", text)
        self.page.wait_for_timeout(450)  # fields tell the server after 300 ms without a key

    def choose(self, mark: str, option: str) -> None:
        """Take an option of a choice."""
        self.click(mark)
        self.page.locator(".q-menu .q-item").get_by_text(option, exact=True).click()
        self.page.wait_for_timeout(300)

    def drawn(self, mark: str) -> float:
        """Wait until a chart is drawn; return how many seconds that took."""
        began = time.perf_counter()
        self.find(mark, "canvas")
        return time.perf_counter() - began

    def made(self, board: str, name: str) -> str:
        """Wait until an item is made; return what the board says of it."""
        js = "(s) => { const e = document.querySelector(s); return e && !/not made|stale/.test(e.innerText); }"
        selector = f"[data-testid='item-{board}-{name}']"
        self.page.wait_for_function(js, arg=selector)
        return self.page.inner_text(selector)

    def drop(self, path: Path) -> None:
        """Drop a file on Records."""
        self.page.set_input_files("[data-testid='drop'] input[type=file]", str(path))


@contextmanager
def browser(made: Served, width: int = 1280, height: int = 800, scheme: str = "light") -> Iterator[Seen]:
    """Open the printed address in a browser."""
    with chromium_started() as chrome:
        context = chrome.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)
        context.add_init_script(WATCH)
        page = context.new_page()
        seen = Seen(page, made.root)
        page.goto(made.address)
        seen.find("boards")
        yield seen
