"""Laws side by side: the loops that were measured, S, T and KS on the design model, margins, eigenvalue loci."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.chart import Axis, Chart, ChartPanel, Curve, Mark, Region, decibel_axis, frequency_axis
from ultraquiet.linalg.response import principal_gains
from ultraquiet.plot.loop import tracked

DEEPEST_DB = 100.0  # below the largest of a panel: what is smaller is not drawn
LOW_DB = 60.0  # below 0 dB: what is quieter is not told apart
SEEN_DB = 6.0  # of what is asked for below its end, and above the largest, that is seen
MOST_TOLD = 4  # loops of which a caption tells; of more it tells those of the law that was chosen


@dataclass(frozen=True)
class RequiredOfLoop:
    """What is required of the sensitivity: so much attenuation over the band, at most such a peak anywhere, in dB."""

    band_hz: tuple[float, float]
    attenuation_db: float | None = None
    peak_db: float | None = None

    @property
    def regions(self) -> list[Region]:
        """The band, down to where the curve is to lie."""
        low, high = self.band_hz
        if self.attenuation_db is None:
            return [Region(f"{low:.4g}-{high:.4g} Hz", self.band_hz, colour="muted")]
        name = f"asked: {self.attenuation_db:g} dB quieter, {low:.4g}-{high:.4g} Hz"
        return [Region(name, self.band_hz, (None, -self.attenuation_db))]

    def reached(self, lowest_db: float) -> float:
        """Return how far down an axis must go for the region that is asked for to be seen, dB."""
        return lowest_db if self.attenuation_db is None else min(lowest_db, -self.attenuation_db - SEEN_DB)

    @property
    def marks(self) -> list[Mark]:
        """The largest amplification that is allowed."""
        if self.peak_db is None:
            return []
        return [Mark(f"asked: at most {self.peak_db:g} dB", y=self.peak_db, colour="muted")]


@dataclass(frozen=True, eq=False)
class LoopCurve:
    """Amplification in dB of a loop's worst direction, `(nf,)`, and how it is drawn."""

    name: str
    f_hz: FloatArray
    amplification_db: FloatArray
    colour: str
    dash: Literal["-", "--", ":", "-."] = "-"


def worst_direction_db(values: ComplexArray) -> FloatArray:
    """Return the largest singular value `(nf,)` of a response `(outputs, inputs, nf)` in decibels."""
    return 20 * np.log10(np.maximum(principal_gains(values)[0], 1e-6))


def measured_loops(stem: str, curves: Sequence[LoopCurve], asked: RequiredOfLoop) -> Chart:
    """The worst direction of every loop as measured on the bench, over what is asked of it."""
    lines = [Curve(c.name, c.f_hz, np.maximum(c.amplification_db, -LOW_DB), c.colour, c.dash) for c in curves]
    lowest = min((float(np.nanmin(line.y)) for line in lines), default=0.0)
    down = asked.reached(lowest)
    tops = [*(float(np.nanmax(line.y)) for line in lines), *(m.y for m in asked.marks if m.y is not None)]
    limits = None if down == lowest else (down, max(tops) + SEEN_DB)
    axis = decibel_axis("amplification", "", limits)
    panel = ChartPanel(frequency_axis(), axis, lines, regions=asked.regions, marks=asked.marks, height=340)
    chief = [c for c in curves if c.colour == "chosen"] if len(curves) > MOST_TOLD else []
    told = [sentence for c in chief or curves if (sentence := _of_loop(c, asked.band_hz))]
    ends = [end for c in curves if c.f_hz.size for end in (float(c.f_hz[0]), float(c.f_hz[-1]))]
    where = f" from {min(ends):.3g} to {max(ends):.4g} Hz, where it was heard" if ends else ""
    caption = (
        f"Largest singular value of the sensitivity, measured on the bench{where}; below zero every direction is "
        "quieter. "
        f"{'; '.join(told)}."
    )
    return Chart(stem, "Worst direction, measured on the bench", caption, [panel])


def _of_loop(curve: LoopCurve, band_hz: tuple[float, float]) -> str:
    """Say what a curve shows: how quiet its worst line in the band is, and where it is loudest."""
    inside = (curve.f_hz >= band_hz[0]) & (curve.f_hz <= band_hz[1])
    if not inside.any():
        return ""
    worst, top = float(curve.amplification_db[inside].max()), int(np.argmax(curve.amplification_db))
    word = "quieter" if worst < 0 else "louder"
    return (
        f"{curve.name}: {abs(worst):.1f} dB {word} at the worst line from {band_hz[0]:.4g} to {band_hz[1]:.4g} Hz, "
        f"peak {curve.amplification_db[top]:.1f} dB at {curve.f_hz[top]:.4g} Hz"
    )


def shaped_loops(
    stem: str,
    f_hz: FloatArray,
    members: Mapping[str, Mapping[str, FloatArray]],
    colours: Mapping[str, str],
    units: Mapping[str, str],
    asked: RequiredOfLoop,
) -> Chart:
    """Largest singular values `(nf,)` of S, T and KS of each law, by member and law; `units` follow "dB re"."""
    panels: list[ChartPanel] = []
    below: dict[str, list[str]] = {}
    for member, laws in members.items():
        lines = [Curve(name, f_hz, _db(values), colours[name]) for name, values in laws.items()]
        top = max(float(_db(values).max()) for values in laws.values())
        floor = top - DEEPEST_DB
        for name in (n for n, values in laws.items() if float(_db(values).max()) < floor):
            below.setdefault(name, []).append(member)
        low = min(float(_db(v).min()) for v in laws.values() if float(_db(v).max()) >= floor)
        limits = (max(low - 3.0, floor), top + 5.0)
        limits = (asked.reached(limits[0]) if member == "S" else limits[0], limits[1])
        band = Region("", asked.band_hz, colour="muted")
        regions, marks = (asked.regions, asked.marks) if member == "S" else ([band], [])
        limits = (limits[0], max(limits[1], *(1.05 * m.y + 1 for m in marks if m.y is not None), limits[1]))
        axis = decibel_axis(f"|{member}|", units.get(member, ""), limits)
        height = 220 if len(members) > 1 else 320
        panels.append(ChartPanel(frequency_axis(), axis, lines, "", regions, marks, height=height))
    peaks = ", ".join(
        f"{name} {float(_db(values).max()):.1f} dB at {f_hz[int(np.argmax(values))]:.4g} Hz"
        for name, values in members.get("S", {}).items()
    )
    unseen = "".join(f" {name} lies below what is drawn of {' and '.join(missing)}." for name, missing in below.items())
    caption = f"Largest singular values on the design model, every law as it runs. Peaks of S: {peaks}.{unseen}"
    words = list(members)
    title = f"{', '.join(words[:-1])} and {words[-1]}" if len(words) > 1 else words[0]
    return Chart(stem, f"{title} on the design model", caption, panels)


def _db(values: FloatArray) -> FloatArray:
    """Return decibels, not further down than 120 dB below the largest."""
    return 20 * np.log10(np.maximum(values, 1e-6 * max(float(values.max(initial=0.0)), 1e-300)))


def margin_bars(
    ends: Mapping[str, Mapping[str, FloatArray]],
    channels: Mapping[str, Sequence[str]],
    colours: Mapping[str, str],
    asked: float | None,
) -> Chart:
    """Disk margins of every loop by itself, by end of the plant and law, `(channels,)`."""
    panels: list[ChartPanel] = []
    least: list[tuple[float, str, str]] = []
    for end, laws in ends.items():
        names, n = channels[end], max(len(laws), 1)
        x = np.arange(len(names), dtype=float)
        bars: list[Curve] = []
        for k, (law, disk) in enumerate(laws.items()):
            offset = 0.8 * ((k + 0.5) / n - 0.5)
            bars.append(Curve(law, x + offset, disk, colours[law], kind="bars", width=0.72 / n))
            worst = int(np.argmin(disk))
            least.append((float(disk[worst]), law, f"{names[worst]}, {end}"))
        marks = [] if asked is None else [Mark(f"asked: {asked:g} (all at once)", y=asked)]
        across = Axis(f"channel at the plant's {end}", range=(-0.5, len(names) - 0.5), names=names)
        panels.append(ChartPanel(across, Axis("disk margin (1)"), bars, "", (), marks, height=220))
    amount, law, where = min(least)
    caption = (
        f"Disk margin of every channel alone, 2 where no simultaneous change of gain and phase of that size upsets the "
        f"loop. The least is {amount:.2g}: {law} at {where}."
    )
    return Chart("margins", "Margins, channel by channel", caption, panels, len(panels))


SPAN = 2.0  # of the plane about the critical point: further out a locus says nothing of stability


def loci(name: str, loop: ComplexArray) -> Chart:
    """Eigenvalue loci of -L, L = G K or K G `(channels, channels, nf)` over rising frequencies, about -1."""
    curves = tracked(-np.linalg.eigvals(np.moveaxis(loop, 2, 0)).astype(np.complex128))
    lines = [
        Curve(f"locus {k + 1}", *_within(locus), colour="chosen" if k == 0 else f"law-{(k - 1) % 8 + 1}", kind="path")
        for k, locus in enumerate(curves)
    ]
    critical = Curve("critical point", [-1.0], [0.0], "measured", kind="points", symbol="+")
    near = min(float(np.abs(locus + 1).min()) for locus in curves)
    panel = ChartPanel(
        Axis("real part (1)", range=(-1.5 * SPAN, SPAN / 2)),
        Axis("imaginary part (1)", range=(-0.75 * SPAN, 0.75 * SPAN)),
        [*lines, critical],
        aspect=4 / 3,
        equal=True,
    )
    caption = (
        f"Eigenvalues of the loop -G K of {name} for rising frequency on the design model; the nearest passes -1 at "
        f"{near:.2f}. "
        "Their encirclements of -1 decide on stability, their distance does not bound the margins of all channels."
    )
    return Chart("nyquist", f"Eigenvalue loci of {name}", caption, [panel])


def _within(locus: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Return both parts, what lies far outside the picture left out."""
    far = np.abs(locus) > 4 * SPAN
    return np.where(far, np.nan, locus.real), np.where(far, np.nan, locus.imag)
