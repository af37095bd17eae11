"""What `ultraquiet deploy` writes for other programs beside the code."""

from pathlib import Path
from typing import TYPE_CHECKING

from ultraquiet._base.constraints import one_of
from ultraquiet._base.errors import InputError
from ultraquiet.cli.output.screen import screen
from ultraquiet.cli.output.targets import is_folder, require_free, require_free_folder

if TYPE_CHECKING:
    from ultraquiet.deploy import Deployment
    from ultraquiet.values import StateSpace, Status


def require_writable(
    law: "StateSpace",
    folder: Path,
    fmu: Path | None,
    fmi: str,
    export: list[Path] | None,
    project: Path | None,
    force: bool,
) -> None:
    """Refuse what could not be written later, or would write over something, before any work is done."""
    from ultraquiet.deploy import foton_text
    from ultraquiet.deploy.exchange.exchange import FORMATS
    from ultraquiet.deploy.exchange.fmu import VERSIONS

    one_of("deploy", "--fmi", fmi, VERSIONS)
    if fmu is not None:
        require_free("deploy", fmu, force, (".fmu",), "--fmu")
    for path in export or []:
        require_free("deploy", path, force, tuple(FORMATS), "--export")
        if path.suffix.lower() == ".txt":
            foton_text(law)
    if project is None:
        return
    require_place(project, force, "--project")
    code, around = folder.resolve(), project.resolve()
    if code.is_relative_to(around) or around.is_relative_to(code):
        raise InputError(f"deploy: --project '{project}' and the code's folder '{folder}' must not lie in each other.")
    inside = [path for path in (fmu, *(export or [])) if path is not None and path.resolve().is_relative_to(around)]
    if inside:
        raise InputError(f"deploy: --project '{project}' is replaced as a whole; write '{inside[0]}' beside it.")


def require_place(folder: Path, force: bool, option: str, *read: Path | None) -> None:
    """Refuse a folder that is taken and may not be replaced, that is somebody else's, or that holds what is read.

    A folder is replaced as a whole: a law or a plant in it would be gone.
    """
    from ultraquiet.deploy.c_code.output_folder import require_ours

    if is_folder("deploy", folder, option):
        require_ours(folder)
    require_free_folder("deploy", folder, force, option)
    for path in read:
        if path is not None and path.resolve().is_relative_to(folder.resolve()) and folder.exists():
            raise InputError(
                f"deploy: the folder '{folder}' is replaced as a whole, and '{path}' stands in it; choose another "
                f"{option}."
            )


def show_exports(
    law: "StateSpace",
    deployment: "Deployment",
    *,
    fmu: Path | None,
    fmi: str,
    export: list[Path] | None,
    project: Path | None,
) -> "Status | None":
    """Write what was asked for and say where it is; return the verdict on the FMU, if there is one."""
    from ultraquiet.deploy import export_law, write_fmu, write_project

    say = screen().say
    status = None
    if fmu is not None:
        unit = write_fmu(deployment, fmu, fmi)
        status = unit.status
        say(f"{unit.path}: FMI {unit.version}. {status.sentence}")
    for path in export or []:
        say(f"{export_law(law, path)}: the law's coefficients, in float64.")
    if project is not None:
        say(f"{write_project(deployment, project)}: a project for CMake.")
    return status
