"""Create a virtual environment and install a lock file into it, with uv when pip can bring it, and pip otherwise.

    python requirements/setup.py VENV LOCK

Standard library only: this runs before anything is installed.
"""

import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

OLDEST = (3, 11)
UV = "uv>=0.8,<1"
PROJECT = ("--no-deps", "--no-build-isolation", "--editable", ".")
PIP_TO_UV = {
    "index-url": "UV_DEFAULT_INDEX",
    "extra-index-url": "UV_INDEX",
    "find-links": "UV_FIND_LINKS",
    "cert": "SSL_CERT_FILE",
}


def run(*command: str) -> None:
    """Run a command and stop with its exit code when it fails."""
    done = subprocess.run(command, check=False)
    if done.returncode:
        sys.exit(f"setup: '{' '.join(command)}' failed with exit code {done.returncode}")


def create(venv: Path) -> None:
    """Create the virtual environment unless a usable one is there."""
    if (venv / "bin" / "python").exists():
        return
    try:
        import ensurepip  # noqa: F401  Debian splits it off into python3-venv
    except ImportError:
        sys.exit(f"setup: {sys.executable} has no 'ensurepip'; install it (Debian: apt-get install python3-venv)")
    # Its pip is most of what an environment takes to make: where this interpreter has one, uv brings it with the rest.
    run(sys.executable, "-m", "venv", *(["--without-pip"] if find_spec("pip") else []), str(venv))


def fetched_uv(python: str) -> str | None:
    """Return uv, brought by pip: it installs a lock in half of pip's time; None where it cannot be had."""
    nowhere = subprocess.DEVNULL
    if subprocess.run([*pip(python), UV], stdout=nowhere, stderr=nowhere, check=False).returncode:
        return None
    uv = Path(python).with_name("uv")
    return str(uv) if uv.exists() else None


def has_pip(python: str) -> bool:
    """Return whether an environment has a pip of its own."""
    return Path(python).with_name("pip").exists()


def bundled_pip() -> str:
    """Return the version of the pip that this interpreter brings into environments."""
    import ensurepip

    return ensurepip.version()


def pip(python: str, *verb: str) -> list[str]:
    """Return the words with which pip does something to an environment, its own pip or this interpreter's; installs."""
    who = [python, "-m", "pip"] if has_pip(python) else [sys.executable, "-m", "pip", "--python", python]
    # half of pip's time goes into byte code, most of it for modules that nothing here imports
    return [*who, *(verb or ("install", "--quiet", "--disable-pip-version-check", "--no-compile"))]


def as_pip(listed: str) -> dict[str, str]:
    """Return an environment in which uv looks for packages where pip does, by what `pip config list` says."""
    found = dict(os.environ)
    for line in listed.splitlines():
        key, _, value = line.partition("=")
        name = PIP_TO_UV.get(key.rpartition(".")[2])
        if name is not None:
            found.setdefault(name, value.strip("'\""))
    return found


def main(venv: Path, lock: Path) -> None:
    """Install the locked packages, then this project without looking for anything else."""
    if sys.version_info < OLDEST:
        sys.exit(f"setup: Python {sys.version.split()[0]} is too old, {'.'.join(map(str, OLDEST))} or newer is needed")
    os.environ.pop("PYTHONHOME", None)
    python = str(venv / "bin" / "python")
    uv = shutil.which("uv")
    if uv and not Path(python).exists():
        # byte code of this very run may be there already
        run(uv, "venv", "--quiet", "--allow-existing", "--seed", "--python", sys.executable, str(venv))
    else:
        create(venv)
    # asked while uv is on its way
    listed = subprocess.Popen(
        pip(python, "config", "list"), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    uv = uv or fetched_uv(python)
    settings = as_pip(listed.communicate()[0])
    own = [] if has_pip(python) else [f"pip=={bundled_pip()}"]
    if uv:
        with_uv = [uv, "pip", "install", "--quiet", "--python", python]
        done = subprocess.run([*with_uv, "-r", str(lock), *own], env=settings, stderr=subprocess.DEVNULL, check=False)
        if not done.returncode:
            run(*with_uv, *PROJECT)
            return
    # There is no uv, or the registry is one that only pip knows how to ask.
    if own:
        run(python, "-m", "ensurepip", "--default-pip")
    run(*pip(python), "-r", str(lock))
    run(*pip(python), *PROJECT)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
