"""A functional mock-up unit, built here from C, is the same bench as the same plant in Python."""

import pickle
import re
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from ultraquiet._base.errors import BenchError, InputError, StorageError
from ultraquiet.bench import Bench, Fmu, Streaming, Wrapped
from ultraquiet.testing import check
from ultraquiet.values import StateSpace

SOURCE = Path(__file__).parent / "fmu_plant.c"
TWO = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="two masses" guid="{two-masses}" numberOfEventIndicators="0">
  <CoSimulation modelIdentifier="plant" canHandleVariableCommunicationStepSize="true"/>
  <UnitDefinitions><Unit name="N"/><Unit name="m/s"/></UnitDefinitions>
  <TypeDefinitions><SimpleType name="Push"><Real unit="N" min="-25" max="25"/></SimpleType></TypeDefinitions>
  <DefaultExperiment startTime="0" STEP/>
  <ModelVariables>
    <ScalarVariable name="push 1" valueReference="0" causality="input"><Real declaredType="Push" start="0"/>
    </ScalarVariable>
    <ScalarVariable name="push 2" valueReference="1" causality="input"><Real declaredType="Push" start="0"/>
    </ScalarVariable>
    <ScalarVariable name="speed 1" valueReference="2" causality="output"><Real unit="m/s"/></ScalarVariable>
    <ScalarVariable name="speed 2" valueReference="3" causality="output"><Real unit="m/s" max="10"/></ScalarVariable>
    <ScalarVariable name="stiffness" valueReference="4" causality="parameter" variability="fixed"><Real start="9e4"/>
    </ScalarVariable>
    <ScalarVariable name="fails at" valueReference="5" causality="parameter" variability="fixed"><Real start="-1"/>
    </ScalarVariable>
  </ModelVariables>
  <ModelStructure><Outputs><Unknown index="3"/><Unknown index="4"/></Outputs></ModelStructure>
</fmiModelDescription>
"""
THREE = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="two masses" instantiationToken="{two-masses}">
  <CoSimulation modelIdentifier="plant" canHandleVariableCommunicationStepSize="true"/>
  <UnitDefinitions><Unit name="N"/><Unit name="m/s"/></UnitDefinitions>
  <TypeDefinitions><Float64Type name="Push" unit="N" min="-25" max="25"/></TypeDefinitions>
  <DefaultExperiment startTime="0" STEP/>
  <ModelVariables>
    <Float64 name="time" valueReference="9" causality="independent" variability="continuous"/>
    <Float64 name="push 1" valueReference="0" causality="input" declaredType="Push" start="0"/>
    <Float64 name="push 2" valueReference="1" causality="input" declaredType="Push" start="0"/>
    <Float64 name="speed 1" valueReference="2" causality="output" unit="m/s"/>
    <Float64 name="speed 2" valueReference="3" causality="output" unit="m/s" max="10"/>
    <Float64 name="stiffness" valueReference="4" causality="parameter" variability="fixed" start="9e4"/>
    <Float64 name="fails at" valueReference="5" causality="parameter" variability="fixed" start="-1"/>
  </ModelVariables>
  <ModelStructure><Output valueReference="2"/><Output valueReference="3"/></ModelStructure>
</fmiModelDescription>
"""
RATE_HZ = 4096.0  # its step is exact in decimal and binary


@pytest.fixture(scope="session")
def library(tmp_path_factory):
    """The shared library; functions that this plant does not need answer 'error'."""
    from fmpy import fmi2, fmi3

    folder, source = tmp_path_factory.mktemp("fmu"), SOURCE.read_text()
    all_of_them = [n for kind in (fmi2.FMU2Slave, fmi3.FMU3Slave) for n in dir(kind) if re.match(r"fmi[23][A-Z]", n)]
    missing = [name for name in all_of_them if f"{name}(" not in source]
    (folder / "rest.c").write_text("".join(f"int {name}(void) {{ return 3; }}\n" for name in missing))
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "-o", str(folder / "plant"), str(SOURCE), str(folder / "rest.c")], check=True)
    return folder / "plant"


@pytest.fixture
def packed(library, tmp_path):
    def pack(version, step=f'stepSize="{1 / RATE_HZ}"'):
        import fmpy

        place = fmpy.platform if version == 2 else fmpy.platform_tuple
        path = tmp_path / f"plant{version}.fmu"
        with zipfile.ZipFile(path, "w") as held:
            held.writestr("modelDescription.xml", {2: TWO, 3: THREE}[version].replace("STEP", step))
            held.write(library, f"binaries/{place}/plant{fmpy.sharedLibraryExtension}")
        return str(path)

    return pack


class Plant:
    """The twin of fmu_plant.c."""

    def __init__(self, stiffness=9.0e4):
        self.stiffness = stiffness

    def reset(self):
        self.position, self.speed = [0.0, 0.0], [0.0, 0.0]

    def step(self, u, d):
        h, y = 1.0 / RATE_HZ, list(self.speed)
        for i in range(2):
            push = float(u[i] + d[i])
            force = push - self.stiffness * self.position[i] - 12.0 * self.speed[i] + 0.125 * y[1 - i]
            self.speed[i] = self.speed[i] + h * force
            self.position[i] = self.position[i] + h * self.speed[i]
        return y


@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_gives_the_record_of_the_wrapped_plant_to_the_bit(version, packed, rng):
    bench = Fmu(packed(version))
    assert isinstance(bench, Bench)
    assert isinstance(bench, Streaming)
    assert bench.rate_hz == RATE_HZ
    assert [(c.name, c.unit, c.low, c.high) for c in bench.actuators] == [
        ("push 1", "N", -25.0, 25.0),
        ("push 2", "N", -25.0, 25.0),
    ]
    assert [(c.name, c.unit, c.low, c.high) for c in bench.sensors] == [
        ("speed 1", "m/s", -np.inf, np.inf),
        ("speed 2", "m/s", -np.inf, 10.0),
    ]
    stiff = Fmu(bench.path, parameters={"stiffness": 2.0e5})
    law = StateSpace([[0.9]], 0.1 * rng.normal(size=(1, 2)), rng.normal(size=(2, 1)), rng.normal(size=(2, 2)), RATE_HZ)
    u, d = 20.0 * rng.normal(size=(2, 2, 800))
    for outside, plant in ((bench, Plant()), (stiff, Plant(2.0e5))):
        inside = Wrapped(plant.step, plant.reset, RATE_HZ, bench.actuators, bench.sensors)
        for controller in (None, law):
            began = time.perf_counter()
            theirs = outside.run(u, d, controller)
            rate = u.shape[1] / (time.perf_counter() - began)
            ours = inside.run(u, d, controller)
            assert np.array_equal(theirs.inputs, ours.inputs)
            assert np.array_equal(theirs.outputs, ours.outputs)
            parts = [b.readings for b in outside.stream(u, d, controller, block_samples=77)]
            assert np.array_equal(np.concatenate(parts, axis=1), ours.outputs)
    assert np.ptp(ours.outputs) > 0
    print(f"FMI {version}.0: equal to the bit, {rate:.0f} samples/s in closed loop")
    assert theirs.provenance.settings["parameters"] == {"stiffness": 2.0e5}


@pytest.mark.parametrize("version", [2, 3])
def test_a_step_that_fails_is_one_sentence_and_keeps_what_was_measured(version, packed, rng):
    at = int(rng.integers(1, 90))
    bench, blocks = Fmu(packed(version), parameters={"fails at": float(at)}), []
    words = "the table is not level" if version == 2 else "failed"
    with pytest.raises(BenchError, match=rf"Fmu: at sample {at} the model failed \(fmi{version}DoStep .*{words}"):
        blocks.extend(bench.stream(np.ones((2, 100)), block_samples=16))
    assert sum(b.readings.shape[1] for b in blocks) == at


def test_outputs_that_are_not_finite_are_refused(packed):
    with pytest.raises(BenchError, match="the outputs must be finite"):
        Fmu(packed(2), parameters={"stiffness": 1e300}).run(np.ones((2, 100)))


def test_channels_can_be_chosen_and_the_rate_given(packed):
    bench = Fmu(packed(2), 1000.0, ("push 2",), ("speed 2", "speed 1"))
    assert [c.name for c in (*bench.actuators, *bench.sensors)] == ["push 2", "speed 2", "speed 1"]
    assert bench.run(np.ones((1, 3))).outputs[:, 2].tolist() == [0.001, 0.0]
    again = pickle.loads(pickle.dumps(bench))
    assert np.array_equal(again.run(np.ones((1, 50))).outputs, bench.run(np.ones((1, 50))).outputs)


def test_it_keeps_the_promises_of_a_bench(packed, seed):
    check("bench", "fmu", seed, path=packed(2))


def test_what_cannot_work_is_refused(packed, tmp_path):
    path = packed(2, step="")
    with pytest.raises(InputError, match="proposes no step, so 'rate_hz' must be given"):
        Fmu(path)
    with pytest.raises(InputError, match="has no real input 'pull'; it has push 1, push 2"):
        Fmu(path, 100.0, ("pull",))
    with pytest.raises(InputError, match="has no real parameter 'mass'; it has stiffness, fails at"):
        Fmu(path, 100.0, parameters={"mass": 1.0})
    with pytest.raises(StorageError, match="there is no file"):
        Fmu(str(tmp_path / "none.fmu"))
    (tmp_path / "text.fmu").write_text("hello")
    with pytest.raises(InputError, match="cannot be read as an FMU"):
        Fmu(str(tmp_path / "text.fmu"))


def test_a_missing_extra_says_how_to_install_it(packed):
    script = (
        "import sys; sys.modules['fmpy'] = None; from ultraquiet.bench import Fmu; "
        f"from ultraquiet._base.errors import ToolError\ntry: Fmu({packed(2)!r})\nexcept ToolError as e: print(e)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert 'pip install "ultraquiet[fmu]"' in done.stdout
    print(done.stdout)
