"""Word formats: what the code says of its words is how its numbers are kept."""

import numpy as np
import pytest
from deploy_laws import RANGES, law_in_words, random_law

from ultraquiet import deploy
from ultraquiet.deploy.fixed_point.twin import FixedTwin
from ultraquiet.deploy.fixed_point.word_formats import fixed_formats


@pytest.mark.parametrize(("precision", "bits", "significant"), [("float32", 32, 24), ("float64", 64, 53)])
def test_floats_are_of_one_format(tmp_path, rng, precision, bits, significant):
    code = deploy.generate(random_law(rng, 4), tmp_path / "code", precision, limits_v=10.0)
    assert {(each.bits, each.significant, each.fractional) for each in code.word_formats} == {(bits, significant, None)}
    assert code.law.D.dtype.itemsize * 8 == bits
    assert code.law.D.dtype.type(1) + code.law.D.dtype.type(2.0 ** (1 - significant)) > 1
    assert code.law.D.dtype.type(1) + code.law.D.dtype.type(2.0**-significant) == 1


@pytest.mark.parametrize("word", ["q15", "q31"])
@pytest.mark.parametrize("form", ["modal", "delta"])
def test_whole_numbers_have_their_point_where_it_is_said(rng, word, form):
    fixed = deploy.fixed_law(law_in_words(rng, word, 6, form=form), word, form, **RANGES)
    fewest, most = next(each.fractional for each in fixed_formats(fixed) if each.quantity == "coefficients")
    A, B, C, D = fixed.fractions()
    own = (A - np.eye(fixed.states) * fixed.delta).reshape(fixed.states // 2, 2, -1, 2)
    blocks = np.stack([own[k, :, k] for k in range(len(own))])
    integers = np.concatenate([each.ravel() for each in (fixed.A, fixed.B, fixed.C.T, fixed.D)])
    held = np.concatenate([each.ravel() for each in (blocks, B, C, D)])
    points = np.rint(np.log2(integers[integers != 0] / held[integers != 0])).astype(int)
    assert (min(points), max(points)) == (fewest, most)


def test_states_and_commands_are_fractions_of_full_scale(tmp_path, rng):
    """A reading of half its range is the word 2^(fraction - 1), and a command comes back by the same rule."""
    law = random_law(rng, 4, inputs=1, outputs=1)
    code = deploy.generate_fixed(law, tmp_path / "code", "q31", input_v=2.0, output_v=4.0, tolerance=1.0)
    formats = {each.quantity: each for each in code.word_formats}
    assert formats["readings and commands"].fractional == formats["states"].fractional == (31, 31)
    header, source = ((tmp_path / "code" / f"{code.law.name}{end}").read_text() for end in (".h", ".c"))
    assert f"typedef int{formats['sums'].bits}_t wide;" in source
    assert f"int{formats['states'].bits}_t" in header
    word = FixedTwin(code.law)
    word.reset()
    sent = word.output(np.array([2 ** (31 - 5)]))[0] / 2.0**31 * 4.0
    assert sent == pytest.approx(law.D[0, 0] * 2.0 / 2**5, abs=1e-6)
