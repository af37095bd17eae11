"""Generated code as a project of its own: CMake, ctest, toolchain files, a workflow for every commit."""

from pathlib import Path

from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.deploy.c_code import render
from ultraquiet.deploy.c_code.output_folder import write_folder
from ultraquiet.deploy.c_code.plan import GeneratedCode
from ultraquiet.deploy.law.law import DTYPES
from ultraquiet.deploy.toolchain.compiler import FLAGS
from ultraquiet.deploy.toolchain.targets import TARGETS, families

NOBODY = "whoever had them designed"
COPIED = ("vectors.csv", "manifest.json")
TEMPLATES = {
    "CMakeLists.txt.j2": "CMakeLists.txt",
    "github_README.md.j2": "README.md",
    "github_LICENSE.j2": "LICENSE",
    "github_gitignore.j2": ".gitignore",
    "github_ci.yml.j2": ".github/workflows/ci.yml",
}


def write_project(made: GeneratedCode, folder: str | Path, owner: str = NOBODY) -> Path:
    """Write a deployed law as a folder that can be pushed to a forge as it is and builds there.

    `CMakeLists.txt` makes a library, `name::name` for other projects, and its self-test for ctest; `cmake/` holds a
    toolchain file for each emulated processor, whose self-test runs under QEMU; `.github/workflows/ci.yml` runs all of
    it at every commit. The generated files stand in `src/` as they are.

    Args:
        made: what `generate` returned; its folder must still be there.
        folder: where to write; appears whole or not at all, and replaces only what this package wrote.
        owner: whom the coefficients belong to, one line for `LICENSE`.

    Returns:
        The folder.

    Raises:
        InputError: whole-number code, which has no harness for a processor, or an owner of several lines.
        StorageError: the generated folder is gone, or the place cannot be written or holds something else.

    >>> import tempfile
    >>> from ultraquiet.deploy import generate
    >>> from ultraquiet.values import StateSpace
    >>> law = StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], rate_hz=3500.0)
    >>> work = tempfile.mkdtemp()
    >>> project = write_project(generate(law, work + "/code"), work + "/project")
    >>> sorted(path.stem for path in project.glob("cmake/*")) == sorted(TARGETS)
    True
    """
    folder, law = Path(folder).absolute(), made.law
    if getattr(law, "precision", "") not in DTYPES:
        raise InputError(f"write_project: a project needs a law in {' or '.join(DTYPES)}, not in whole numbers.")
    if not owner.strip() or not owner.isprintable():
        raise InputError(f"write_project: 'owner' must be one line, got {owner!r}.")
    if folder == made.folder.absolute():
        raise InputError("write_project: the project needs a folder of its own, not that of the generated code.")
    context = {
        **render.heading(law, made.model_hash),
        "owner": owner,
        "flags": " ".join(FLAGS[1:]),  # the standard is CMake's to ask for
        "targets": tuple(TARGETS.values()),
        "families": families(),
    }
    files = _generated(made.folder, law.name)
    files |= {name: render.render(template, context) for template, name in TEMPLATES.items()}
    for target in TARGETS.values():
        files[f"cmake/{target.name}.cmake"] = render.render(
            target.family.template("toolchain.cmake.j2"), context | {"target": target}
        )
    write_folder(folder, files)
    return folder


def _generated(folder: Path, name: str) -> dict[str, str]:
    """Return the generated files under their places in the project."""
    try:
        code = [path for path in sorted(folder.glob(f"{name}*")) if path.suffix in (".c", ".h", ".ld")]
        if not code:
            raise FileNotFoundError(2, "no code in it")
        files = {f"src/{path.name}": path.read_text(encoding="utf-8") for path in code}
        files |= {name: (folder / name).read_text(encoding="utf-8") for name in COPIED}
        return files | {"CONTROLLER.md": (folder / "README.md").read_text(encoding="utf-8")}
    except OSError as error:
        raise StorageError(
            f"write_project: '{folder}' cannot be read ({error.strerror}); generate the code again."
        ) from None
