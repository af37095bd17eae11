"""Commands that close a loop say what it stands at both ends of the plant."""

from ultraquiet import design, files
from ultraquiet.values import StateSpace

RATE = 2000.0
PLANT = StateSpace(
    [[0.98, 0.19], [-0.19, 0.98]], [[0.1], [0.0]], [[1.0, 0.3]], [[0.0]], RATE, actuators=["coil"], sensors=["geophone"]
)


def test_design_and_deploy_print_the_margins_of_both_ends_with_the_channels_named(run, tmp_path):
    plant, law = tmp_path / "plant.h5", tmp_path / "law.h5"
    files.save(PLANT, plant)
    said = " ".join(run("design", plant, "--method", "lqg", "--out", law)[1].split())
    result = design.Lqg().design(PLANT)
    for side, channel in (("input", "actuator 'coil'"), ("output", "sensor 'geophone'")):
        assert f"margin at the plant's {side}: disk {result.margins[side].disk_all:.3g}" in said
        assert channel in said
    printed = run("deploy", law, "--plant", plant, "--out", tmp_path / "code", "--target", "none", "--steps", "100")[1]
    said = " ".join(printed.split())
    for side in ("input", "output"):
        assert f"rounded law, margin at the plant's {side}: disk " in said


def test_of_an_unstable_loop_no_margin_is_told_and_no_law_is_left(run, tmp_path):
    """A lag that damps modes cannot hold a free body."""
    plant, law, wild = tmp_path / "plant.h5", tmp_path / "law.h5", tmp_path / "wild.h5"
    body = StateSpace([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]], [[1.0, 0.0]], [[0.0]], RATE)
    assert design.LeadLag().design(body).status.word == "unstable"
    files.save(body, plant)
    code, said, why = run("design", plant, "--method", "lead-lag", "--out", law)
    assert (code, said, law.exists()) == (1, "", False)
    assert "unstable" in why
    assert "Nothing was written" in why
    files.save(StateSpace([[0.5]], [[0.0]], [[0.0]], [[2.0]], RATE), wild)
    code, said, _ = run("analyse", plant, wild)
    assert code == 1
    for side in ("input", "output"):
        assert f"margin at the plant's {side}: none, the loop is unstable" in " ".join(said.split())
    assert "no change of one channel" not in said
