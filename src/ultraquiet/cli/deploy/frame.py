"""`ultraquiet deploy --frame`: the time line of a frame, a table and a figure."""

from pathlib import Path
from typing import TYPE_CHECKING

from ultraquiet._base.constraints import one_of
from ultraquiet._base.errors import InputError
from ultraquiet.cli.output.pictures import save_numbered
from ultraquiet.cli.output.screen import screen
from ultraquiet.cli.output.text_table import TextTable

if TYPE_CHECKING:
    from ultraquiet.deploy import Deployment, Frame, FrameTimes, Overload
    from ultraquiet.values import Status

C31 = "c31"
RESTART_S = 1.0  # without overruns; long beside a ramp, short for who waits


def requested_frame(
    rate_hz: float | None, processor: str, frames: int, load: float, jitter_us: float, overload: str | None
) -> "Frame":
    """Return the frame that was asked for, or refuse it before anything is written."""
    from ultraquiet.deploy import Frame
    from ultraquiet.deploy.toolchain.targets import TARGETS

    one_of("deploy", "frame_on", processor, (C31, *TARGETS))
    injected = () if overload is None else (parse_overload(overload),)
    frame = Frame(load=load, jitter_s=1e-6 * jitter_us, overloads=injected, restart_s=RESTART_S)
    if rate_hz is not None:
        frame.require(frames, 1.0 / rate_hz)
    return frame


def show_frames(deployment: "Deployment", frame: "Frame", frames: int, processor: str, figure: Path) -> "Status":
    """Simulate frames of a deployment, print time line, table and verdict, draw `figure` (SVG); return the verdict."""
    from ultraquiet.deploy.figures import figure_text, figure_words
    from ultraquiet.plot import draw_svg
    from ultraquiet.plot.frame import frame_figure

    simulation = frame.simulate(deployment, frames, times=times_on(deployment, processor))
    grid = TextTable(("what", "value"), "the real-time frame")
    for what, value in simulation.table.items():
        grid.add(figure_words(what), figure_text(value) if value is None or isinstance(value, bool) else str(value))
    show = screen()
    show.say(simulation.timeline())
    show.table(grid)
    show.say(simulation.status)
    drawn = save_numbered(figure, draw_svg(frame_figure(simulation)).encode())
    show.say(f"figure: {drawn}")
    return simulation.status


def times_on(deployment: "Deployment", processor: str) -> "FrameTimes":
    """Return the frame's times on a processor: the C31's model, or instructions counted by an emulated processor."""
    from ultraquiet.deploy import FrameTimes

    return FrameTimes.c31(deployment.law) if processor == C31 else FrameTimes.on_target(deployment, processor)


def parse_overload(text: str) -> "Overload":
    """Return FIRST:FRAMES:US as an overload.

    >>> parse_overload("1000:300:500").frames
    300
    """
    from ultraquiet.deploy import Overload

    try:
        first, frames, extra_us = text.split(":")
        return Overload(int(first), int(frames), 1e-6 * float(extra_us))
    except InputError:
        raise
    except ValueError:
        raise InputError(f"deploy: an overload is FIRST:FRAMES:MICROSECONDS, 1000:300:500 say, got '{text}'.") from None
