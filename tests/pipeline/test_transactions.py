"""A study's folder through kills, hands and a second run: the right numbers or a sentence, and no stray file."""

import fcntl
import json
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
import small_study

import ultraquiet as uq
from ultraquiet.pipeline import stage as pipeline_stage
from ultraquiet.pipeline.stage import Cache, Outcome
from ultraquiet.pipeline.store.lock import FILE, locked
from ultraquiet.pipeline.store.sweep import sweep
from ultraquiet.pipeline.walk import _on_a_disk

SCRIPT = Path(__file__).with_name("dying_stage.py")
ENVIRONMENT = {**os.environ, "PYTHONWARNINGS": "ignore"}


def law(gain):
    """A stage's outcome whose facts, value and generated folder tell one number."""
    return uq.StateSpace([[0.5]], [[1.0]], [[gain]], [[0.0]], rate_hz=10.0)


def stage(folder, gain, say=print, computed=None):
    """Take a stage that leaves two values and a folder, and check that all of it tells the same number."""
    cache = Cache(folder, say)

    def compute():
        if computed is not None:
            computed.append(gain)
        place = cache.workplace("code", "calm") / "calm"
        (place / "sub").mkdir(parents=True)
        (place / "controller.c").write_text(f"double gain = {gain};\n")
        (place / "sub" / "README").write_text("the same whatever the gain\n")
        return Outcome({"plant": law(gain), "law": law(2 * gain)}, {"gain": gain})

    kept = cache.stage("make", "code", {"gain": gain}, compute, writes="calm")
    assert kept.facts == {"gain": gain}
    assert (kept.values["plant"].C[0, 0], kept.values["law"].C[0, 0]) == (gain, 2 * gain)
    assert uq.files.load(folder / "code" / "plant.h5").C[0, 0] == gain
    assert (folder / "code" / "calm" / "controller.c").read_text() == f"double gain = {gain};\n"
    return kept


def names(folder):
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if not p.is_dir())


WHOLE = ["code/calm/controller.c", "code/calm/sub/README", "code/law.h5", "code/plant.h5", "stages/make.json"]


@pytest.fixture(scope="module")
def die():
    """Has a stage begun in a process that is killed at its n-th change of the folder; tells whether it lived."""
    with subprocess.Popen(
        [sys.executable, str(SCRIPT)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=ENVIRONMENT
    ) as server:
        assert server.stdin is not None
        assert server.stdout is not None
        assert server.stdout.readline() == "ready\n"

        def begun(folder, gain, death):
            server.stdin.write(json.dumps([str(folder), gain, death]) + "\n")
            server.stdin.flush()
            return json.loads(server.stdout.readline())

        yield begun
        server.stdin.close()
        server.wait(30)


@pytest.mark.gate("edited-settings stay")
@pytest.mark.parametrize("back", [1.0, 2.0], ids=["settings go back", "settings stay"])
@pytest.mark.parametrize("edited", [False, True], ids=["untouched", "edited"])
def test_a_stage_killed_at_any_of_its_changes_is_the_old_one_or_the_new_one(back, edited, die, tmp_path):
    """Every change of the folder is tried; afterwards the numbers are right, nothing is stray, no edit is lost."""
    before = tmp_path / "before"
    before.mkdir()
    stage(before, 1.0)
    if edited:
        (before / "code" / "calm" / "controller.c").write_text("mine\n")
    reused, deaths, lived = 0, 0, False
    while not lived:
        deaths += 1
        folder = shutil.copytree(before, tmp_path / str(deaths))
        lived = die(folder, 2.0, deaths)
        computed = []
        sweep(folder)
        stage(folder, back, computed=computed)
        reused += not computed
        sweep(folder)
        kept = [name for name in names(folder) if name not in WHOLE]
        assert set(names(folder)) >= set(WHOLE)
        if edited:
            assert [(folder / name).read_text() for name in kept if name.endswith(".c")] == ["mine\n"]
            kept = [name for name in kept if not name.startswith("code/calm.edited/")]
        assert not kept
    print(
        f"killed at each of {deaths - 1} changes: right numbers, nothing stray; {reused} times nothing was made again"
    )
    assert deaths > 10
    assert reused > 0 or (edited and back == 1.0)


def test_a_stage_killed_between_its_values_and_its_facts_is_not_trusted(die, tmp_path):
    """The old settings find what the old facts tell, wherever the run with the new ones was killed."""
    found = Counter()
    for death in range(1, 60):
        folder = tmp_path / str(death)
        folder.mkdir()
        stage(folder, 1.0)
        if die(folder, 2.0, death):
            break
        computed = []
        back = stage(folder, 1.0, computed=computed)  # without a sweep: the next run may be another program's
        found["made again" if computed else "reused"] += 1
        assert back.values["plant"].C[0, 0] == back.facts["gain"] == 1.0
    print(dict(found))
    assert found["reused"] > 0
    assert found["made again"] > 0


def test_a_stage_is_valid_from_the_writing_of_its_entry_on(tmp_path, monkeypatch):
    """What dies there has written the new values, and the old ones are read with the old facts."""

    def settings(gain):
        return Cache(tmp_path).stage("plant", "models", gain, lambda: Outcome({"plant": law(gain)}, {"gain": gain}))

    assert not settings(1.0).reused
    with monkeypatch.context() as patch:
        patch.setattr(pipeline_stage, "write_bytes", lambda *_: sys.exit(9))
        with pytest.raises(SystemExit):
            settings(2.0)
    waiting = [uq.files.load(path).C[0, 0] for path in (tmp_path / "models").glob(".*.h5.part")]
    back = settings(1.0)
    assert waiting == [2.0]
    assert (back.reused, back.facts["gain"], back.values["plant"].C[0, 0]) == (True, 1.0, 1.0)


HANDS = {
    "edited": (lambda f: (f / "code/calm/controller.c").write_text("mine\n"), "controller.c edited", True),
    "added": (lambda f: (f / "code/calm/mine.c").write_text("mine\n"), "mine.c added", True),
    "deleted": (lambda f: (f / "code/calm/sub/README").unlink(), "sub/README deleted", False),
    "gone": (lambda f: shutil.rmtree(f / "code/calm"), "controller.c deleted", False),
    "a value": (lambda f: uq.files.save(law(7.0), f / "code/plant.h5"), "code/plant.h5 is not what", True),
    "no value": (lambda f: (f / "code/law.h5").unlink(), "code/law.h5 is not what", False),
    "a damaged value": (lambda f: (f / "code/law.h5").write_bytes(b"torn"), "code/law.h5 is not what", True),
}


@pytest.mark.parametrize("hand", HANDS)
def test_what_a_hand_has_changed_is_said_kept_and_made_again(hand, tmp_path):
    change, sentence, keeps = HANDS[hand]
    stage(tmp_path, 1.0)
    change(tmp_path)
    hands = {name: (tmp_path / name).read_bytes() for name in names(tmp_path)}
    said, computed = [], []
    stage(tmp_path, 1.0, said.append, computed)
    print(*said, sep="\n")
    assert computed == [1.0]
    assert sentence in said[0]
    kept = [name for name in names(tmp_path) if ".edited" in name]
    assert bool(kept) == keeps == (len(said) > 1 and ".edited" in said[1])
    for name in kept:
        assert (tmp_path / name).read_bytes() == hands[name.replace(".edited", "")]
    stage(tmp_path, 1.0, said.append, computed)
    assert computed == [1.0]


def test_a_hand_s_work_outlives_other_settings_and_a_second_change(tmp_path):
    stage(tmp_path, 1.0)
    for k, gain in enumerate((2.0, 3.0)):
        (tmp_path / "code/calm/controller.c").write_text(f"mine {k}\n")
        stage(tmp_path, gain)
    edits = [(tmp_path / f"code/calm{end}/controller.c").read_text() for end in (".edited", ".edited-2")]
    assert edits == ["mine 0\n", "mine 1\n"]


def test_facts_that_a_hand_has_changed_are_said_and_made_again(tmp_path):
    stage(tmp_path, 1.0)
    path = tmp_path / "stages" / "make.json"
    path.write_text(path.read_text().replace('"gain": 1.0', '"gain": 5.0'))
    said = []
    stage(tmp_path, 1.0, said.append)
    assert "changed by hand" in said[0]
    assert names(tmp_path) == WHOLE


def test_what_a_stage_leaves_no_more_goes_and_what_a_hand_made_of_it_stays(tmp_path):
    cache = Cache(tmp_path)

    def stage_of(*tones):
        return cache.stage("loop", "loops", tones, lambda: Outcome({f"{tone}hz": law(tone) for tone in tones}, {}))

    stage_of(5, 25, 100)
    uq.files.save(law(1.0), tmp_path / "loops" / "25hz.h5")
    stage_of(5)
    assert names(tmp_path) == ["loops/25hz.h5", "loops/5hz.h5", "stages/loop.json"]


def test_a_folder_of_the_version_before_is_made_again_without_a_word(tmp_path):
    (tmp_path / "code" / "calm").mkdir(parents=True)
    (tmp_path / "stages").mkdir()
    (tmp_path / "code" / "calm" / "controller.c").write_text("as it was\n")
    uq.files.save(law(9.0), tmp_path / "code" / "plant.h5")
    older = {"key": "0", "seconds": 1.0, "values": {"plant": "code/plant.h5"}, "facts": {"gain": 9.0}}
    (tmp_path / "stages" / "make.json").write_text(json.dumps(older))
    said = []
    stage(tmp_path, 1.0, said.append)
    assert not said
    assert names(tmp_path) == WHOLE


def test_a_full_disk_is_a_sentence_and_no_finding_about_the_law(tmp_path, monkeypatch):
    stage(tmp_path, 1.0)
    before = names(tmp_path)

    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(uq.errors.StorageError, match="no space left on device"):
            stage(tmp_path, 2.0)
    computed = []
    stage(tmp_path, 1.0, computed=computed)
    sweep(tmp_path)
    assert not computed
    assert names(tmp_path) == before

    def code():
        raise uq.errors.StorageError("deploy: cannot write (no space left on device).")

    with pytest.raises(uq.errors.StorageError):
        Cache(tmp_path).stage("deploy", "code", "key", code)


def test_what_a_disk_refuses_is_one_sentence_wherever_it_does(tmp_path):
    sentence = re.escape("'/there/x' could not be written or read (no space left")
    with pytest.raises(uq.errors.StorageError, match=sentence), _on_a_disk(tmp_path):
        raise OSError(28, "No space left on device", "/there/x")
    with pytest.raises(uq.errors.StorageError, match="closed"), _on_a_disk(tmp_path):
        raise uq.errors.StorageError("closed.")


def test_a_second_run_beside_a_first_is_refused_and_nothing_is_touched(run, tmp_path):
    study = small_study.written(tmp_path)
    (tmp_path / "out").mkdir()
    with small_study.known(), locked(tmp_path / "out", print):
        before = names(tmp_path)
        for words in (("run", study, "--out", "out"), ("demo", "--out", "out", "--record-again")):
            code, _, err = run(*words)
            print(err)
            assert code == 2
            assert "another run is at work in 'out'" in err
        assert names(tmp_path) == before


def test_a_file_system_without_locks_is_told_and_used(tmp_path, monkeypatch):
    def unknown(*_):
        raise OSError(95, "Operation not supported")

    said = []
    monkeypatch.setattr(fcntl, "flock", unknown)
    with locked(tmp_path, said.append) as handle:
        assert handle is None
    assert "without locks (operation not supported)" in said[0]
    assert not names(tmp_path)


def test_one_run_at_a_time(tmp_path):
    said = []
    with locked(tmp_path, said.append):
        before = (tmp_path / FILE).read_bytes()
        with pytest.raises(uq.errors.StorageError, match=rf"process {os.getpid()} on .*, since 20.*another --out"):
            locked(tmp_path, said.append).__enter__()
        assert names(tmp_path) == [FILE]
        assert (tmp_path / FILE).read_bytes() == before
    assert not names(tmp_path)
    # What a killed process leaves of its lock blocks nobody.
    (tmp_path / FILE).write_bytes(before)
    with locked(tmp_path, said.append):
        assert (tmp_path / FILE).read_bytes() != b""
    assert not names(tmp_path)
    assert not said
