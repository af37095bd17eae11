"""`ultraquiet serve`: one study, one port of this machine, one token, until it is stopped."""

import contextlib
import os
import signal
import socket
import webbrowser
from collections.abc import Generator
from pathlib import Path
from typing import Any

import uvicorn
from fastapi import FastAPI
from fastapi.responses import FileResponse, Response
from nicegui import ui

from ultraquiet._base.errors import InputError, StorageError
from ultraquiet.chart.assets import script, style
from ultraquiet.workbench.engine.leftovers import alone
from ultraquiet.workbench.engine.making.imports import inside
from ultraquiet.workbench.engine.session import Session
from ultraquiet.workbench.jobs.board import Jobs
from ultraquiet.workbench.web.frames import FrameStore
from ultraquiet.workbench.web.guard import HOSTS, RequestGuard, new_token
from ultraquiet.workbench.web.pages.all_pages import add_pages
from ultraquiet.workbench.web.place import ServedStudy

HERE = Path(__file__).parent / "static"
PATIENCE_S, BACKLOG = 2, 128
REPORT = "report.html"


class _Server(uvicorn.Server):
    """A server whose stop is its normal end: signals do not go on to end the process."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None]:
        """Leave signals to `stops_on_signals`."""
        yield

    def stops_on_signals(self) -> None:
        """Stop serving on SIGINT and SIGTERM, from now on and not only once the server is up."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._stop)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to serve; who was stopped meanwhile is brought down as it came up."""
        await super().startup(sockets)
        if self.should_exit and self.started:
            await self.shutdown(sockets)

    def _stop(self, *_: Any) -> None:
        self.should_exit = True


def serve(folder: Path, port: int = 0, opens: bool = False) -> None:
    """Serve a study folder on 127.0.0.1 until stopped; print its address, with the token of this start, on one line.

    Args:
        folder: of the study; made when absent.
        port: 0 takes a free one.
        opens: whether the browser is told to show it.

    Raises:
        StorageError: the port is taken, another workbench is open on the folder, or it cannot be used.
    """
    with alone(Path(os.path.realpath(folder))):
        _serve(folder, port, opens)


def _serve(folder: Path, port: int, opens: bool) -> None:
    session = Session(folder)
    listener = _listener(port)
    number = listener.getsockname()[1]
    token = new_token()
    place = ServedStudy(session, Jobs(session), FrameStore())
    app = RequestGuard(_application(place), number, token)
    address = f"http://{HOSTS[0]}:{number}/?token={token}"
    config = uvicorn.Config(
        app, log_level="warning", access_log=False, lifespan="on", timeout_graceful_shutdown=PATIENCE_S, ws="auto"
    )
    server = _Server(config)
    server.stops_on_signals()
    place.jobs.warm()
    print(address, flush=True)
    if opens:
        webbrowser.open(address)
    try:
        server.run(sockets=[listener])
    finally:
        place.jobs.close()


def _listener(port: int) -> socket.socket:
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOSTS[0], port))
        listener.listen(BACKLOG)  # whoever reads the address may call at once, and waits until there is an answer
    except OSError as error:
        listener.close()
        raise StorageError(
            f"serve: port {port} cannot be used ({error.strerror}); take another with --port, or 0 for a free one."
        ) from error
    return listener


def _application(place: ServedStudy) -> Any:
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    _add_files(app, place)
    add_pages(place)
    ui.run_with(
        app,
        title="Ultraquiet",
        dark=None,
        favicon=HERE / "icon.svg",
        reconnect_timeout=10.0,
        show_welcome_message=False,
    )
    return app


def _add_files(app: FastAPI, place: ServedStudy) -> None:
    """Add what pages fetch besides themselves: the chart component, frames, and files of the study."""
    texts = {"uq.js": (script(), "text/javascript"), "uq.css": (style(), "text/css")}
    texts["workbench.css"] = ((HERE / "workbench.css").read_text("utf-8"), "text/css")
    texts["workbench.js"] = ((HERE / "workbench.js").read_text("utf-8"), "text/javascript")

    @app.get("/own/{name}")
    def own(name: str) -> Response:
        if name not in texts:
            return Response("There is no such file.\n", 404, media_type="text/plain")
        return Response(texts[name][0], media_type=texts[name][1])

    @app.get("/frames/{name}")
    def frame(name: str) -> Response:
        found = place.frames.get(name)
        if found is None:
            return Response("This frame is no longer kept; reload the page.\n", 404, media_type="text/plain")
        return Response(found, media_type="application/octet-stream", headers={"cache-control": "no-store"})

    @app.get("/study/{name:path}")
    def study_file(name: str) -> Response:
        try:
            path = inside(place.session.folder, name)
        except InputError as error:
            return Response(f"{error}\n", 403, media_type="text/plain")
        if not path.is_file() or any(part.startswith(".") for part in Path(name).parts):
            return Response(f"The study holds no file '{name}'.\n", 404, media_type="text/plain")
        # only what this program wrote is shown as a page: a dropped one could speak in its name
        shown = None if name == REPORT else path.name
        return FileResponse(path, filename=shown, headers={"cache-control": "no-store"})

    @app.post("/stop")
    def stop() -> Response:
        place.stop()
        return Response("stopped\n", media_type="text/plain")
