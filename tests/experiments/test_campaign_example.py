"""The documented example list runs on the simulated bench and leaves what its comments say."""

from pathlib import Path

import numpy as np
import pytest

from ultraquiet import experiments, files
from ultraquiet.values import StateSpace

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "campaign.toml").write_text((DOCS / "examples" / "campaign.toml").read_text())
    # Six readings to six commands: less than the bench has, and too little to move anything far.
    gain = 0.05 * np.eye(6)
    files.save(StateSpace(np.zeros((0, 0)), np.zeros((0, 6)), np.zeros((6, 0)), gain, 3500.0), folder / "law.h5")
    listed = experiments.load(folder / "campaign.toml")
    return listed, experiments.run(listed, folder / "records"), folder


def power_at(record, f_hz):
    """Mean square of a tone of `f_hz` in each reading; the records hold whole periods."""
    phase = np.exp(-2j * np.pi * f_hz * record.time_s)
    return 2 * np.abs(record.outputs @ phase / record.samples) ** 2


def test_it_leaves_what_it_says(campaign):
    _, records, _ = campaign
    assert list(records) == [
        *("quiet", *(f"struts-{k}" for k in range(1, 7))),
        *(f"{name}-r{k}" for k in (1, 2) for name in ("open", "closed", "both")),
        "end",
    ]
    assert all(record.outputs.shape[0] == 12 and record.inputs.shape[0] == 8 for record in records.values())
    assert not any(record.inputs[6:].any() for name, record in records.items() if name.startswith("struts"))
    ratio = power_at(records["open-r1"], 25.0) / power_at(records["quiet"], 25.0)
    print(f"25 Hz of the proof mass in the readings: {10 * np.log10(ratio.min()):.0f} dB over silence at least")
    assert np.median(ratio) > 10
    moved = [np.flatnonzero(records[f"both-r{k}"].inputs[:6].std(axis=1) > 0.5).tolist() for k in (1, 2)]
    assert moved == [[1, 4], [1, 4]]
    assert not np.array_equal(records["both-r1"].inputs, records["both-r2"].inputs)
    assert records["closed-r1"].inputs[:6].any()
    assert not records["open-r1"].inputs.any()


def test_temperatures_and_comments_are_in_the_catalogue(campaign):
    _, records, folder = campaign
    rows = {e.name: e for e in experiments.find(folder)}
    assert set(rows) == set(records)
    warm = {name: row.temperature_c for name, row in rows.items()}
    print({name: round(value, 4) for name, value in warm.items()})
    assert all(value is not None for value in warm.values())
    assert warm["quiet"] == warm["struts-6"]
    assert rows["closed-r2"].comment.startswith("compare")
    assert (rows["closed-r1"].controller, rows["open-r1"].controller) == ("law.h5", "")
    assert rows["open-r1"].disturbance == "tone"
    assert records["end"].provenance.settings["conditions"]["temperatures_c"].keys() == {"start", "bench"}


def test_its_dry_run_says_when_loop_and_disturbance_are_on(campaign):
    listed, _, _ = campaign
    planned = experiments.dry_run(listed)
    steps = {step.name: step for step in planned.steps if step.samples}
    assert (steps["closed-r2"].controller, steps["end"].controller) == ("law.h5", "")
    (shaken,) = steps["open-r1"].disturbance
    assert (shaken.actuator, shaken.peak, round(shaken.rms, 3)) == ("base proof mass", pytest.approx(4.0), 2.828)
    assert shaken.band_hz == pytest.approx((25.0, 25.0))
    assert {sent.actuator for sent in steps["both-r1"].excitation} == {"strut 2", "strut 5"}
    assert planned.duration_s == pytest.approx(13 * 2.0 + 1.0 + 2 * 5.0)
    assert planned.waits_s == 10.0


def test_the_vocabulary_is_documented_and_used():
    text, list_text = (DOCS / "experiments.md").read_text(), (DOCS / "examples" / "campaign.toml").read_text()
    for word, model in experiments.command.VOCABULARY.items():
        assert f"| `{word}` |" in text, word
        assert f'do = "{word}"' in list_text, word
        row = next(line for line in text.splitlines() if line.startswith(f"| `{word}` |"))
        assert all(f"`{key}`" in row for key in model.model_fields if key != "do"), row
