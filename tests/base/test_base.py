"""The ground: errors, hashes, progress."""

import numpy as np
import pytest

from ultraquiet._base import constraints, progress
from ultraquiet._base.errors import InputError, RateError
from ultraquiet._base.provenance import Provenance, content_hash


def test_rates_are_never_mixed():
    constraints.same_rate("x", "a", None, "b", None)
    constraints.same_rate("x", "a", 3500.0, "b", 3500.0)
    with pytest.raises(RateError, match="in continuous time but b is sampled at 10 Hz"):
        constraints.same_rate("x", "a", None, "b", 10.0)
    with pytest.raises(RateError, match="3500 Hz but b is sampled at 2500 Hz"):
        constraints.same_rate("x", "a", 3500.0, "b", 2500.0)


@pytest.mark.parametrize("value", [True, 2.0, "3", None])
def test_whole_refuses_what_is_not_a_whole_number(value):
    with pytest.raises(InputError, match="whole number"):
        constraints.whole("x", "order", value, 1)


def test_between_names_the_limits():
    with pytest.raises(InputError, match="between 1 and 2 Hz, got 3"):
        constraints.between("x", "f", 3, 1, 2, "Hz")


def test_hash_tells_arrays_apart(rng):
    a = rng.standard_normal((3, 4))
    assert content_hash(a) == content_hash(a.copy())
    assert content_hash(a) != content_hash(a.T)
    assert content_hash(a) != content_hash(a.astype(np.float32))


def test_provenance_survives_json():
    made = Provenance("chirp", {"start_hz": 5.0}, 3, ("abc",), {"numpy": "2"})
    assert Provenance.from_json(made.to_json()) == made


def test_progress_reaches_the_listener():
    heard = []

    class Ear:
        def start(self, title, total):
            heard.append((title, total))
            return 1

        def advance(self, key, steps, note):
            heard.append((steps, note))

        def finish(self, key):
            heard.append("done")

    with progress.listening(Ear()), progress.task("work", 2) as t:
        t.advance(note="first")
    assert heard == [("work", 2), (1, "first"), "done"]
    with progress.task("nobody listens", 1) as t:
        t.advance()


def test_solvers_hold_blas_to_one_thread_and_let_go():
    from threadpoolctl import threadpool_info, threadpool_limits

    from ultraquiet._base.threads import single_threaded

    def threads():
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    with threadpool_limits(limits=2, user_api="blas"):
        before = threads()
        assert set(single_threaded(threads)()) == {1}
        assert threads() == before


def test_blocks_of_one_blas_thread_may_overlap():
    from threadpoolctl import threadpool_info, threadpool_limits

    from ultraquiet._base.threads import one_blas_thread

    def threads():
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    with threadpool_limits(limits=2, user_api="blas"):
        before = threads()
        first, second = one_blas_thread(), one_blas_thread()
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)  # the first to begin ends first, as in threads it may
        assert set(threads()) == {1}
        second.__exit__(None, None, None)
        assert threads() == before
