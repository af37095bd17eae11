"""Compile the kernels before the test workers start: one small call of each family fills numba's cache.

    python tests/compile_kernels.py

Two processes, each with families that share nothing compiled, so that two cores are used once instead of every worker
compiling all of it for itself; and one that collects the tests, which leaves their byte code, ten processor seconds
of it, for all workers. `make` runs this only when a kernel is newer than the last time.
"""

import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

# As in the tests: the processes are all the threads there are.
for _library in ("OPENBLAS", "MKL", "OMP", "NUMBA"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
ROOT = Path(__file__).parents[1]
SAMPLES = 1500


def two_inputs():
    """A record of two inputs and one output that every method can fit."""
    import numpy as np

    import ultraquiet as uq
    from ultraquiet.testing import problems

    first, second = (problems.two_modes(seed, SAMPLES)[0] for seed in (1, 2))
    return uq.Record(np.vstack([first.inputs, second.inputs]), first.outputs + second.outputs, first.rate_hz)


def prediction_error():
    """Polynomial models of records in memory, of several experiments and of records on disk."""
    import ultraquiet as uq
    from ultraquiet.files import LongRecord, LongWriter

    record, method = two_inputs(), uq.identify.BoxJenkins(order=2)
    method.identify(record)
    method.identify([record.part(0, SAMPLES // 2), record.part(SAMPLES // 2)])
    with tempfile.TemporaryDirectory() as folder:
        with LongWriter(Path(folder) / "long.h5", record.rate_hz, record.actuators, record.sensors) as file:
            file.append(record.inputs, record.outputs)
        on_disk = LongRecord(Path(folder) / "long.h5")
        method.identify(on_disk)
        uq.identify.Subspace(order=4).identify(on_disk)


def subspace_and_recursion():
    """State-space models by subspaces, and polynomial models sample by sample."""
    import ultraquiet as uq

    record = two_inputs()
    uq.identify.Subspace(order=4).identify(record)
    uq.identify.PredictorSubspace(order=4).identify(record)
    uq.identify.RecursiveBoxJenkins(order=2).identify(record.pick([0], [0]))
    uq.identify.RecursiveArx(order=2).identify(record.pick([0], [0]))


def benches_and_adaptive_laws():
    """The sampled loop of the bench, and one step of each adaptive law."""
    import numpy as np

    import ultraquiet as uq
    from ultraquiet.design import AdaptiveFeedforward, FilteredXLms, YoulaKucera
    from ultraquiet.testing.problems import damped_plant
    from ultraquiet.values import StateSpace

    bench = uq.bench.Hexapod(unit="ground", seed=1)
    u = np.zeros((6, 50))
    bench.run(u)
    bench.run(u, controller=StateSpace(np.zeros((1, 1)), np.zeros((1, 6)), np.zeros((6, 1)), np.zeros((6, 6)), 3500.0))
    plant = damped_plant(1)
    uq.bench.LinearBench(plant).run(np.zeros((len(plant.B.T), 50)))
    tones = {"tones_hz": (60.0,), "limit": 10.0}
    for method in (AdaptiveFeedforward(**tones), YoulaKucera(**tones), FilteredXLms(taps=20, limit=10.0)):
        law = method.design(plant).law
        for _ in range(50):
            law.step(np.ones(len(plant.C)))


GROUPS = ((prediction_error, subspace_and_recursion), (benches_and_adaptive_laws,))


def compile_group(number):
    """Call the families of one group, one after the other."""
    for family in GROUPS[number]:
        started = time.process_time()
        family()
        print(f"compiled {family.__name__}: {time.process_time() - started:.1f} processor seconds", flush=True)


def collecting():
    """Begin to collect all tests; what is wrong with one is said by the run itself."""
    words = ("-m", "pytest", "--collect-only", "-q", "-p", "no:cacheprovider")
    return subprocess.Popen([sys.executable, *words], cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def main():
    """Run the groups and the collection side by side."""
    started = time.perf_counter()
    collection = collecting()
    context = multiprocessing.get_context("spawn")
    workers = [context.Process(target=compile_group, args=(number,)) for number in range(len(GROUPS))]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    collection.wait()
    print(f"kernels are compiled: {time.perf_counter() - started:.1f} s")
    return max(abs(worker.exitcode) for worker in workers)


if __name__ == "__main__":
    sys.exit(main())
