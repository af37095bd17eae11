"""The list of foreign words catches the packaged study's numbers, and no others that end alike."""

import pytest

from raw_words import raw_words
from report_words import foreign_words, small_openings


@pytest.mark.parametrize(
    "said", ["at 5 Hz", "(25 Hz", "5-100 Hz, 100 Hz", "5.0 Hz", "3500 Hz", "25 V", "a Strut", "eq. (7)", "0.3 V"]
)
def test_what_belongs_to_the_packaged_study_is_found(said):
    assert foreign_words(f"<p>{said}</p>")


@pytest.mark.parametrize("said", ["164.5 Hz", "1.25 Hz", "2100 Hz", "0.100 Hz", "13500 samples", "35001", "5 kHz"])
def test_another_number_that_ends_alike_is_not(said):
    assert not foreign_words(f"<p>{said}</p><style>.x{{width:5 Hz}}</style>")


@pytest.mark.parametrize(
    "said",
    ["it is True", "None", "nan dB", "the field period_samples", "NOT_WHITE", "<StatusWord.OK: 'ok'>", "StatusWord.OK",
     "attenuated by -3.5 dB", "quieter by \u22123 dB", "changed by -0.2 dB"],
)  # fmt: skip
def test_a_word_of_the_program_is_found(said):
    assert raw_words(said)


@pytest.mark.parametrize(
    "said",
    ["none of it", "quieter by 3.5 dB", "at -3 dB", "written to controller_32.c", "records/low_1.h5", "T <= 1", "yes",
     "infinite", "K S", "NaN-free"[4:]],
)  # fmt: skip
def test_a_reader_s_word_is_none(said):
    assert not raw_words(said)


def test_a_verdict_that_begins_a_sentence_is_found_where_it_is_written_small():
    assert small_openings("<p>2 laws stand side by side. ok: The loop is stable, it amplifies by 3 dB.</p>")
    assert small_openings("<p>not robust: The loop is stable, not for every plant.</p>")
    assert not small_openings("<p>2 laws. Ok: The loop is stable at once. quiet: ok: The loop is stable at once.</p>")
