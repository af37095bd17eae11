"""`ultraquiet design`: one plant, one method."""

from pathlib import Path
from typing import Annotated

import typer

from ultraquiet._base.errors import InputError, NumericalError
from ultraquiet._base.shown.line import counted
from ultraquiet.cli.exits.codes import finish
from ultraquiet.cli.output.targets import beside, require_free
from ultraquiet.cli.progress import bars
from ultraquiet.cli.settings import completing
from ultraquiet.cli.settings import method as make


def design(
    plant: Annotated[Path, typer.Argument(help="A model or state space (HDF5), as `identify` leaves it.")],
    method: Annotated[
        str,
        typer.Option(autocompletion=completing("design"), help="A registered method; see `ultraquiet methods design`."),
    ] = "mixed-sensitivity",
    out: Annotated[
        Path | None, typer.Option(help="Where the controller goes (HDF5); default: beside the plant.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over an existing controller.")] = False,
    setting: Annotated[list[str] | None, typer.Option("--set", help="A setting of the method, key=value.")] = None,
) -> None:
    """Design a controller u = K y; a refusal says why and leaves nothing."""
    from ultraquiet import files
    from ultraquiet.cli.loop.facts import band_sentence, margins_facts, tones_facts, tones_grid
    from ultraquiet.cli.loop.loaded import loaded_plant
    from ultraquiet.cli.output.screen import screen
    from ultraquiet.design.robustness import described
    from ultraquiet.design.worst_direction import design_band, worst_direction
    from ultraquiet.values import StatusWord

    target = out or beside("design", plant, f"{method}.h5")
    require_free("design", target, force)
    system = loaded_plant(plant, "design")
    settings = make("design", method, setting or ())
    with bars():
        result = settings.design(system)
    law = result.controller
    if law is None:
        error = InputError if result.status.word is StatusWord.REFUSED else NumericalError
        raise error(f"design: {result.status.sentence}")
    if result.status.word is StatusWord.UNSTABLE:
        raise NumericalError(f"design: {result.status.sentence} Nothing was written.")
    files.save(law, target, overwrite=force)
    worst = worst_direction(system, law, design_band(settings, result.details))
    show = screen()
    show.say(
        result.status,
        *described(system, result.margins),
        band_sentence(worst.attenuation_db, worst.f_hz, worst.band_hz),
    )
    tones = tones_facts(result.details)
    if tones:
        show.table(tones_grid(tones))
    show.say(counted(law.states, "state"), f"controller: {target}")
    ends = {end: found for end, found in result.margins.items() if hasattr(found, "disk_all")}
    show.result(
        {
            "status": result.status,
            "controller": target,
            "states": law.states,
            "margins": margins_facts(system, ends),
            "peak_sensitivity_db": result.peak_sensitivity_db,
            "band_hz": worst.band_hz,
            "attenuation_db": worst.attenuation_db,
            "attenuation_hz": worst.f_hz,
            "tones": tones,
        }
    )
    finish(result.status)
