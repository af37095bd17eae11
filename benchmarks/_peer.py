"""Other packages, each in an environment and a process of its own: never imported here, never shipped."""

import os
import subprocess
import sys
import venv
from pathlib import Path

import numpy as np

SET_UP_S, RUN_S = 600.0, 1800.0


class PeerError(Exception):
    """The peer could not be set up; the reason is its text."""


def cache() -> Path:
    """Where environments are kept between runs."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "ultraquiet" / "peers"


def environment(name: str, requirements: tuple[str, ...]) -> Path:
    """Return the interpreter of an environment with these requirements, made on the first call from the package index.

    Raises:
        PeerError: the index cannot be reached or does not have them.
    """
    folder = cache() / f"{name}-python{sys.version_info.major}.{sys.version_info.minor}"
    python, stamp = folder / "bin" / "python", folder / "requirements.txt"
    wanted = "\n".join(requirements) + "\n"
    if stamp.exists() and stamp.read_text() == wanted:
        return python
    venv.create(folder, with_pip=True, clear=True)
    try:
        done = subprocess.run(
            [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *requirements],
            capture_output=True,
            text=True,
            check=False,
            timeout=SET_UP_S,
        )
    except subprocess.TimeoutExpired:
        raise PeerError(f"installing {' '.join(requirements)} took longer than {SET_UP_S:g} s") from None
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise PeerError(f"{' '.join(requirements)} cannot be installed: {last}")
    stamp.write_text(wanted)
    return python


def run(python: Path, script: str, given: dict[str, np.ndarray], folder: Path) -> dict[str, np.ndarray]:
    """Run a script of this folder in the peer's interpreter on arrays `given`; return the arrays it leaves.

    Raises:
        PeerError: it fails or takes too long.
    """
    source, target = folder / "given.npz", folder / "left.npz"
    np.savez(source, **given)  # pyright: ignore[reportArgumentType]
    command = [str(python), str(Path(__file__).parent / script), str(source), str(target)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=RUN_S)
    except subprocess.TimeoutExpired:
        raise PeerError(f"{script} ran longer than {RUN_S:g} s") from None
    if done.returncode != 0 or not target.exists():
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise PeerError(f"{script} failed: {last}")
    with np.load(target) as left:
        return {key: left[key] for key in left.files}
