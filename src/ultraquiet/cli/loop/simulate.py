"""`ultraquiet simulate`: what a loop does under tones, noise and steps, on a bench or on a model."""

from pathlib import Path
from typing import Annotated

import typer

from ultraquiet.cli.exits.codes import finish
from ultraquiet.cli.progress import bars


def simulate(
    law: Annotated[Path, typer.Argument(help="A controller (HDF5), as `design` leaves it.")],
    bench: Annotated[
        Path | None, typer.Option(metavar="STUDY.toml", help="Run on the bench of this study file.")
    ] = None,
    plant: Annotated[Path | None, typer.Option(metavar="MODEL", help="Run on a linear model (HDF5).")] = None,
    unit: Annotated[
        str | None, typer.Option(help="With --bench: which unit; default: the first of the study's [closed_loop].")
    ] = None,
    tones: Annotated[
        str | None, typer.Option(help="Hz, separated by commas: reduction of each tone; 'default' takes the study's.")
    ] = None,
    noise: Annotated[bool, typer.Option("--noise", help="RMS under broadband noise, open against closed.")] = False,
    step: Annotated[bool, typer.Option("--step", help="Peak and settling of a step at each actuator.")] = False,
    band: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="LOW HIGH", help="Hz, of the noise; default: the study's band, or the model's own."),
    ] = None,
    amplitude: Annotated[
        float | None,
        typer.Option(
            help="Of every disturbance, in the actuators' unit; default: the study's, or a tenth of the range."
        ),
    ] = None,
    duration: Annotated[float | None, typer.Option(help="Seconds of each run; default: the study's, or 2.")] = None,
    seed: Annotated[int, typer.Option(help="Of the noise.")] = 0,
) -> None:
    """Close the loop on a bench or a model and measure tones, noise and steps; all three when none is asked for."""
    from ultraquiet.cli.loop.loaded import loaded_law
    from ultraquiet.cli.loop.measured import Wanted, measure
    from ultraquiet.cli.loop.places import place_of
    from ultraquiet.cli.output.screen import screen

    place = place_of(bench, plant, unit)
    controller = loaded_law(law, "simulate")
    some = tones is not None or noise or step
    wanted = Wanted.of(
        place, tones, noise or not some, step or not some, None if some else "default", band, amplitude, duration, seed
    )
    show = screen()
    with bars():
        status = place.stability(controller)
        found = measure(place, controller, wanted) if status.ok else None
    show.say(f"{law} on {place.name}", *place.notes, status)
    facts: dict[str, object] = {"law": law, "on": place.name, "status": status}
    if found is not None:
        for grid in found.grids(place):
            show.say("")
            show.table(grid)
        show.say(*found.remarks())
        facts |= found.facts(place)
    show.result(facts)
    finish(status)
