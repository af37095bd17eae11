"""The gallery: each function draws one picture, and its source stands beside the picture on the page.

Fixed seeds, small problems: the same pictures at every build.
"""

import hashlib
import inspect
import textwrap
from pathlib import Path

import ultraquiet as uq
from ultraquiet.testing import problems


def what_a_record_holds():
    """A record: what was sent, what was read"""
    record, _ = problems.two_modes(seed=1)
    return record


def a_test_signal():
    """A chirp in time, and where its power goes"""
    return uq.signals.Chirp(start_hz=5, stop_hz=100, start_level=25, stop_level=5)


def a_spectrum_with_its_confidence():
    """Amplitude spectral densities with their confidence, and the rms that adds up"""
    record, _ = problems.two_modes(seed=1)
    return uq.spectra.psd(record, segment_samples=512)


def a_measured_response():
    """A measured response with its standard error and coherence"""
    record, _ = problems.two_modes(seed=1)
    return uq.spectra.frf(record, segment_samples=512)


def an_identified_model():
    """An identified model with what chance leaves open"""
    record, _ = problems.two_modes(seed=1)
    return uq.identify.BoxJenkins(order=4).identify(record)


def what_the_residual_says():
    """Is anything left in the residual?"""
    record, _ = problems.two_modes(seed=1)
    found = uq.identify.BoxJenkins(order=4).identify(record)
    return uq.validate.residual_test(found.model, record)


def a_law():
    """A law for two channels: gain and phase from every sensor to every actuator"""
    plant = problems.damped_plant(seed=1)
    return uq.design.Lqg().design(plant)


def the_loop():
    """What the loop does with the law: the largest singular values"""
    plant = problems.damped_plant(seed=1)
    law = uq.design.Lqg().design(plant).controller
    return uq.analyse.gang_of_six(plant, law)


def what_no_law_can_beat():
    """The best that any linear controller could do in a band"""
    plant = problems.damped_plant(seed=1, channels=1)
    return uq.limits.best_flat_attenuation(plant, band_hz=(10.0, 60.0), peak_db=6.0, basis=40)


def the_hexapod():
    """The linear truth of the packaged hexapod, from one strut's command to all readings"""
    plant = uq.bench.Hexapod(unit="ground").linear_model()
    return plant.pick(inputs=[0])


PICTURES = (
    what_a_record_holds,
    a_test_signal,
    a_spectrum_with_its_confidence,
    a_measured_response,
    an_identified_model,
    what_the_residual_says,
    a_law,
    the_loop,
    what_no_law_can_beat,
    the_hexapod,
)
HEAD = """# Gallery

Every picture is what `.plot()` draws of one object; `uq.plot.draw_svg(uq.plot.figure(thing))` makes the file. The code
that stands below a picture made it when these pages were built.
"""


def write(folder: Path, page: Path) -> None:
    """Draw the pictures, unless code and package are those that drew them, and write the page."""
    folder.mkdir(parents=True, exist_ok=True)
    parts = [HEAD]
    for make in PICTURES:
        source = inspect.getsource(make)
        stamp = hashlib.sha256(f"{source}{_version()}".encode()).hexdigest()[:12]
        path, kept = folder / f"{make.__name__}.svg", folder / f"{make.__name__}.stamp"
        if not path.exists() or not kept.exists() or kept.read_text() != stamp:
            path.write_text(uq.plot.draw_svg(uq.plot.figure(make())))
            kept.write_text(stamp)
        body = textwrap.dedent(source.split('"""', 2)[2]).strip().replace("return ", "", 1)
        code = f"import ultraquiet as uq\nfrom ultraquiet.testing import problems\n\n{_last_plotted(body)}"
        title = make.__doc__
        parts.append(f"## {title}\n\n![{title}](pictures/{path.name})\n\n```python\n{code}\n```\n")
    text = "\n".join(parts)
    if not page.exists() or page.read_text() != text:
        page.write_text(text)


def _last_plotted(body: str) -> str:
    """The code as one would type it: the object is plotted in place of being returned."""
    *before, last = body.splitlines()
    if last.startswith("uq.plot.figure("):
        last = last.removeprefix("uq.plot.figure(").removesuffix(")")
    return "\n".join([*before, f"shown = {last}", "shown.plot()"])


def _version() -> str:
    """What pictures depend on besides their code: the sources of the package."""
    root = Path(uq.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
