"""Mutants at every door: a sentence or a sound value each, in time; nothing false where there is a checksum."""

import os
import resource
import shutil
import warnings
from collections import Counter

import numpy as np
import pytest
from doors import arrays, doors
from mutants import hurt

from ultraquiet._base.errors import UltraquietError

SLOWEST_S = 10.0
SEED = 16
GATE, CAMPAIGN = 36, 20_000


def spent():
    """Processor time of this process and its children."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def held(numbers, sound):
    """Whether arrays are what was there, or its beginning along time."""
    if len(numbers) != len(sound):
        return False
    return all(
        a.ndim == b.ndim and a.shape[-1] <= b.shape[-1] and np.array_equal(a, b[..., : a.shape[-1]])
        for a, b in zip(numbers, sound, strict=True)
    )


def fate(door, data, place, sound):
    """Read one mutant; return what came of it, and fail on what must not."""
    path = place / "mutant.h5"
    path.write_bytes(data)
    begun = spent()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of NumPy, on absurd numbers
            value = door.read(path)
    except UltraquietError as error:
        return "sentence" if str(error) else "silence", spent() - begun
    if sound is not None:
        assert held(arrays(value), sound), f"{door.name}: a wrong value was read as right"
    return "value", spent() - begun


def campaign(tmp_path, count):
    """Return fates by door, and the slowest mutant."""
    rng = np.random.default_rng(SEED)
    found = doors(tmp_path, rng)
    fates, slowest = {door.name: Counter() for door in found}, (0.0, "")
    before = {p for p in tmp_path.rglob("*") if "mutants" not in p.parts}
    for k in range(count):
        door = found[k % len(found)]
        place = tmp_path / "mutants"
        place.mkdir(exist_ok=True)
        lying = door.lies is not None and rng.random() < 0.6
        other = found[int(rng.integers(len(found)))].data
        data = door.lies(rng, door.data) if lying else hurt(rng, door.data, other)
        sound = None
        if door.summed and not lying:
            (place / "sound.h5").write_bytes(door.data)
            sound = arrays(door.read(place / "sound.h5"))
        try:
            word, took_s = fate(door, data, place, sound)
        except BaseException as error:
            shutil.copy(place / "mutant.h5", tmp_path / "failed") if (place / "mutant.h5").exists() else None
            raise AssertionError(f"mutant {k} of '{door.name}' ({'lie' if lying else 'hurt'}): {error!r}") from error
        fates[door.name][("lie " if lying else "hurt ") + word] += 1
        slowest = max(slowest, (took_s, f"{door.name} {k}"))
        if door.name != "coefficient bank":
            shutil.rmtree(place)
    after = {p for p in tmp_path.rglob("*") if "mutants" not in p.parts}
    assert after == before, "something outside the mutants' folder was touched"
    return fates, slowest


@pytest.mark.skipif(os.name != "posix", reason="no fork")
@pytest.mark.timeout(10800)
@pytest.mark.parametrize("count", [GATE, pytest.param(CAMPAIGN, marks=pytest.mark.slow)])
def test_mutants_at_every_door(tmp_path, count):
    if shutil.which("cc") is None:
        pytest.skip("no C compiler on this machine")
    fates, slowest = campaign(tmp_path, count)
    for name, counts in fates.items():
        print(f"{name}: {dict(sorted(counts.items()))}")
    print(f"{count} mutants: 0 tracebacks, 0 crashes, slowest {slowest[0]:.2f} s ({slowest[1]})")
    assert slowest[0] < SLOWEST_S
    assert not any("silence" in word for counts in fates.values() for word in counts)
    assert sum(sum(counts.values()) for counts in fates.values()) == count
