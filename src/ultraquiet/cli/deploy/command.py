"""`ultraquiet deploy`: a controller as C99, compiled and compared."""

from pathlib import Path
from typing import Annotated

import typer

from ultraquiet._base.constraints import one_of
from ultraquiet.cli.deploy.exports import require_place, require_writable, show_exports
from ultraquiet.cli.deploy.frame import requested_frame, show_frames
from ultraquiet.cli.deploy.margins import rounded_loop
from ultraquiet.cli.deploy.ranges import refuse_range, requested_limits, require_steps
from ultraquiet.cli.deploy.table import requested_targets, rows
from ultraquiet.cli.deploy.word_lengths import FIXED, PRECISIONS, deploy_fixed, refuse_others, show_word_lengths
from ultraquiet.cli.exits.codes import finish
from ultraquiet.values.status import CODE_FAULTS


def deploy(
    controller: Annotated[Path, typer.Argument(help="A controller (HDF5), as `design` leaves it.")],
    out: Annotated[Path | None, typer.Option(help="Folder for the code; default: beside the controller.")] = None,
    precision: Annotated[str, typer.Option(help="float32, float64, or whole numbers: q31, q15.")] = "float32",
    form: Annotated[str, typer.Option(help="auto, modal, delta, schur, dense, bank ...")] = "auto",
    limits: Annotated[
        str | None, typer.Option(help="Largest command: SIZE, or a SIZE or LOW:HIGH for each; default: the actuators'.")
    ] = None,
    reading: Annotated[
        str | None, typer.Option("--range", help="Largest reading, for q31 and q15; default: the sensors'.")
    ] = None,
    anti_windup: Annotated[
        bool, typer.Option("--anti-windup", help="Correct the state by what the limits take away.")
    ] = False,
    plant: Annotated[Path | None, typer.Option(help="A plant (HDF5): analyse the loop with the rounded law.")] = None,
    budget: Annotated[
        int | None, typer.Option(help="Cycles of a TMS320C31 that a frame may take; refuse a law that needs more.")
    ] = None,
    target: Annotated[
        list[str] | None,
        typer.Option(help="An emulated processor (cortex-m7) or none; may be repeated; default: all."),
    ] = None,
    word_lengths: Annotated[
        bool, typer.Option("--word-lengths", help="Only print what each precision and form would lose.")
    ] = False,
    steps: Annotated[int, typer.Option(help="Samples to compare bit by bit.")] = 100_000,
    fmu: Annotated[Path | None, typer.Option(help="Write the controller as this FMU, too.")] = None,
    fmi: Annotated[str, typer.Option(help="With --fmu: 3.0 or 2.0 of the standard.")] = "3.0",
    export: Annotated[
        list[Path] | None, typer.Option(help="Write the law as .mat, .h5, .csv or foton's .txt; may be repeated.")
    ] = None,
    project: Annotated[
        Path | None, typer.Option(help="Write a folder with CMake and a workflow around the code.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over the code and what the options name.")] = False,
    frame: Annotated[bool, typer.Option("--frame", help="Simulate the real-time frame around the code.")] = False,
    frames: Annotated[int, typer.Option(help="With --frame: how many.")] = 1_000_000,
    load: Annotated[float, typer.Option(help="With --frame: share of a frame that background work needs.")] = 0.5,
    jitter_us: Annotated[float, typer.Option(help="With --frame: largest delay of the interrupt.")] = 0.0,
    frame_on: Annotated[str, typer.Option(help="With --frame: c31, or an emulated processor, cortex-m7 say.")] = "c31",
    overload: Annotated[str | None, typer.Option(help="With --frame: extra work, FIRST:FRAMES:MICROSECONDS.")] = None,
) -> None:
    """Generate C99, compile it here and for emulated processors, and compare it bit by bit with Python."""
    from ultraquiet import deploy as room
    from ultraquiet.cli.loop.facts import margins_facts
    from ultraquiet.cli.loop.loaded import loaded_law, loaded_plant
    from ultraquiet.cli.output.screen import plain, screen
    from ultraquiet.cli.output.text_table import TextTable

    law = loaded_law(controller, "deploy")
    real_time = requested_frame(law.rate_hz, frame_on, frames, load, jitter_us, overload) if frame else None
    one_of("deploy", "precision", precision, PRECISIONS)
    folder = out or controller.with_suffix("")
    require_steps(steps)
    ranges = requested_limits(limits, law)
    if not word_lengths:
        require_place(folder, force, "--out", controller, plant)
    if word_lengths or precision in FIXED:
        refuse_others(precision, word_lengths, anti_windup, budget, target, fmu, export, project, frame)
        system = None if plant is None else loaded_plant(plant)
        if word_lengths:
            finish(show_word_lengths(law, system, limits, reading))
        else:
            finish(*deploy_fixed(law, folder, precision, form, system, steps, limits, reading))
        return
    refuse_range(reading, precision)
    require_writable(law, folder, fmu, fmi, export, project, force)
    targets = requested_targets(target)
    system = None if plant is None else loaded_plant(plant)
    budgeted = {} if budget is None else {"budget_cycles": budget, "enforce_budget": True}
    asked = {"form": form, "anti_windup": anti_windup, **budgeted}
    deployment = room.generate(law, folder, precision, limits_v=ranges, plant=system, **asked)
    verified = deployment.verify(steps, targets=targets)
    show = screen()
    grid = TextTable(("what", "value"), f"{folder}")
    for row in rows(deployment, verified, c31=budget is not None):
        grid.add(*row)
    show.table(grid)
    show.say(deployment.status, verified.status)
    loop = None if system is None else rounded_loop(system, deployment.quantised, law)
    if loop is not None:
        show.say(*loop.lines)
    facts = {
        "folder": folder,
        "status": deployment.status,
        "verified": verified.status,
        "loop": None if loop is None else loop.status,
        "margins": {} if system is None or loop is None else margins_facts(system, loop.ends),
        "tables": plain(deployment.tables),
    }
    if verified.status.word in CODE_FAULTS:
        show.result(facts)
        finish(verified.status)
    exported = show_exports(law, deployment, fmu=fmu, fmi=fmi, export=export, project=project)
    framed = None
    if real_time is not None:
        figure = folder.with_name(f"{folder.name}-frame.svg")
        framed = show_frames(deployment, real_time, frames, frame_on, figure)
    show.result({**facts, "fmu": exported, "frame": framed})
    finish(deployment.status, verified.status, exported, framed, None if loop is None else loop.status)
