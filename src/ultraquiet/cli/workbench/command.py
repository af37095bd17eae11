"""`ultraquiet serve`: the workbench, a study by hand in the browser."""

from importlib import util
from pathlib import Path
from typing import Annotated

import typer

from ultraquiet._base.constraints import whole
from ultraquiet._base.errors import InputError, ToolError

PACKAGE = "nicegui"


def serve(
    folder: Annotated[Path, typer.Argument(help="Folder of the study; made when absent.")] = Path("ultraquiet-study"),
    port: Annotated[int, typer.Option(help="Port on 127.0.0.1; 0 takes a free one.")] = 0,
    opens: Annotated[bool, typer.Option("--open/--no-open", help="Show it in the browser.")] = True,
) -> None:
    """Serve the workbench on this machine alone, until stopped; its address stands on one line."""
    whole("serve", "port", port, 0, 65535)
    if folder.is_file():
        raise InputError(f"serve: '{folder}' is a file; name the folder of a study, it is made when absent.")
    if util.find_spec(PACKAGE) is None:
        raise ToolError("serve: the workbench needs NiceGUI; install it with:  pip install 'ultraquiet[workbench]'")
    from ultraquiet.workbench.web.server import serve as serve_study

    serve_study(folder, port, opens)
