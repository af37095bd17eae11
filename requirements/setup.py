"""Create a virtual environment and install a lock file into it, with uv when it is present and pip otherwise.

    python requirements/setup.py VENV LOCK

Standard library only: this runs before anything is installed.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

OLDEST = (3, 11)


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
    run(sys.executable, "-m", "venv", str(venv))


def main(venv: Path, lock: Path) -> None:
    """Install the locked packages, then this project without looking for anything else."""
    if sys.version_info < OLDEST:
        sys.exit(f"setup: Python {sys.version.split()[0]} is too old, {'.'.join(map(str, OLDEST))} or newer is needed")
    python = str(venv / "bin" / "python")
    uv = shutil.which("uv")
    if uv:
        if not Path(python).exists():
            run(uv, "venv", "--quiet", "--python", sys.executable, str(venv))
        install = [uv, "pip", "install", "--quiet", "--python", python]
    else:
        create(venv)
        # half of pip's time goes into byte code, most of it for modules that nothing here imports
        install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile"]
    os.environ.pop("PYTHONHOME", None)
    run(*install, "-r", str(lock))
    run(*install, "--no-deps", "--no-build-isolation", "--editable", ".")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
