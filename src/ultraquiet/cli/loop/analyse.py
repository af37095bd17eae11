"""`ultraquiet analyse`: what a loop keeps, before it is tried."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ultraquiet.cli.exits.codes import finish

LINES = 500  # evenly spaced, so that loci are smooth up to the Nyquist frequency

if TYPE_CHECKING:
    from ultraquiet.design.loop_analysis import LoopAnalysis
    from ultraquiet.plot import Figure
    from ultraquiet.values import StateSpace


def analyse(
    plant: Annotated[Path, typer.Argument(help="A model or state space (HDF5), as `identify` leaves it.")],
    law: Annotated[Path, typer.Argument(help="A controller (HDF5), as `design` leaves it.")],
    band: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="LOW HIGH", help="Hz, where attenuation counts; default: the plant's own band."),
    ] = None,
    disk_margin: Annotated[
        float | None, typer.Option(help="What an ok loop keeps at both ends, all channels at once; default: 0.2.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the figures; nothing in it is written over.")] = None,
    form: Annotated[str, typer.Option("--format", help="Of the figures: svg or png.")] = "svg",
) -> None:
    """Say what a loop keeps: stability, margins at both ends, peaks of S, T and KS, attenuation over a band."""
    from ultraquiet.cli.loop.facts import band_sentence, margins_facts, margins_grid, peaks_grid, slowest_sentence
    from ultraquiet.cli.loop.loaded import loaded_law, loaded_plant, require_fit, require_order
    from ultraquiet.cli.output.pictures import require_folder, require_format, save_pictures
    from ultraquiet.cli.output.screen import screen
    from ultraquiet.design.loop_analysis import analyse_loop
    from ultraquiet.design.robustness import DISK_MARGIN, described

    require_format("analyse", form)
    if out is not None:
        require_folder("analyse", out)
    system, controller = loaded_plant(plant, "analyse"), loaded_law(law, "analyse")
    require_fit("analyse", system, controller)
    require_order(law, system, controller)
    found = analyse_loop(system, controller, band, DISK_MARGIN if disk_margin is None else disk_margin)
    show = screen()
    show.say(str(found.status), slowest_sentence(found.slowest), "")
    show.table(margins_grid(system, found.margins))
    show.say(*described(system, found.margins), "")
    show.table(peaks_grid(found))
    show.say(band_sentence(found.attenuation_db, found.attenuation_hz, found.band_hz))
    pictures: list[Path] = []
    if out is not None:
        pictures = save_pictures("analyse", figures(system, controller, found, law.stem), out, law.stem, form)
        show.say(*(f"figure: {path}" for path in pictures))
    show.result(
        {
            "plant": plant,
            "law": law,
            "status": found.status,
            "stable": found.stable,
            "slowest": found.slowest,
            "margins": margins_facts(system, found.margins),
            "peaks": found.peaks,
            "band_hz": found.band_hz,
            "attenuation_db": found.attenuation_db,
            "attenuation_hz": found.attenuation_hz,
            "figures": pictures,
        }
    )
    finish(found.status)


def figures(plant: "StateSpace", law: "StateSpace", found: "LoopAnalysis", name: str) -> "list[Figure]":
    """Return the loop's singular values and its eigenvalue loci."""
    import numpy as np

    from ultraquiet.analyse.margins import default_grid
    from ultraquiet.plot.loop import nyquist_figure, sensitivity_figure

    f, values = found.gang.singular_values()
    reached = min(plant.D.shape)  # of T and of the open loop no other direction is more than rounding
    members = {"S": values["So"], "T": values["To"][:reached], "KS": found.command_scale * values["KSo"]}
    units = {"KS": f" re {found.peaks['KS'].unit}"} if found.peaks["KS"].unit else {}
    grid = default_grid(plant)
    lines = np.unique(np.concatenate([f, grid, np.linspace(grid[0], grid[-1], LINES)]))
    first, second = (plant, law) if plant.D.shape[0] == reached else (law, plant)
    loop = np.einsum("ijf,jkf->ikf", first.frequency_response(lines), second.frequency_response(lines))
    return [sensitivity_figure(name, f, members, units, found.band_hz), nyquist_figure(name, loop)]
