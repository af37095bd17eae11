"""The controller as a functional mock-up unit: the same bits as the compiled code, in every tool that speaks FMI."""

import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from deploy_laws import RATE_HZ
from fmpy import fmi2, fmi3
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

from ultraquiet._base.errors import InputError, StorageError, ToolError
from ultraquiet.bench import Fmu, Wrapped
from ultraquiet.deploy import generate
from ultraquiet.deploy.exchange.fmu import binary_folder, write_fmu
from ultraquiet.deploy.exchange.fmu_controller import FmuController
from ultraquiet.deploy.law.twin import Twin
from ultraquiet.values import Channel, Controller

VERSIONS = ["2.0", "3.0"]
PERIOD = 1.0 / RATE_HZ


@pytest.fixture
def unit(law_of, tmp_path):
    """Return a maker of (deployment, path of its unit)."""

    def make(version, states=12, **settings):
        made = generate(law_of(states), tmp_path / "code", **settings)
        return made, write_fmu(made, tmp_path / f"law{version[0]}.fmu", version).path

    return make


class Unit:
    """One instance, driven by hand through FMPy; `said` holds what it logged."""

    def __init__(self, path, start_s=0.0, ramp=False):
        self.said, self.model = [], fmpy.read_model_description(str(path))
        folder, old = fmpy.extract(str(path)), self.model.fmiVersion == "2.0"
        token = self.model.guid if old else self.model.instantiationToken
        slave = (fmi2.FMU2Slave if old else fmi3.FMU3Slave)(
            guid=token, unzipDirectory=folder, modelIdentifier="controller", instanceName="x"
        )
        self.slave, self.folder = slave, folder
        if old:
            words = fmi2.fmi2CallbackFunctions()
            words.logger = fmi2.fmi2CallbackLoggerTYPE(lambda _c, _n, _s, _k, text: self.said.append(text.decode()))
            slave.instantiate(callbacks=words)
            slave.setupExperiment(startTime=start_s)
        else:
            slave.instantiate(logMessage=lambda _e, _s, _k, text: self.said.append(text.decode()))
        references = {v.name: v.valueReference for v in self.model.modelVariables}
        slave.setBoolean([references["ramp"]], [ramp])
        slave.enterInitializationMode() if old else slave.enterInitializationMode(startTime=start_s)
        slave.exitInitializationMode()
        self.get, self.set = (slave.getReal, slave.setReal) if old else (slave.getFloat64, slave.setFloat64)
        self.y = [r for name, r in references.items() if name.startswith("y")]
        self.u = [r for name, r in references.items() if name.startswith("u")]
        self.references, self.start_s, self.k = references, start_s, 0

    def step(self, y, periods=1):
        self.set(self.y, list(y))
        self.slave.doStep(self.start_s + self.k * PERIOD, periods * PERIOD)
        self.k += periods
        return self.get(self.u)

    def close(self):
        self.slave.freeInstance()
        shutil.rmtree(self.folder, ignore_errors=True)


@pytest.mark.slow
@pytest.mark.usefixtures("cc")
@pytest.mark.parametrize("version", VERSIONS)
def test_ten_thousand_samples_in_fmpy_are_the_compiled_code_s_and_the_twin_s_to_the_bit(version, unit, rng):
    made, path = unit(version, 60)
    findings = validate_fmu(str(path))
    assert findings == []
    steps, count = 10_000, 6
    y = rng.standard_normal((count, steps)) * 10.0 ** rng.uniform(-3, 1)
    signals = np.zeros(steps, [("time", float)] + [(f"y{j + 1}", float) for j in range(count)])
    signals["time"] = np.arange(steps) / RATE_HZ
    for j in range(count):
        signals[f"y{j + 1}"] = y[j]
    told = fmpy.simulate_fmu(str(path), output_interval=PERIOD, stop_time=steps / RATE_HZ, input=signals)
    theirs = np.array([told[f"u{i + 1}"][1:] for i in range(count)])
    code = made.instance().run(y)
    twin = Twin(made.law)
    twin.reset()
    different = int(np.count_nonzero(theirs != code))
    print(f"FMI {version}: no finding, {theirs.shape[1]} samples in FMPy, {different} commands differ from the code")
    assert theirs.shape == (count, steps)
    assert different == 0
    assert np.array_equal(code, twin.run(y))
    assert np.ptp(theirs) > 0


@pytest.mark.slow
@pytest.mark.usefixtures("cc")
@pytest.mark.parametrize(("version", "precision"), [("2.0", "float32"), ("3.0", "float64")])
def test_instances_live_side_by_side_and_beside_another_law(version, precision, unit, law_of, rng, tmp_path):
    made, path = unit(version, precision=precision, anti_windup=True)
    other = generate(law_of(7), tmp_path / "other", precision=precision)
    strange = write_fmu(other, tmp_path / "other.fmu", version).path
    loops = [FmuController(path), FmuController(path), FmuController(strange)]
    codes = [made.instance(), made.instance(), other.instance()]
    assert all(isinstance(c, Controller) and c.rate_hz == pytest.approx(RATE_HZ, rel=1e-15) for c in loops)
    for y in 40.0 * rng.standard_normal((300, 3, 6)):
        for loop, code, sample in zip(loops, codes, y, strict=True):
            assert np.array_equal(loop.step(sample), code.step(sample))
    loops[0].reset()
    codes[0].reset()
    for y in rng.standard_normal((50, 6)):
        assert np.array_equal(loops[0].step(y), codes[0].step(y))
        assert np.array_equal(loops[1].step(-y), codes[1].step(-y))


@pytest.mark.gate("3.0")
@pytest.mark.usefixtures("cc")
@pytest.mark.parametrize("version", VERSIONS)
def test_a_state_can_be_kept_and_given_back(version, unit, rng):
    one = Unit(unit(version)[1])
    y = rng.standard_normal((90, 6))
    for sample in y[:30]:
        one.step(sample)
    kept, at = one.slave.getFMUState(), one.k
    first = [one.step(sample) for sample in y[30:]]
    one.slave.setFMUState(kept)
    one.k = at
    assert [one.step(sample) for sample in y[30:]] == first
    one.slave.freeFMUState(kept)
    one.close()


@pytest.mark.gate("3.0")
@pytest.mark.usefixtures("cc")
@pytest.mark.parametrize("version", VERSIONS)
def test_start_values_ramp_counters_and_held_measurements(version, unit, rng):
    made, path = unit(version, ramp_s=0.01)
    start_s = float(rng.uniform(-5, 5))
    plain, ramped, late = Unit(path), Unit(path, ramp=True), Unit(path, start_s)
    assert plain.get(plain.u) == [0.0] * 6
    assert plain.get(plain.y) == [0.0] * 6
    codes = [made.instance(), made.instance(ramp=True), made.instance()]
    for y in rng.standard_normal((60, 6)):
        for loop, code in zip((plain, ramped, late), codes, strict=True):
            assert loop.step(y) == code.step(y).tolist()
    y = rng.standard_normal(6)
    held = [codes[0].step(y) for _ in range(7)][-1]
    assert plain.step(y, periods=7) == held.tolist()
    names = ["mode", "faults", "clipped"]
    read = plain.slave.getInteger if version == "2.0" else plain.slave.getUInt32
    assert read([plain.references[n] for n in names])[:2] == [1, 0]
    assert plain.step([np.nan] * 6) is not None
    assert read([plain.references[n] for n in names])[:2] == [3, 1]
    for loop in (plain, ramped, late):
        assert loop.said == []
        loop.close()


@pytest.mark.gate("3.0")
@pytest.mark.usefixtures("cc")
@pytest.mark.parametrize("version", VERSIONS)
def test_a_step_that_does_not_fit_is_a_sentence_in_the_importer_s_log(version, unit, rng):
    one = Unit(unit(version)[1])
    one.step(np.zeros(6))
    before = one.get(one.u)
    for step_s in (PERIOD * float(rng.uniform(1.01, 1.9)), PERIOD * float(rng.uniform(0.0, 0.9)), 0.0, -PERIOD, np.nan):
        with pytest.raises(FMICallException, match="DoStep"):
            one.slave.doStep(PERIOD, step_s)
        assert re.search(r"must be a whole number of sample periods of 0.000285714286 s, got", one.said[-1])
    with pytest.raises(FMICallException, match="DoStep"):
        one.slave.doStep(3.2 * PERIOD, PERIOD)
    assert "must begin where the last one ended" in one.said[-1]
    print(one.said[0], one.said[-1], sep="\n")
    assert one.get(one.u) == before
    with pytest.raises(FMICallException):
        one.slave.setBoolean([one.references["ramp"]], [True])
    with pytest.raises(FMICallException):
        one.set(one.u, [1.0] * 6)
    with pytest.raises(FMICallException):
        one.slave.getString([1])
    assert "'ramp' is fixed" in one.said[-3]
    assert "is not offered by this unit" in one.said[-1]
    one.step(np.zeros(6))  # and it runs on
    one.close()


@pytest.mark.gate("2.0")
@pytest.mark.usefixtures("cc")
@pytest.mark.parametrize("version", VERSIONS)
def test_every_function_of_the_standard_is_exported(version, unit):
    kind = fmi2.FMU2Slave if version == "2.0" else fmi3.FMU3Slave
    wanted = [n for n in dir(kind) if re.match(r"fmi[23][A-Z]", n)]
    model_exchange = {
        *("fmi2EnterEventMode", "fmi2NewDiscreteStates", "fmi2EnterContinuousTimeMode", "fmi2SetTime"),
        *("fmi2CompletedIntegratorStep", "fmi2SetContinuousStates", "fmi2GetDerivatives", "fmi2GetEventIndicators"),
        *("fmi2GetContinuousStates", "fmi2GetNominalsOfContinuousStates"),
    }
    one = Unit(unit(version)[1])
    missing = [n for n in wanted if n not in model_exchange and not hasattr(one.slave.dll, n)]
    print(f"FMI {version}: {len(wanted)} functions in FMPy, missing: {missing}")
    assert missing == []
    one.close()


@pytest.mark.gate("3.0")
@pytest.mark.usefixtures("cc")
@pytest.mark.parametrize("version", VERSIONS)
def test_it_controls_a_bench_and_is_one(version, law_of, rng, tmp_path):
    made = generate(law_of(8, 2, 3), tmp_path / "code", limits_v=[[-3.0, 4.0], [-2.0, 2.0], [-1.0, 1.0]])
    names = [Channel("north & <south>", "V", -10.0, 10.0), Channel("accel", "m/s2")]
    path = write_fmu(made, tmp_path / "law.fmu", version, inputs=names, outputs=["a", "b", "c"]).path
    assert validate_fmu(str(path)) == []
    gains, state = 0.1 * rng.standard_normal((2, 3)), np.zeros(2)

    def step(u, d):
        y = state.copy()
        state[:] = 0.9 * state + gains @ (u + d)
        return y

    plant = Wrapped(step, lambda: state.fill(0.0), RATE_HZ, [Channel(c) for c in "abc"], [Channel("x"), Channel("y")])
    d = 20.0 * rng.standard_normal((3, 400))
    ours = plant.run(np.zeros_like(d), d, made.instance())
    theirs = plant.run(np.zeros_like(d), d, FmuController(path))
    assert np.array_equal(ours.outputs, theirs.outputs)
    assert np.array_equal(ours.inputs, theirs.inputs)
    bench = Fmu(str(path))
    assert bench.rate_hz == pytest.approx(RATE_HZ, rel=1e-15)
    assert [(c.name, c.unit, c.low, c.high) for c in bench.sensors] == [
        ("a", "", -3.0, 4.0),
        ("b", "", -2.0, 2.0),
        ("c", "", -1.0, 1.0),
    ]
    assert [(c.name, c.unit) for c in bench.actuators] == [("north & <south>", "V"), ("accel", "m/s2")]
    y = np.clip(rng.standard_normal((2, 300)), -10, 10)
    # A bench applies its actuation one sample late and reads its sensors before it moves on: two samples in all.
    assert np.array_equal(bench.run(y).outputs[:, 2:], made.instance().run(y)[:, :-2])


def test_a_unit_s_whole_life_under_sanitizers(cc, unit, tmp_path):
    _, path = unit("2.0", limits_v=25.0)
    fmpy.extract(str(path), str(tmp_path / "unpacked"))
    token, sources = fmpy.read_model_description(str(path)).guid, tmp_path / "unpacked" / "sources"
    names = [sources / f"controller{end}.c" for end in ("", "_host", "_fmi2")]
    flags = ["-std=c99", "-O1", "-g", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wpedantic", "-Werror"]
    checks = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    program = tmp_path / "drive"
    command = [cc, *flags, *checks, f"-I{sources}", *names, Path(__file__).parent / "fmu_drive.c", "-o", program]
    built = subprocess.run([*map(str, command)], capture_output=True, text=True, check=False)
    if "asan" in built.stderr or "sanitize" in built.stderr:
        pytest.skip("this compiler has no sanitizers")
    assert built.returncode == 0, built.stderr
    done = subprocess.run([str(program), token], capture_output=True, text=True, check=False)
    print(done.stdout)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""


@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
def test_the_sources_alone_compile_to_the_same_bits(version, unit, rng, monkeypatch, tmp_path):
    made, path = unit(version)
    with zipfile.ZipFile(path) as held:
        kept = {n for n in held.namelist() if n.startswith("sources/")}
        for name in ("controller.c", "controller.h", "controller_coefficients.h", "controller_host.c"):
            assert held.read(f"sources/{name}") == (made.folder / name).read_bytes()
    again = write_fmu(made, tmp_path / "again.fmu", version)
    assert again.path.read_bytes() == path.read_bytes()
    monkeypatch.setattr("ultraquiet.deploy.toolchain.compiler.compiler", lambda: None)
    bare = write_fmu(made, tmp_path / "bare.fmu", version)
    assert bare.platform is None
    assert "No C compiler was found" in bare.status.sentence
    assert {n for n in zipfile.ZipFile(bare.path).namelist() if n.startswith("sources/")} == kept
    assert validate_fmu(str(bare.path)) == []
    monkeypatch.undo()
    if not (shutil.which("cmake") and shutil.which("c++")):
        pytest.skip("no cmake with C and C++ compilers on this machine to compile an FMU's sources as FMPy does")
    from fmpy.build import build_platform_binary

    folder = fmpy.extract(str(bare.path), str(tmp_path / "unpacked"))
    (tmp_path / "build").mkdir()
    build_platform_binary(folder, tmp_path / "build")
    shutil.make_archive(str(tmp_path / "built"), "zip", folder)
    (tmp_path / "built.zip").rename(tmp_path / "built.fmu")
    loop, code = FmuController(tmp_path / "built.fmu"), made.instance()
    for y in rng.standard_normal((500, 6)):
        assert np.array_equal(loop.step(y), code.step(y))


def test_the_folder_of_binaries_is_the_one_that_importers_look_into():
    assert binary_folder("2.0") == fmpy.platform
    assert binary_folder("3.0") == fmpy.platform_tuple


def test_what_cannot_be_written_is_refused_and_leaves_nothing(law_of, tmp_path):
    made, path = generate(law_of(4), tmp_path / "code"), tmp_path / "law.fmu"
    for settings, words in [
        ({"version": "1.0"}, "'version' must be one of '2.0', '3.0'"),
        ({"inputs": ["a", "b"]}, "2 input names were given for 6 channels"),
        ({"inputs": list("abcdef"), "outputs": list("fghijk")}, "the name 'f' is taken twice"),
        ({"outputs": ["mode", *"bcdef"]}, "the name 'mode' is taken twice"),
        ({"outputs": ["a\nb", *"bcdef"]}, "cannot name a variable"),
    ]:
        with pytest.raises(InputError, match=re.escape(words)):
            write_fmu(made, path, **settings)
    with pytest.raises(InputError, match=r"ends in '.fmu'"):
        write_fmu(made, tmp_path / "law.zip")
    with pytest.raises(StorageError, match="could not be written"):
        write_fmu(made, tmp_path / "none" / "law.fmu")
    (made.folder / "controller.c").write_text("int x = ;\n")
    if shutil.which("cc"):
        with pytest.raises(ToolError, match="refused the generated code"):
            write_fmu(made, path)
    shutil.rmtree(made.folder)
    with pytest.raises(StorageError, match="generate the code again"):
        write_fmu(made, path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("cc")
def test_a_unit_that_cannot_control_says_why(unit, rng, tmp_path):
    with pytest.raises(StorageError, match="there is no file"):
        FmuController(tmp_path / "none.fmu")
    (tmp_path / "text.fmu").write_text("hello")
    with pytest.raises(InputError, match="cannot be read as an FMU"):
        FmuController(tmp_path / "text.fmu")
    path = unit("3.0")[1]
    with pytest.raises(InputError, match=r"measurements must be \(6,\)"):
        FmuController(path).step(np.zeros(5))
    wrong = FmuController(path, rate_hz=RATE_HZ * float(rng.uniform(1.1, 1.8)))
    with pytest.raises(ToolError, match=r"at sample 0 .* whole number of sample periods"):
        wrong.step(np.zeros(6))
    script = (
        "import sys; sys.modules['fmpy'] = None; from ultraquiet.deploy import FmuController as F; "
        f"from ultraquiet._base.errors import ToolError\ntry: F({str(path)!r})\nexcept ToolError as e: print(e)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert 'pip install "ultraquiet[fmu]"' in done.stdout
