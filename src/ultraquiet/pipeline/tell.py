"""The report of a study: its stages as sections, its facts as sentences, tables and figures."""

from typing import TYPE_CHECKING, Any

import numpy as np

from ultraquiet._base.provenance import versions
from ultraquiet.pipeline.evidence import SHOWN_HZ
from ultraquiet.plot import Figure, paper
from ultraquiet.report import Report, Section, Table
from ultraquiet.spectra import psd

if TYPE_CHECKING:
    from ultraquiet.pipeline.walk import Done

# What the paper prints, beside which the study's own numbers stand; its section and figure numbers.
PAPER_DB = {
    "5": ("33", "section 4.2"),
    "25": ("12 (abstract), 13 (text)", "section 4.2"),
    "100": ("none", "section 4.2"),
}
SHOWN_SIGNALS = ("chirp", "noise", "prbs")
# Strut 2 is the one whose functions the paper prints, eqs. (11) and (12).
PAPER_STRUT = 1


def report(done: "Done", summary: dict[str, Any]) -> Report:
    """Return the report of a finished study."""
    facts = [
        ("bench", ", ".join([done.study.bench.method, *(f"{k} {v}" for k, v in done.study.bench.settings.items())])),
        ("records", f"{len(done.records)}, {sum(r.duration_s for r in done.records.values()):.0f} s"),
        ("versions", ", ".join(f"{k} {v}" for k, v in versions().items())),
        ("seed", str(summary["seed"])),
    ]
    lead = (
        "Every number below was measured in this run. Designs saw records only; closed-loop figures come from the "
        "bench, never from the design model."
    )
    parts = (_excitation, _identification, _validation, _analysis, _design, _closed_loop, _code)
    return Report(done.study.study.title, lead, facts, [part(done) for part in parts])


def _excitation(done: "Done") -> Section:
    shown = {}
    for name in SHOWN_SIGNALS:
        if f"{name}-1" in done.records:
            r = done.records[f"{name}-1"]
            power = psd(r.inputs[0], r.rate_hz)
            shown[name] = (r.time_s, r.inputs[0], power.f_hz, power.values.ravel())
    figures: list[Figure] = [paper.test_signals(shown)] if shown else []
    if "chirp-1" in done.records:
        figures.append(paper.responses_to_one_strut(done.records["chirp-1"], 0))
    clipped = {name: max(r.clipped()) for name, r in done.records.items() if max(r.clipped())}
    words = ", ".join(f"{name} ({count} samples)" for name, count in clipped.items()) or "none"
    return Section("Excitation", [f"Records in which a sensor stood at its limits: {words}."], figures=figures)


def _identification(done: "Done") -> Section:
    facts = done.identified.facts
    best = facts["preferred"]
    rows = [
        (
            *(r["structure"], r["order"], f"{r['median_fit_percent']:.1f}", f"{r['worst_fit_percent']:.1f}"),
            *(f"{r['median_loss']:.3g}", r["ok"], f"{r['seconds']:.1f}"),
        )
        for r in facts["table"]
    ]
    columns = ("structure", "order", "median fit %", "worst fit %", "median loss V²", "ok", "CPU s")
    ranking = Table("All channels, judged on records no model has seen; best first", columns, rows)
    paper_rows = [
        (
            *(name, f"{f['median_fit_percent']:.1f}", f"{f['worst_fit_percent']:.1f}", f["ok"]),
            *(_yes(f["stable"]), _yes(f["invertible"]), f"{f['seconds']:.1f}"),
        )
        for name, f in facts["paper"].items()
    ]
    settings = done.study.identify
    title = f"The paper's structure ({settings.paper_structure}, order {settings.paper_order}) from each test signal"
    heads = ("signal", "median fit %", "worst fit %", "ok", "all stable", "all invertible", "s")
    plant = done.plant.facts
    sentences = [
        f"Held-out records prefer {best['structure']} of order {best['order']}: {best['status']}",
        f"The plant that designs use has {plant['states']} states: {plant['status']}",
    ]
    responses = [(name, SHOWN_HZ, m.frequency_response(SHOWN_HZ)) for name, m in _shown_models(done).items()]
    figures = [paper.bode_grid(responses, (2.0, 500.0))]
    return Section("Identification", sentences, [ranking, Table(title, heads, paper_rows)], figures)


def _shown_models(done: "Done") -> dict[str, Any]:
    first = done.study.identify.paper_records[0]
    return {
        "design plant": done.plant.values["plant"],
        "preferred": done.identified.values["preferred"],
        f"order {done.study.identify.paper_order}, {first}": done.identified.values[f"paper-{first}"],
    }


def _validation(done: "Done") -> Section:
    facts, figures = done.validated.facts, []
    names = done.study.identify.paper_records
    for name, draw in (("step", paper.step_response), ("tone", paper.sine_response)):
        if f"simulated-{name}" in done.validated.values:
            held = done.validated.values[f"simulated-{name}"]
            rows_of = dict(zip((c.name for c in held.sensors), held.outputs, strict=True))
            shown = {key: rows_of[key] for key in (f"paper-{names[0]}", "plant")}
            figures.append(draw(done.records[name], shown, facts["records"][name]["channel"]))
    responses = [(n, SHOWN_HZ, done.identified.values[f"paper-{n}"].frequency_response(SHOWN_HZ)) for n in names]
    figures.append(paper.bode(responses, PAPER_STRUT, PAPER_STRUT, (5.0, 250.0)))
    rows = [
        (name, f"{f['fit_percent']:.1f}", f"{f['clipped_samples']} of {f['samples']}")
        for name, f in facts["records"].items()
    ]
    tables = [Table("Preferred model against records (clipped like the sensors)", ("record", "fit %", "clipped"), rows)]
    against = facts.get("against_bench", {})
    if against:
        rows = [(n, f"{f['diagonal_gain_db']:.2f}", f"{f['diagonal_phase_deg']:.1f}") for n, f in against.items()]
        band = next(iter(against.values()))["band_hz"]
        caption = f"Largest error on the diagonal against the bench's own linear response, {band[0]:g}-{band[1]:g} Hz"
        tables.append(Table(caption, ("model", "gain dB", "phase °"), rows))
    p = facts["residuals"]
    sentence = (
        f"Residuals on held-out records: median p-value {p['whiteness_p_median']:.2g} that they are white, "
        f"{p['correlation_p_median']:.2g} that they are free of the input."
    )
    return Section("Validation", [sentence], tables, figures)


def _analysis(done: "Done") -> Section:
    facts = done.analysed.facts
    f = np.array(facts["f_hz"])
    bands = {name: np.array(values) for name, values in facts["singular_values"].items()}
    bands = {"design plant": bands["plant"], "the paper's structure": bands["paper"]}
    poles = [
        (f"{r['frequency_hz']:.2f}", f"{r['zeta']:.4f}", "unstable" if r["outside"] else "") for r in facts["poles"]
    ]
    low = [
        (
            k + 1,
            ", ".join(f"{r['frequency_hz']:.3g}" for r in rows if r["outside"] and r["frequency_hz"] < 50) or "none",
        )
        for k, rows in enumerate(facts["paper_zeros"])
    ]
    outside = [r for r in facts["transmission_zeros"] if r["outside"]]
    sentences = [
        f"Of {len(facts['transmission_zeros'])} transmission zeros of the design plant {len(outside)} lie outside the "
        f"unit circle, at {', '.join(format(r['frequency_hz'], '.3g') for r in outside[:12]) or 'none'} Hz.",
        "Non-minimum-phase zeros below 50 Hz in the paper's fifth-order structure are an artefact of its order: the "
        "physics, eq. (10), has its zeros at 0 Hz.",
        f"G differs from its transpose by {np.median(facts['reciprocity_error']):.1%} in the median"
        + (
            ""
            if facts["threefold_error"] is None
            else f", from threefold symmetry by {np.median(facts['threefold_error']):.1%}"
        )
        + f"; the weakest diagonal gain stands {np.median(facts['dominance_db']):.0f} dB above its column.",
    ]
    tables = [
        Table("Zeros outside the unit circle below 50 Hz, paper's structure", ("strut", "Hz"), low),
        Table("Poles of the design plant", ("Hz", "damping", ""), _merged(poles)),
    ]
    return Section("Analysis", sentences, tables, [paper.singular_values(f, bands)])


def _merged(rows: list[tuple[str, str, str]]) -> list[tuple[str, str, str]]:
    """Return rows with how often each stands, in place of repetitions."""
    counts = {row: rows.count(row) for row in dict.fromkeys(rows)}
    return [(f, z, " ".join(filter(None, (f"x {n}" if n > 1 else "", word)))) for (f, z, word), n in counts.items()]


def _design(done: "Done") -> Section:
    rows, words = [], []
    for name, outcome in done.designs.items():
        f = outcome.facts
        numbers = [f.get(k) for k in ("gamma", "achieved", "peak_sensitivity_db")]
        rows.append((name, f["method"], f["states"], *(_number(v) for v in numbers)))
        words.append(f"{name}: {f['status']}")
        details = f.get("details", {})
        if "norm_without_control" in details:
            words.append(
                f"{name}: the same cost without any control is {details['norm_without_control']:.4g}"
                + (", so the weights as printed ask for nothing." if f["achieved"] < 1e-3 else ".")
            )
        if "reduction" in f:
            r = f["reduction"]
            words.append(
                f"{name}: reduced from {r['from_states']} states, cost {r['cost_before']:.4g} to {r['cost_after']:.4g}."
            )
    columns = ("controller", "method", "states", "gamma", "achieved", "peak of S, dB")
    return Section("Design", words, [Table("Controllers, on the design model", columns, rows)])


def _closed_loop(done: "Done") -> Section:
    rows, curves, figures = [], {}, []
    for name, outcome in done.loops.items():
        for unit, f in outcome.facts.items():
            if not f["stable"]:
                rows.append((name, unit, f["status"], *[""] * (3 + 2 * len(done.study.closed_loop.tones_hz))))
                continue
            tones = [_number(t[k], 1) for t in f["tones"].values() for k in ("reduction_db", "paper_db")]
            rest = (f["broadband_5_100_db"], f["worst_direction_band_db"], f["peak_amplification_db"])
            rows.append((name, unit, *tones, *(_number(v, 1) for v in rest)))
            if f"{name}-{unit}-sensitivity" in outcome.values and unit == done.study.closed_loop.units[0]:
                S = outcome.values[f"{name}-{unit}-sensitivity"]
                size = np.linalg.svd(np.moveaxis(S.values, 2, 0), compute_uv=False)[:, 0]
                curves[name] = (S.f_hz, -20 * np.log10(size))
    figures += [paper.sensitivity(curves, done.study.closed_loop.band_hz)] if curves else []
    figures += _time_responses(done)
    band = done.study.closed_loop.band_hz
    heads = [h for t in done.study.closed_loop.tones_hz for h in (f"{t:g} Hz reduction", f"{t:g} Hz paper_db")]
    columns = ("controller", "unit", *heads, "5-100 Hz rms", f"worst direction {band[0]:g}-{band[1]:g} Hz", "peak")
    text = [
        "reduction_db = -20 log10(|y closed| / |y open|) of the worst channel; paper_db = -20 log10(|y closed| / |d|), "
        "which counts the plant's own gain: |f22| is -13.3 dB at 25 Hz by itself.",
        "The paper's simulations: " + "; ".join(f"{v[0]} dB at {k} Hz ({v[1]})" for k, v in PAPER_DB.items()) + ".",
        "The worst direction is the largest singular value of the sensitivity matrix measured on the bench.",
    ]
    return Section("Closed loop", text, [Table("On the bench, dB", columns, rows)], figures)


def _time_responses(done: "Done") -> list[Figure]:
    figures = []
    for name, outcome in done.loops.items():
        for tone in done.study.closed_loop.tones_hz:
            runs = [outcome.values.get(f"{kind}-{tone:g}hz") for kind in (name, "open")]
            if runs[0] is not None and runs[1] is not None:
                figures.append(paper.closed_loop(name, tone, runs[0], runs[1]))
    return figures


def _code(done: "Done") -> Section:
    keys = ("states", "form", "c31_cycles", "c31_budget", "flash_bytes", "ram_bytes", "bit_exact")
    rows = [(name, *(str(t.get(k, "-")) for k in keys)) for name, t in done.deployment.items()]
    words = [f"{name}: {t.get('verification', t['status'])}" for name, t in done.deployment.items()]
    note = (
        "C31 cycles come from a published model of the processor: "
        "a law fits the model, it has not run on the processor."
    )
    return Section("Code", [*words, note], [Table("Generated C99", ("controller", *keys), rows)])


def _number(value: Any, digits: int = 4) -> str:
    if value is None or not np.isfinite(value):
        return "-"
    return f"{value:.{digits}f}" if digits == 1 else f"{value:.{digits}g}"


def _yes(value: bool) -> str:
    return "yes" if value else "no"
