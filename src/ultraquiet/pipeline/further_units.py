"""Models of a bench's further units, made by themselves: as the stages of a study make them."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

from ultraquiet._base.errors import InputError
from ultraquiet.pipeline.facts.models import PlantFacts
from ultraquiet.pipeline.identification import further, of_unit
from ultraquiet.pipeline.making.designs import plant_key
from ultraquiet.pipeline.preflight import as_unit
from ultraquiet.pipeline.stage import Cache
from ultraquiet.pipeline.study import Study
from ultraquiet.pipeline.tables.blending import blended
from ultraquiet.pipeline.walk import bench_key_of, bench_of, described, with_read_matrices
from ultraquiet.values import Record, StateSpace


def further_plants(
    study: Study, records: Mapping[str, Record], folder: Path, cache: Cache | None = None
) -> dict[str, StateSpace]:
    """Return the model of every further unit that `[plant]` names: the records' signals, sent on that unit's bench.

    Args:
        study: names the bench and the units.
        records: of the study, all of them.
        folder: of the study, beside which its bench's file is sought.
        cache: the stages of the study, where a model is read that is there; made here alone when absent.

    Raises:
        InputError: the study has no bench, or its bench knows no such unit.
    """
    own = bench_of(study, folder)
    if own is None:
        raise InputError("plant: 'units' are those of a bench, and the study has none.")
    study = with_read_matrices(study, folder)
    bench = own if study.blending is None else blended(own, study.blending)
    bench_key = bench_key_of(study, described(own, study, folder))
    hashes = {name: record.hash for name, record in records.items()}
    found: dict[str, StateSpace] = {}
    for unit in study.plant.units:
        compute = partial(further, as_unit(bench, unit), unit, records, study.plant)
        key = [*plant_key(hashes, study.plant), bench_key, unit]
        outcome = compute() if cache is None else cache.stage(f"plant-{unit}", "models", key, compute, PlantFacts)
        found[unit] = outcome.values[of_unit(unit)]
    return found
