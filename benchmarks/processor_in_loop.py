"""Processor in the loop: the simulated bench closed through the target's own binary, sample by sample.

The law is designed on the ground bench's true linear model; the bench is the nonlinear one with its noise.
"""

import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import ultraquiet as uq
from ultraquiet.deploy.toolchain.targets import TARGETS, missing_program
from ultraquiet.simulate import attenuation

TONES_HZ = (5.0, 25.0, 100.0)
# Two seconds of bench are 7000 exchanges; at 150 us each they would still pass in half real time.
SECONDS, LIMIT_S = 2.0, 4.0

Row = tuple[str, str, str, bool]


def measure() -> Iterator[Row]:
    absent = missing_program()
    if absent is not None:
        yield "processor in the loop", f"'{absent}' is not installed", "tools", False
        return
    seed = int(np.random.default_rng().integers(2**30))
    bench = uq.bench.Hexapod(unit="ground", seed=seed)
    law = uq.design.MixedSensitivity(band_hz=(9.0, 108.0), height=12.0).design(bench.linear_model()).controller
    assert law is not None
    with tempfile.TemporaryDirectory() as work:
        made = uq.deploy.generate(law, Path(work) / "code")
        host = attenuation(replace(bench), made.instance(), TONES_HZ, duration_s=SECONDS)
        for name in TARGETS:
            with uq.deploy.Processor(made, target=name) as processor:
                began = time.perf_counter()
                d = np.zeros((6, round(SECONDS * bench.rate_hz)))
                replace(bench).run(d, controller=processor)
                took = time.perf_counter() - began
                yield (
                    f"{name}: {SECONDS:g} s of bench, {law.states} states",
                    f"{took:.2f} s",
                    f"{LIMIT_S:g} s",
                    took < LIMIT_S,
                )
                emulated = attenuation(replace(bench), processor, TONES_HZ, duration_s=SECONDS)
                output, update = processor.instructions
            figure = "/".join(f"{db:.2f}" for db in emulated.worst_reduction_db) + " dB"
            same = all(
                np.array_equal(a.outputs, b.outputs) and np.array_equal(a.inputs, b.inputs)
                for a, b in zip(emulated.closed, host.closed, strict=True)
            )
            yield f"{name}: reduction at 5/25/100 Hz through the binary", figure, "every bit that of the host", same
            counts = np.unique(output + update)
            yield f"{name}: instructions of each step", str(counts), "constant", counts.size == 1
