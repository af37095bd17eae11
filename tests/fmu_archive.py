"""The tests' own FMU: fmu_plant.c compiled and packed as FMI 2.0 or 3.0."""

import re
import subprocess
import zipfile
from pathlib import Path

SOURCE = Path(__file__).parent / "bench" / "fmu_plant.c"
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


def compiled(folder):
    """Compile the shared library; functions that this plant does not need answer 'error'."""
    from fmpy import fmi2, fmi3

    source = SOURCE.read_text()
    all_of_them = [n for kind in (fmi2.FMU2Slave, fmi3.FMU3Slave) for n in dir(kind) if re.match(r"fmi[23][A-Z]", n)]
    missing = [name for name in all_of_them if f"{name}(" not in source]
    (folder / "rest.c").write_text("".join(f"int {name}(void) {{ return 3; }}\n" for name in missing))
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "-o", str(folder / "plant"), str(SOURCE), str(folder / "rest.c")], check=True)
    return folder / "plant"


def pack(library, path, version, step=f'stepSize="{1 / RATE_HZ}"'):
    """Write the archive of this version."""
    import fmpy

    place = fmpy.platform if version == 2 else fmpy.platform_tuple
    with zipfile.ZipFile(path, "w") as held:
        held.writestr("modelDescription.xml", {2: TWO, 3: THREE}[version].replace("STEP", step))
        held.write(library, f"binaries/{place}/plant{fmpy.sharedLibraryExtension}")
    return str(path)
