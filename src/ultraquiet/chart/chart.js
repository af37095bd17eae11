/* The chart component of report and workbench, on uPlot. The specification is documented in ultraquiet/chart/spec.py.

   Uq.data(table)          arrays that several specifications name: {id: base64 of little-endian float32, or an array}
   Uq.chart(element, spec) one panel;   Uq.grid(element, spec) panels in columns
     -> {update(spec), destroy(), reset(), zoom(lo, hi), toggle(name, shown), svg(), png(), csv(), plots}
   Uq.scene(element, spec) shapes in space, moving: {name, title, points, lines: [[a, b], ...], shapes: [{name, re, im}]}
   Uq.theme(word)          "light", "dark" or "auto"
   Events on the element: uq-zoom {lo, hi, along}, uq-click {panel, x, y}, uq-toggle {name, shown}. */
var Uq = (() => {
  "use strict";
  const shared = {}, drawn = new Set();
  const AXIS = 12, SMALL = 11, LINE = 1.5, HOVER = 2.5, UNDER = 3.5, MARGIN = 0.05, TALLEST = 560, PADDED = 18, FINE = 50, NUMBERS = 24, NARROW = 130;
  const STEPS = {
    dB: [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 3, 6, 10, 20, 40, 60, 100, 200, 500, 1000],
    int: [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000],
    deg: [0.1, 0.5, 1, 5, 15, 45, 90, 180, 360, 720, 1440, 3600],
  };
  const DASHES = { "-": [], "--": [6, 4], ":": [2, 3], "-.": [6, 3, 2, 3] };

  // ---- data -------------------------------------------------------------------------------------------------------
  function decoded(text) {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return new Float32Array(bytes.buffer);
  }
  function array(ref, table) {
    if (ref == null || typeof ref !== "string") return ref ?? null;
    const from = table && ref in table ? table : shared;
    if (typeof from[ref] === "string") from[ref] = decoded(from[ref]);
    return from[ref];
  }
  const data = (table) => Object.assign(shared, table);

  /* Curves as the panel draws them: points that a logarithmic axis cannot show become gaps. */
  function curvesOf(panel, table) {
    const xlog = panel.x.scale === "log", ylog = panel.y.scale === "log";
    const fit = (values, log) => {
      if (!values) return null;
      for (let k = 0; k < values.length; k++) {
        if (!Number.isFinite(values[k]) || (log && values[k] <= 0))
          return Array.from(values, (v) => (Number.isFinite(v) && !(log && v <= 0) ? v : null));
      }
      return values;
    };
    return (panel.curves || []).map((c) => {
      const get = (key) => array(c[key], table);
      let [x, y, low, high] = [get("x"), fit(get("y"), ylog), fit(get("low"), ylog), fit(get("high"), ylog)];
      if (xlog && x.length && !(x[0] > 0)) {
        let k = 0;
        while (k < x.length && !(x[k] > 0)) k++;
        [x, y, low, high] = [x, y, low, high].map((v) => v && v.slice(k));
      }
      const kind = c.kind || "line";
      return { ...c, x: aligned({ kind }) ? x : fit(x, xlog), y, low, high, kind };
    }).map((c, k, all) => ({ ...c, line: under(c, all) ? UNDER : LINE }));
  }
  /* What was measured lies as a broader line below what is compared with it, so that it is seen where both are alike. */
  const under = (c, all) => c.colour === "measured" && c.kind === "line" && (c.dash || "-") === "-" && all.some((d) => d.kind === "line" && d.colour !== "measured");
  const aligned = (c) => c.kind === "line" || c.kind === "step";
  /* Curves in the order of their painting: the broad ones first, the chosen ones last, so that none that is like them lies over them. */
  const turn = (c) => (c.line === UNDER ? 0 : c.colour === "chosen" ? 2 : 1);
  const painted = (curves) => [...curves].sort((a, b) => turn(a) - turn(b));

  function table(curves, home) {
    const along = painted(curves).filter(aligned);
    if (!along.length) return [home, home.map(() => null)];
    const columns = (c) => [c.y, ...(c.low ? [c.low, c.high] : [])];
    if (along.every((c) => c.x === along[0].x)) return [along[0].x, ...along.flatMap(columns)];
    const plain = (v) => Array.from(v);
    return uPlot.join(along.map((c) => [plain(c.x), ...columns(c).map(plain)]));
  }

  // ---- values as colours: dark to bright, told apart without colour as well ----------------------------------------
  const RAMP = [[0.0, 68, 1, 84], [0.25, 59, 82, 139], [0.5, 33, 145, 140], [0.75, 94, 201, 98], [1.0, 253, 231, 37]];
  function rampColour(share) {
    const s = Math.max(0, Math.min(1, share)), k = Math.min(RAMP.length - 2, Math.floor(s * (RAMP.length - 1)));
    const [a, b] = [RAMP[k], RAMP[k + 1]], part = (s - a[0]) / (b[0] - a[0]);
    return `rgb(${[1, 2, 3].map((j) => Math.round(a[j] + part * (b[j] - a[j]))).join()})`;
  }
  function mapOf(panel, table) {
    if (!panel.map) return null;
    const [x, y, z] = ["x", "y", "z"].map((key) => array(panel.map[key], table));
    return { ...panel.map, x, y, z };
  }
  /* Edges between the middles of cells, those of a logarithmic axis between their logarithms. */
  function edges(middles, log) {
    const v = log ? Array.from(middles, Math.log) : Array.from(middles), n = v.length, out = [];
    for (let k = 0; k <= n; k++) out.push(n === 1 ? v[0] + k - 0.5 : k === 0 ? v[0] - (v[1] - v[0]) / 2 : k === n ? v[n - 1] + (v[n - 1] - v[n - 2]) / 2 : (v[k - 1] + v[k]) / 2);
    return log ? out.map(Math.exp) : out;
  }
  function paintMap(ctx, m, panel, px, py) {
    const xs = edges(m.x, panel.x.scale === "log").map(px), ys = edges(m.y, panel.y.scale === "log").map(py), n = m.x.length;
    const [lo, hi] = m.range;
    for (let i = 0; i < m.y.length; i++)
      for (let j = 0; j < n; j++) {
        const z = m.z[i * n + j];
        if (!Number.isFinite(z)) continue;
        ctx.fillStyle = rampColour((z - lo) / (hi - lo));
        ctx.fillRect(Math.floor(xs[j]), Math.floor(ys[i + 1]), Math.ceil(xs[j + 1]) - Math.floor(xs[j]), Math.ceil(ys[i]) - Math.floor(ys[i + 1]));
      }
  }
  const mapWords = (m) => `${m.name}, ${written(m.range[0])} to ${written(m.range[1])}`;

  // ---- ranges and ticks -------------------------------------------------------------------------------------------
  function extent(values, lo = Infinity, hi = -Infinity, from = 0, to = values ? values.length : 0) {
    for (let k = from; k < to; k++) {
      const v = values[k];
      if (v == null) continue;
      if (v < lo) lo = v;
      if (v > hi) hi = v;
    }
    return [lo, hi];
  }
  function widened([lo, hi], log, share) {
    if (!(hi >= lo)) return log ? [0.1, 10] : [0, 1];
    if (log) {
      const room = lo === hi ? 2 : Math.pow(hi / lo, share);
      return [lo / room, hi * room];
    }
    const room = lo === hi ? Math.abs(lo) * 0.1 || 1 : (hi - lo) * share;
    return [lo - room, hi + room];
  }
  /* A range that an axis can show: a logarithmic one begins above zero. */
  const SHOWN = 1e-6;
  function shownRange(axis) {
    if (!axis.range) return null;
    const [lo, hi] = axis.range;
    return axis.scale === "log" && !(lo > 0) ? (hi > 0 ? [hi * SHOWN, hi] : null) : axis.range;
  }
  function homeX(panel, curves, map) {
    const asked = shownRange(panel.x);
    if (asked) return asked;
    if (map) { const ends = edges(map.x, panel.x.scale === "log"); return [ends[0], ends[ends.length - 1]]; }
    let [lo, hi] = [Infinity, -Infinity];
    for (const c of curves) {
      [lo, hi] = extent(c.x, lo, hi);
      if (c.kind === "bars") [lo, hi] = [lo - c.width / 2, hi + c.width / 2];
    }
    const free = curves.some((c) => !aligned(c)), log = panel.x.scale === "log";
    return lo === hi || free || log ? widened([lo, hi], log, lo === hi || free ? MARGIN : 0) : rounded(lo, hi);
  }
  /* Ends that all but reach a round number reach it: a record of 30 s ends one sample before. */
  function rounded(lo, hi) {
    const step = Math.pow(10, Math.floor(Math.log10(hi - lo))) / 2;
    const down = Math.round(lo / step) * step, up = Math.round(hi / step) * step, near = (hi - lo) / 200;
    return hi > lo ? [lo - down >= 0 && lo - down < near ? down : lo, up - hi >= 0 && up - hi < near ? up : hi] : widened([lo, hi], false, 0);
  }
  function first(x, value) {
    let [lo, hi] = [0, x.length];
    while (lo < hi) {
      const mid = (lo + hi) >> 1;
      if (x[mid] < value) lo = mid + 1; else hi = mid;
    }
    return lo;
  }
  function fitY(panel, curves, hidden, [xlo, xhi]) {
    let [lo, hi] = [Infinity, -Infinity];
    const log = panel.y.scale === "log";
    for (const c of curves) {
      if (hidden.has(c.name)) continue;
      if (aligned(c)) {
        const [a, b] = [Math.max(first(c.x, xlo) - 1, 0), Math.min(first(c.x, xhi) + 1, c.x.length)];
        for (const v of [c.y, c.low, c.high]) if (v) [lo, hi] = extent(v, lo, hi, a, b);
      } else {
        for (let k = 0; k < c.x.length; k++)
          if (c.x[k] >= xlo && c.x[k] <= xhi) [lo, hi] = extent([c.y[k]], lo, hi);
        if (!log && (c.kind === "bars" || c.kind === "stems")) [lo, hi] = extent([0], lo, hi);
      }
    }
    for (const m of panel.marks || []) if (m.y != null && !(log && m.y <= 0) && !hidden.has(m.name)) [lo, hi] = extent([m.y], lo, hi);
    return widened([lo, hi], log, MARGIN);
  }
  function written(v, step) {
    if (v === 0) return "0";
    const size = Math.abs(v);
    let text;
    if (size >= 1e5 || size < 1e-3) text = v.toExponential(step ? undefined : 3).replace(/\.?0*e\+?/, "e");
    else if (step) text = v.toFixed(Math.max(0, Math.ceil(-Math.log10(step) - 1e-9) + (step < 1 && +(step.toPrecision(1)) !== +(step.toPrecision(2)) ? 1 : 0)));
    else text = String(+v.toPrecision(5));
    return text.replace(/-/g, "\u2212");
  }
  function linearTicks(lo, hi, room, steps) {
    const wanted = (hi - lo) / Math.max(room, 1);
    let step = steps && steps.find((s) => s >= wanted);
    if (!step) {
      const power = Math.pow(10, Math.floor(Math.log10(wanted)));
      step = [1, 2, 5, 10].find((m) => m * power >= wanted * 0.999) * power;
    }
    const at = (each) => {
      const ticks = [];
      for (let k = Math.ceil(lo / each - 1e-6); k * each <= hi + 1e-6 * each; k++) ticks.push(k * each);
      return ticks;
    };
    // one number alone says nothing of the scale; between whole ones there is none
    for (let finer = 0; finer < 3 && !(steps === STEPS.int && step === 1) && at(step).length < 2; finer++) step = steps && steps.indexOf(step) > 0 ? steps[steps.indexOf(step) - 1] : step / 2;
    return [at(step), step];
  }
  /* How names stand side by side, each in `room` pixels: in one line, else folded between words, else upright. */
  const ruler = document.createElement("canvas").getContext("2d");
  const LETTERS = AXIS + "px system-ui, sans-serif", ROW = 16, APART = 8, TALL = 140, MOST_ROWS = 3;
  function long(text) { ruler.font = LETTERS; return ruler.measureText(text).width; }
  function folded(name, room) {
    const lines = [];
    for (const word of String(name).split(" ")) {
      const longer = lines.length ? lines[lines.length - 1] + " " + word : word;
      if (lines.length && long(longer) <= room) lines[lines.length - 1] = longer; else lines.push(word);
    }
    return lines;
  }
  function shortened(name, room) {
    if (long(name) <= room) return name;
    let text = String(name);
    while (text.length > 1 && long(text + "\u2026") > room) text = text.slice(0, -1);
    return text + "\u2026";
  }
  /* A title in rows of a room, about evenly long, for letters of a size: the last ends in dots where there are too many. */
  function inRows(title, room, size) {
    const wide = room * AXIS / size;
    let lines = folded(title, wide);
    if (lines.length > 1 && lines.length <= MOST_ROWS)
      for (let even = wide - 6, rows = lines.length; even > 0 && folded(title, even).length === rows; even -= 6) lines = folded(title, even);
    const kept = lines.slice(0, MOST_ROWS);
    if (lines.length > kept.length) kept[kept.length - 1] += "\u2026";
    return kept.map((line) => shortened(line, wide));
  }
  function standing(names, room) {
    const across = names.map((n) => folded(n, room - APART)), rows = Math.max(1, ...across.map((l) => l.length));
    if (rows <= MOST_ROWS && across.every((lines) => lines.every((l) => long(l) <= room - APART)))
      return { words: across.map((l) => l.join("\n")), turn: 0, size: 8 + ROW * rows };
    return upright(names);
  }
  function upright(names) {
    const words = names.map((n) => shortened(n, TALL));
    return { words, turn: -90, size: Math.ceil(12 + Math.max(0, ...words.map(long))) };
  }
  /* All ticks of an axis and the words at those that have room for one. */
  function ticksOf(axis, lo, hi, length, across) {
    if (axis.names) {
      const at = axis.names.map((_, k) => k).filter((k) => k >= lo && k <= hi);
      return [at, at.map((k) => axis.names[k])];
    }
    if (!Number.isFinite(lo) || !Number.isFinite(hi) || !(hi > lo) || (axis.scale === "log" && !(lo > 0))) return [[], []];
    const room = length / (across ? 64 : 30);
    if (axis.scale !== "log" || hi / lo < 5) {
      const [ticks, step] = linearTicks(lo, hi, room, STEPS[axis.ticks]);
      return [ticks, ticks.map((v) => written(Math.abs(v) < step * 1e-6 ? 0 : v, step))];
    }
    const decades = Math.log10(hi / lo), ticks = [], words = [];
    const [below, above] = [Math.floor(Math.log10(lo)), Math.ceil(Math.log10(hi))];
    const powers = Array.from({ length: above - below + 1 }, (_, k) => +("1e" + (below + k))).filter((v) => v >= lo && v <= hi);
    const longest = across ? Math.max(14, ...powers.map((v) => long(written(v, v)))) + APART : 30;
    const every = Math.max(1, Math.ceil((decades * longest) / length));
    const spoken = length / decades > (across ? 150 : 90) ? [1, 2, 5] : [1];
    for (let e = below; e <= above; e++) {
      for (let m = 1; m < 10; m++) {
        const v = +(m + "e" + e);
        if (v < lo * 0.9999 || v > hi * 1.0001 || (m > 1 && (every > 1 || length / decades < FINE))) continue;
        ticks.push(v);
        words.push(spoken.includes(m) && e % every === 0 ? written(v, v) : "");
      }
    }
    return [ticks, words];
  }

  // ---- looks ------------------------------------------------------------------------------------------------------
  const ROLES = ["measured", "open", "chosen", "ok", "fragile", "bad", "requirement", "grid", "ink", "muted", "paper"];
  function colour(word, root) {
    if (/^(#|rgb)/.test(word)) return word;
    const name = ROLES.includes(word) || /^law-[1-9]$/.test(word) ? word : "measured";
    return getComputedStyle(root || document.documentElement).getPropertyValue("--uq-" + name).trim() || "#888";
  }
  function element(tag, name, parent, text) {
    const made = document.createElement(tag);
    if (name) made.className = name;
    if (text != null) made.textContent = text;
    if (parent) parent.append(made);
    return made;
  }
  const alpha = (ctx, value, work) => { const was = ctx.globalAlpha; ctx.globalAlpha = value; work(); ctx.globalAlpha = was; };

  function symbol(ctx, kind, x, y, r) {
    ctx.beginPath();
    if (kind === "x" || kind === "+") {
      const d = kind === "x" ? r * 0.75 : 0, f = kind === "x" ? r * 0.75 : r;
      if (kind === "x") { ctx.moveTo(x - d, y - d); ctx.lineTo(x + d, y + d); ctx.moveTo(x - d, y + d); ctx.lineTo(x + d, y - d); }
      else { ctx.moveTo(x - f, y); ctx.lineTo(x + f, y); ctx.moveTo(x, y - f); ctx.lineTo(x, y + f); }
      ctx.stroke();
    } else if (kind === "s") { ctx.rect(x - r * 0.8, y - r * 0.8, 1.6 * r, 1.6 * r); ctx.stroke(); }
    else { ctx.arc(x, y, kind === "." ? r * 0.6 : r, 0, 2 * Math.PI); kind === "." ? ctx.fill() : ctx.stroke(); }
  }
  /* Everything that is no function of a sorted x: points, paths, bars and stems. */
  function drawFree(u, one) {
    const { ctx } = u, ratio = devicePixelRatio || 1;
    const px = (v) => u.valToPos(v, "x", true), py = (v) => u.valToPos(v, "y", true);
    ctx.save();
    ctx.beginPath(); ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height); ctx.clip();
    for (const c of painted(one.curves)) {
      if (aligned(c) || one.hidden.has(c.name)) continue;
      const width = (one.hovered === c.name ? HOVER : c.line) * ratio;
      ctx.strokeStyle = ctx.fillStyle = colour(c.colour, one.root);
      ctx.lineWidth = width;
      ctx.setLineDash(DASHES[c.dash || "-"].map((d) => d * ratio));
      if (c.kind === "path") {
        ctx.beginPath();
        let on = false;
        for (let k = 0; k < c.x.length; k++) {
          if (c.y[k] == null || c.x[k] == null) { on = false; continue; }
          on ? ctx.lineTo(px(c.x[k]), py(c.y[k])) : ctx.moveTo(px(c.x[k]), py(c.y[k]));
          on = true;
        }
        ctx.stroke();
        continue;
      }
      for (let k = 0; k < c.x.length; k++) {
        if (c.y[k] == null || c.x[k] == null) continue;
        const [x, y] = [px(c.x[k]), py(c.y[k])];
        if (c.kind === "points") symbol(ctx, c.symbol || ".", x, y, 4 * ratio);
        else {
          const zero = py(Math.max(u.scales.y.min, Math.min(u.scales.y.max, 0)));
          if (c.kind === "bars") {
            const half = Math.abs(px(c.x[k] + c.width / 2) - x) || 1;
            alpha(ctx, 0.8, () => ctx.fillRect(x - half, Math.min(y, zero), 2 * half, Math.abs(y - zero)));
          } else { ctx.beginPath(); ctx.moveTo(x, zero); ctx.lineTo(x, y); ctx.stroke(); symbol(ctx, ".", x, y, 3 * ratio); }
        }
      }
    }
    for (const m of one.panel.marks || []) {
      if (one.hidden.has(m.name)) continue;
      ctx.strokeStyle = colour(m.colour || "muted", one.root);
      ctx.lineWidth = ratio;
      ctx.setLineDash(DASHES[m.dash || "--"].map((d) => d * ratio));
      ctx.beginPath();
      if (m.x != null) { ctx.moveTo(px(m.x), u.bbox.top); ctx.lineTo(px(m.x), u.bbox.top + u.bbox.height); }
      else { ctx.moveTo(u.bbox.left, py(m.y)); ctx.lineTo(u.bbox.left + u.bbox.width, py(m.y)); }
      ctx.stroke();
    }
    ctx.restore();
  }
  function drawRegions(u, one) {
    const { ctx, bbox } = u;
    if (one.map && !one.hidden.has(mapWords(one.map))) {
      ctx.save();
      ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
      paintMap(ctx, one.map, one.panel, (v) => u.valToPos(v, "x", true), (v) => u.valToPos(v, "y", true));
      ctx.restore();
    }
    const clamp = (v, lo, hi) => Math.max(lo, Math.min(hi, v));
    for (const r of one.panel.regions || []) {
      if (one.hidden.has(r.name)) continue;
      const side = (range, scale, lo, hi) => (range ? range.map((v) => (v == null ? null : clamp(u.valToPos(v, scale, true), lo, hi))) : [lo, hi]);
      let [x0, x1] = side(r.x, "x", bbox.left, bbox.left + bbox.width);
      let [y0, y1] = side(r.y, "y", bbox.top, bbox.top + bbox.height);
      x0 ??= bbox.left; x1 ??= bbox.left + bbox.width; y0 ??= bbox.top + bbox.height; y1 ??= bbox.top;
      ctx.fillStyle = colour(r.colour || "requirement", one.root);
      alpha(ctx, (r.colour || "requirement") === "requirement" ? 1 : 0.15, () => ctx.fillRect(Math.min(x0, x1), Math.min(y0, y1), Math.abs(x1 - x0), Math.abs(y1 - y0)));
    }
    if (one.panel.tinted) {
      ctx.fillStyle = colour("chosen", one.root);
      alpha(ctx, 0.06, () => ctx.fillRect(bbox.left, bbox.top, bbox.width, bbox.height));
    }
  }

  // ---- one panel --------------------------------------------------------------------------------------------------
  function axisOf(one, along, side) {
    const axis = one.panel[along], across = along === "x", bare = one.bare[along];
    const found = (u, lo, hi) => ticksOf(axis, lo, hi, (across ? u.bbox.width : u.bbox.height) / (devicePixelRatio || 1), across);
    let words = [];
    return {
      scale: along, side, label: bare ? undefined : (u) => shortLabel(axis.label || "", u.bbox[across ? "width" : "height"] / (devicePixelRatio || 1)), labelSize: 18, labelGap: 2, gap: 4,
      font: AXIS + "px system-ui, sans-serif", labelFont: AXIS + "px system-ui, sans-serif",
      stroke: () => colour("muted", one.root),
      grid: { stroke: () => (one.panel.map ? "rgb(255 255 255 / 14%)" : colour("grid", one.root)), width: 1 },
      ticks: { stroke: () => colour("grid", one.root), width: 1, size: bare ? 0 : 4 },
      splits: (u, k, lo, hi) => { const [ticks, texts] = found(u, lo, hi); words = across && axis.names ? ticks.map((t) => named(one, one.wide).words[t]) : texts; return ticks; },
      filter: (u, splits) => splits,
      values: (u, splits) => splits.map((v, k) => (bare || (across && !axis.names && cut(u, v, words[k])) ? "" : words[k] ?? "")),
      rotate: () => (across && axis.names ? named(one, one.wide).turn : 0),
      lineGap: ROW / AXIS,
      size: (u, values) => (bare ? 0 : !across ? Math.max(one.figure.room, wide(values || [])) : axis.names ? named(one, one.wide).size : NUMBERS),
    };
  }
  /* A label where it has room, else its unit alone. */
  const shortLabel = (label, room) => (long(label) <= room ? label : (unit(label).trim() && long(unit(label)) <= room ? unit(label).trim() : shortened(label, room)));
  /* Whether a word below the panel would reach beyond its canvas. */
  function cut(u, v, word) {
    const at = u.bbox.left / (devicePixelRatio || 1) + u.valToPos(v, "x"), half = word ? long(word) / 2 : 0;
    return at - half < 0 || at + half > u.width;
  }
  /* How the names below a panel of a width stand: upright in all panels of a row where one of them has no room. */
  function named(one, width) {
    const stood = (p) => {
      const [lo, hi] = p.figure.zoomed[p.along] || p.home;
      return standing(p.panel.x.names, (width - p.figure.room - PADDED) / Math.max(hi - lo, 1e-9));
    };
    const n = one.figure.columns || 1, row = Math.floor(one.index / n);
    const all = one.figure.panels.filter((p) => p.panel.x.names && Math.floor(p.index / n) === row);
    const own = stood(one), turned = all.some((p) => stood(p).turn);
    const size = Math.max(own.size, ...all.map((p) => (turned ? upright(p.panel.x.names) : stood(p)).size));
    return { ...(turned ? upright(one.panel.x.names) : own), size };
  }
  const wide = (words) => 18 + Math.ceil(Math.max(14, ...words.map(long)));
  function seriesOf(one) {
    const series = [{}], bands = [];
    for (const c of painted(one.curves).filter(aligned)) {
      const stroke = () => colour(c.colour, one.root);
      c.at = [series.length];
      const paths = c.kind === "step" ? uPlot.paths.stepped({ align: 1 }) : undefined;
      series.push({ stroke, width: c.line, dash: DASHES[c.dash || "-"], points: { show: !!c.symbol, size: 6 }, paths, spanGaps: false });
      if (!c.low) continue;
      c.at.push(series.length, series.length + 1);
      for (let k = 0; k < 2; k++) series.push({ width: 0, points: { show: false } });
      bands.push({ series: [series.length - 1, series.length - 2], fill: () => faded(colour(c.colour, one.root)) });
    }
    if (series.length === 1) series.push({ width: 0, points: { show: false } });
    return [series, bands];
  }
  function faded(hex) {
    const long = hex.length === 4 ? hex.replace(/[0-9a-f]/gi, "$&$&") : hex;
    return /^#[0-9a-f]{6}$/i.test(long) ? long + "26" : hex;
  }
  const shape = (curves) => curves.map((c) => [c.kind, c.name, c.colour, c.dash, !!c.low].join()).join(";");

  class Panel {
    constructor(figure, panel, index, bare) {
      Object.assign(this, { figure, index, bare, hidden: figure.hidden, root: figure.root, hovered: null });
      this.box = element("div", "uq-panel", figure.body);
      this.box.dataset.panel = index;
      this.title = element("div", "uq-panel-title", this.box);
      this.place = element("div", "uq-place", this.box);
      this.set(panel);
    }
    set(panel) {
      const was = this.curves && shape(this.curves), axes = this.panel && JSON.stringify([this.panel.x, this.panel.y]);
      this.panel = panel;
      this.along = (panel.x.label || "") + "|" + (panel.x.scale || "");
      this.curves = curvesOf(panel, this.figure.spec.data);
      this.map = mapOf(panel, this.figure.spec.data);
      this.natural = homeX(panel, this.curves, this.map);
      this.squareness = [this.squareness ? this.squareness[0] : 0, 0]; // height over width of an equal panel, how often it was fitted
      this.home = this.squared(this.natural);
      this.title.textContent = panel.title || "";
      this.title.hidden = !panel.title;
      if (this.plot && (shape(this.curves) !== was || JSON.stringify([panel.x, panel.y]) !== axes)) this.drop();
      if (!this.plot) return;
      seriesOf(this); // the new curves learn their places; the drawn series are the same
      this.plot.batch(() => {
        this.plot.setData(table(this.curves, this.home), false);
        const [min, max] = this.figure.zoomed[this.along] || this.home;
        this.plot.setScale("x", { min, max });
      });
    }
    yRange([lo, hi]) {
      if (this.panel.equal && this.squareness[0]) {
        const up = this.upright(), half = ((hi - lo) * this.squareness[0]) / 2;
        return [(up[0] + up[1]) / 2 - half, (up[0] + up[1]) / 2 + half];
      }
      const across = this.map && edges(this.map.y, this.panel.y.scale === "log");
      return this.figure.shareY || shownRange(this.panel.y) || (across && [across[0], across[across.length - 1]]) || fitY(this.panel, this.curves, this.hidden, [lo, hi]);
    }
    /* The room beside the panel for the words of its y axis: panels below one another begin at one place. */
    needs(height) {
      const [lo, hi] = this.yRange(this.figure.zoomed[this.along] || this.home);
      return wide(ticksOf(this.panel.y, lo, hi, height, false)[1]);
    }
    draw(width, height) {
      this.wide = width;
      this.squareness[1] = 0;
      if (this.plot) { this.plot.setSize({ width, height }); return; }
      const [series, bands] = seriesOf(this);
      const log = (axis) => (axis.scale === "log" ? { distr: 3, log: 10 } : {});
      const start = this.figure.zoomed[this.along] || this.home;
      const options = {
        width, height, series, bands, legend: { show: false }, padding: [6, this.figure.spec.share ? 16 : PADDED, this.bare.x ? 4 : 0, this.bare.y ? 4 : 0],
        scales: {
          x: { time: false, ...log(this.panel.x), min: start[0], max: start[1], range: (u, lo, hi) => (this.spanned = [lo ?? this.home[0], hi ?? this.home[1]]) },
          y: { ...log(this.panel.y), range: () => this.yRange(this.spanned || this.home) }, // x comes first, and `scales` still holds what it was
        },
        axes: [axisOf(this, "x", 2), axisOf(this, "y", 3)],
        cursor: {
          y: false, points: { show: false }, drag: { x: true, y: false, dist: 5, setScale: false },
          sync: { key: this.figure.key + this.along, setSeries: false, scales: ["x", null], filters: { pub: (type) => type === "mousemove" || type === "mouseleave" } },
          bind: { dblclick: () => () => { this.figure.reset(); return null; } },
        },
        hooks: {
          drawClear: [(u) => drawRegions(u, this)],
          draw: [(u) => drawFree(u, this), (u) => this.panel.equal && this.square(u)],
          setSelect: [(u) => this.selected(u)],
          setCursor: [(u) => this.figure.active === this && this.figure.read(this, u.cursor.left, u.cursor.top)],
        },
      };
      this.plot = new uPlot(options, table(this.curves, this.home), this.place);
      if (start !== this.home) this.plot.setScale("x", { min: start[0], max: start[1] });
      for (const c of this.curves) if (this.hidden.has(c.name)) this.show(c.name, false);
      this.listen();
    }
    /* One unit is as long up as across: what has more room shows more. Words beside the axes may grow, so it settles. */
    square(u) {
      const ratio = u.bbox.height / u.bbox.width, [was, tries] = this.squareness;
      if (!(ratio > 0) || Math.abs(ratio / was - 1) < 1e-3 || tries > 5) return;
      this.squareness = [ratio, tries + 1];
      this.home = this.squared(this.natural);
      const [min, max] = this.figure.zoomed[this.along] || this.home;
      queueMicrotask(() => this.plot === u && u.setScale("x", { min, max })); // not within a drawing, which forgets it
    }
    squared([lo, hi]) {
      if (!this.panel.equal || !this.squareness[0]) return [lo, hi];
      const up = this.upright(), more = Math.max(0, (up[1] - up[0]) / this.squareness[0] - (hi - lo)) / 2;
      return [lo - more, hi + more];
    }
    upright() { return shownRange(this.panel.y) || fitY(this.panel, this.curves, this.hidden, this.natural); }
    selected(u) {
      const { left, width } = u.select;
      if (width > 4) this.figure.zoom(u.posToVal(left, "x"), u.posToVal(left + width, "x"), this.along);
      u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
    }
    listen() {
      const over = this.plot.over;
      let down = null, waiting = null; // one click enlarges, two reset the zoom
      over.addEventListener("mouseenter", () => (this.figure.active = this));
      over.addEventListener("mousedown", (e) => (down = [e.clientX, e.clientY]));
      over.addEventListener("click", (e) => {
        if (!down || Math.hypot(e.clientX - down[0], e.clientY - down[1]) > 4) return;
        const { left, top } = over.getBoundingClientRect();
        const at = { panel: this.index, x: this.plot.posToVal(e.clientX - left, "x"), y: this.plot.posToVal(e.clientY - top, "y") };
        this.figure.say("uq-click", at);
        clearTimeout(waiting);
        if (e.detail === 1 && (this.figure.spec.enlarge || this.panel.detail)) waiting = setTimeout(() => enlarge(this.figure.spec, this.panel), 250);
      });
    }
    show(name, shown) {
      if (!this.plot) return;
      const of = this.curves.filter((c) => c.name === name);
      this.plot.batch(() => of.forEach((c) => (c.at || []).forEach((k) => this.plot.setSeries(k, { show: shown }, false))));
      this.plot.setScale("x", { min: this.plot.scales.x.min, max: this.plot.scales.x.max });
      this.plot.redraw(true, true);
    }
    highlight(name) {
      this.hovered = name;
      if (!this.plot) return;
      for (const c of this.curves) for (const k of (c.at || []).slice(0, 1)) this.plot.series[k].width = c.name === name ? Math.max(c.line, HOVER) : c.line;
      this.plot.redraw(false);
    }
    /* The value of every curve at a place of the plot, by name. */
    values(left, top) {
      const found = {};
      if (!this.plot || left < 0) return found;
      const x = this.plot.posToVal(left, "x");
      if (this.map) {
        const y = this.plot.posToVal(top, "y"), at = (ends, v) => ends.findIndex((e, k) => k + 1 < ends.length && v >= e && v < ends[k + 1]);
        const [j, i] = [at(edges(this.map.x, this.panel.x.scale === "log"), x), at(edges(this.map.y, this.panel.y.scale === "log"), y)];
        if (i >= 0 && j >= 0) found[mapWords(this.map)] = written(this.map.z[i * this.map.x.length + j]);
      }
      for (const c of this.curves) {
        if (this.hidden.has(c.name) || !c.name) continue;
        let k = -1;
        if (aligned(c)) {
          k = first(c.x, x);
          if (k > 0 && (k === c.x.length || x - c.x[k - 1] < c.x[k] - x)) k--;
          if (x < this.plot.scales.x.min || c.y[k] == null) k = -1;
        } else {
          let near = 24;
          for (let j = 0; j < c.x.length; j++) {
            if (c.y[j] == null) continue;
            const far = Math.hypot(this.plot.valToPos(c.x[j], "x") - left, c.kind === "bars" ? 0 : this.plot.valToPos(c.y[j], "y") - top);
            if (far < near) [near, k] = [far, j];
          }
        }
        if (k >= 0 && !(c.name in found)) found[c.name] = aligned(c) || c.kind === "bars" ? written(c.y[k]) : written(c.x[k]) + ", " + written(c.y[k]);
      }
      return found;
    }
    drop() { this.plot.destroy(); this.plot = null; }
  }

  // ---- a figure: panels, legend, tools ----------------------------------------------------------------------------
  let count = 0;
  class Figure {
    constructor(root, spec) {
      Object.assign(this, { root, hidden: new Set(), zoomed: {}, active: null, key: "uq-" + ++count, panels: [], room: 0 });
      root.classList.add("uq");
      root.tabIndex = root.tabIndex >= 0 ? root.tabIndex : 0;
      this.head = element("div", "uq-head", root);
      this.heading = element("div", "uq-title", this.head);
      this.tools = element("div", "uq-tools", this.head);
      this.main = element("div", "uq-main", root);
      this.body = element("div", "uq-body", this.main);
      this.legend = element("div", "uq-legend", this.main);
      for (const [word, keys, work] of [["SVG", "S", () => this.save("svg")], ["PNG", "S", () => this.save("png")], ["CSV", "D", () => this.save("csv")]]) {
        const button = element("button", "uq-tool", this.tools, word);
        button.type = "button"; button.title = `save as ${word} (${keys})`; button.onclick = work;
      }
      this.onKey = (e) => {
        if (e.ctrlKey || e.metaKey || e.altKey || /^(INPUT|TEXTAREA|SELECT)$/.test(e.target.tagName)) return;
        if (!root.matches(":hover") && !root.contains(document.activeElement)) return;
        if (e.key === "s" || e.key === "S") { this.save("svg"); this.save("png"); }
        if (e.key === "d" || e.key === "D") this.save("csv");
      };
      document.addEventListener("keydown", this.onKey);
      this.body.addEventListener("mouseleave", () => this.read(null));
      this.sized = new ResizeObserver(() => this.layout());
      this.seen = new IntersectionObserver((rows) => {
        if (rows.some((r) => r.isIntersecting) && !this.visible) { this.visible = true; this.layout(); }
      }, { rootMargin: "400px" });
      drawn.add(this);
      this.update(spec);
      this.sized.observe(root);
      this.seen.observe(root);
    }
    update(spec) {
      const same = this.spec && this.panels.length === spec.panels.length && this.spec.columns === spec.columns && this.spec.share === spec.share;
      this.spec = spec;
      this.shareY = null;
      this.heading.textContent = spec.title || "";
      if (spec.tools === false) this.tools.hidden = true;
      const columns = Math.min(spec.columns || 1, spec.panels.length || 1), rows = Math.ceil(spec.panels.length / columns);
      if (!same) {
        this.panels.forEach((p) => p.plot && p.drop());
        this.body.replaceChildren();
        this.panels = spec.panels.map((p, k) => new Panel(this, p, k, {
          x: !!spec.share && k + columns < spec.panels.length && Math.floor(k / columns) < rows, y: !!spec.share && k % columns > 0,
        }));
      } else spec.panels.forEach((p, k) => this.panels[k].set(p));
      if (spec.share) this.shareY = this.sharedY();
      this.columns = columns;
      const key = JSON.stringify(this.entries());
      if (key !== this.legendKey) { this.legendKey = key; this.list(); }
      this.layout();
    }
    sharedY() {
      let [lo, hi] = [Infinity, -Infinity];
      for (const p of this.panels) {
        const range = shownRange(p.panel.y) || fitY(p.panel, p.curves, this.hidden, p.home);
        [lo, hi] = [Math.min(lo, range[0]), Math.max(hi, range[1])];
      }
      return hi > lo ? [lo, hi] : null;
    }
    entries() {
      const found = new Map();
      for (const { panel, curves, map } of this.panels) {
        if (map && !found.has(mapWords(map))) found.set(mapWords(map), { kind: "map", colour: "measured" });
        for (const c of curves) if (c.name && !found.has(c.name)) found.set(c.name, { kind: c.kind, colour: c.colour, dash: c.dash, symbol: c.symbol });
        for (const m of panel.marks || []) if (m.name && !found.has(m.name)) found.set(m.name, { kind: "mark", colour: m.colour || "muted", dash: m.dash || "--" });
        for (const r of panel.regions || []) if (r.name && !found.has(r.name)) found.set(r.name, { kind: "region", colour: r.colour || "requirement" });
      }
      return [...found];
    }
    list() {
      this.legend.replaceChildren();
      this.legend.hidden = this.spec.legend === "none" || !this.entries().length;
      this.main.classList.toggle("uq-beside", this.spec.legend === "right");
      this.values = {};
      for (const [name, look] of this.entries()) {
        const entry = element("button", "uq-entry", this.legend);
        entry.type = "button";
        entry.innerHTML = swatch(look);
        element("span", "uq-name", entry, name);
        this.values[name] = element("span", "uq-value", entry);
        entry.setAttribute("aria-pressed", String(!this.hidden.has(name)));
        entry.onclick = () => this.toggle(name, this.hidden.has(name));
        entry.onmouseenter = () => this.panels.forEach((p) => p.highlight(name));
        entry.onmouseleave = () => this.panels.forEach((p) => p.highlight(null));
      }
      this.at = element("span", "uq-at", this.legend);
    }
    toggle(name, shown) {
      shown ? this.hidden.delete(name) : this.hidden.add(name);
      [...this.legend.querySelectorAll(".uq-entry")].forEach((e) => {
        if (e.querySelector(".uq-name").textContent === name) e.setAttribute("aria-pressed", String(shown));
      });
      this.panels.forEach((p) => p.show(name, shown));
      this.say("uq-toggle", { name, shown });
    }
    read(panel, left, top) {
      const beside = panel && this.panels.length <= 4 ? this.panels.filter((p) => p.along === panel.along) : [panel];
      const all = panel ? beside.map((p) => p.values(p === panel ? left : p.plot ? p.plot.valToPos(panel.plot.posToVal(left, "x"), "x") : -1, top)) : [];
      for (const name in this.values) this.values[name].textContent = all.map((v) => v[name]).filter((v) => v != null).join(" | ");
      if (!this.at) return;
      const free = panel && panel.curves.every((c) => !aligned(c));
      this.at.textContent = !panel || left < 0 || free ? "" : (this.panels.length > 4 ? panel.panel.title + " " : "") + "at " + written(panel.plot.posToVal(left, "x")) + unit(panel.panel.x.label);
    }
    /* Panels over the same quantity are zoomed together; without `along` those like the first. */
    zoom(lo, hi, along = this.panels[0].along) {
      this.zoomed[along] = [lo, hi];
      for (const p of this.panels) {
        p.squareness[1] = 0;
        if (p.plot && p.along === along) p.plot.setScale("x", { min: lo, max: hi });
      }
      this.say("uq-zoom", { lo, hi, along });
    }
    reset() {
      this.zoomed = {};
      for (const p of this.panels) if (p.plot) p.plot.setScale("x", { min: p.home[0], max: p.home[1] });
      this.say("uq-zoom", { lo: null, hi: null, along: null });
    }
    layout() {
      const total = this.body.clientWidth;
      if (!this.visible || !total) return this.reserve();
      const n = this.columns, share = this.spec.share;
      const gutter = share ? 56 : 0, foot = share ? 44 : 0;
      const each = Math.floor((total - gutter - (n - 1) * 8) / n);
      this.room = Math.max(...this.panels.filter((p) => !p.bare.y).map((p) => p.needs(this.heightOf(p, each) - 60)));
      this.body.style.minHeight = "";
      this.body.classList.toggle("uq-narrow", each < NARROW);
      const widths = Array.from({ length: n }, (_, k) => each + (k ? 0 : gutter));
      this.body.style.gridTemplateColumns = widths.map((w) => w + "px").join(" ");
      this.fold(widths);
      this.panels.forEach((p, k) => {
        const width = widths[k % n];
        const height = this.heightOf(p, each) + (share && !p.bare.x ? foot : 0);
        p.draw(p.panel.aspect ? Math.min(width, Math.round((p.panel.height || TALLEST) * p.panel.aspect)) : width, height);
      });
    }
    /* Titles take a second row where they have no room; curves side by side begin at one height all the same.
       Returns by how much they are taller than titles of one row. */
    fold(widths) {
      const size = widths.every((w) => w >= NARROW) ? AXIS : AXIS - 2;
      let more = 0;
      for (let k = 0; k < this.panels.length; k += this.columns) {
        const beside = this.panels.slice(k, k + this.columns);
        const rows = beside.map((p, j) => inRows(p.panel.title || "", widths[j], size));
        const most = Math.max(...rows.map((r) => r.length));
        beside.forEach((p, j) => {
          const whole = p.panel.title || "";
          p.title.textContent = rows[j].join("\n");
          if (rows[j].join(" ") === whole) p.title.removeAttribute("title"); else p.title.title = whole;
          p.title.style.minHeight = most > 1 ? `${1.4 * most}em` : "";
        });
        more += (most - 1) * 1.4 * size;
      }
      return more;
    }
    heightOf(p, width) {
      if (p.panel.aspect) return Math.round(Math.min(width, (p.panel.height || TALLEST) * p.panel.aspect) / p.panel.aspect);
      const below = p.panel.x.names ? named(p, width).size - NUMBERS : 0; // names take their room below, not from the curves
      return below + (p.panel.height || (this.columns >= 4 ? Math.max(70, Math.round(width * 0.62)) : 240));
    }
    /* Before it is drawn a figure takes the room that it will need, so that nothing moves later. */
    reserve() {
      const n = this.columns, width = (this.body.clientWidth || 800) / n;
      let height = this.fold(Array(n).fill(width));
      for (let k = 0; k < this.panels.length; k += n) height += this.heightOf(this.panels[k], width) + 24;
      this.body.style.minHeight = this.visible ? "" : height + "px";
    }
    say(type, detail) { this.root.dispatchEvent(new CustomEvent(type, { detail, bubbles: true })); }
    redraw() { this.panels.forEach((p) => p.plot && p.plot.redraw(false, true)); }
    get plots() { return this.panels.map((p) => p.plot); }
    destroy() {
      this.sized.disconnect(); this.seen.disconnect(); drawn.delete(this);
      document.removeEventListener("keydown", this.onKey);
      this.panels.forEach((p) => p.plot && p.drop());
      this.root.replaceChildren();
    }
    // ---- what leaves the page
    csv() {
      const quoted = (v) => (/[",\n]/.test(v) ? '"' + String(v).replace(/"/g, '""') + '"' : v);
      const rows = ["panel,curve,x label,x,y label,y,low,high"];
      const maps = this.panels.filter((p) => p.map);
      if (maps.length) rows[0] += ",value";
      for (const { panel, map } of maps)
        map.y.forEach((y, i) => map.x.forEach((x, j) => rows.push([panel.title || "", map.name, panel.x.label || "", x, panel.y.label || "", y, "", "", map.z[i * map.x.length + j]].map(quoted).join())));
      for (const { panel, curves } of this.panels)
        for (const c of curves)
          for (let k = 0; k < c.x.length; k++)
            rows.push([panel.title || "", c.name || "", panel.x.label || "", c.x[k], panel.y.label || "", c.y[k] ?? "", c.low?.[k] ?? "", c.high?.[k] ?? ""].map(quoted).join());
      return rows.join("\n") + "\n";
    }
    png() { return pictured(this); }
    svg() { return vector(this); }
    save(form) {
      this.visible = true; this.layout();
      const name = (this.spec.name || this.spec.title || "chart").replace(/[^\w.-]+/g, "-").toLowerCase();
      const offer = (url) => { const a = element("a"); a.href = url; a.download = name + "." + form; a.click(); };
      if (form === "png") return offer(this.png().toDataURL("image/png"));
      const blob = new Blob([form === "csv" ? this.csv() : this.svg()], { type: form === "csv" ? "text/csv" : "image/svg+xml" });
      const url = URL.createObjectURL(blob);
      offer(url);
      setTimeout(() => URL.revokeObjectURL(url), 1000);
    }
  }
  const unit = (label) => { const m = /\(((?:[^()]|\([^()]*\))+)\)\s*$/.exec(label || ""); return m ? " " + m[1] : ""; };
  function swatch({ kind, colour: word, dash, symbol: mark }) {
    const paint = /^(#|rgb)/.test(word) ? word : `var(--uq-${word})`;
    const inner = kind === "map" ? RAMP.slice(0, 4).map((_, k) => `<rect x="${1 + 5.5 * k}" y="2" width="6" height="10" fill="${rampColour(k / 3)}"/>`).join("")
      : kind === "region" ? `<rect x="1" y="2" width="22" height="10" style="fill:${paint}${word === "requirement" ? "" : ";opacity:.3"}"/>`
      : kind === "bars" ? `<rect x="6" y="2" width="12" height="10" style="fill:${paint}"/>`
      : kind === "points" && mark === "x" ? `<path d="M8 3l8 8M8 11l8-8" style="stroke:${paint};fill:none;stroke-width:1.5"/>`
      : kind === "points" && mark === "+" ? `<path d="M12 2v10M7 7h10" style="stroke:${paint};fill:none;stroke-width:1.5"/>`
      : kind === "points" ? `<circle cx="12" cy="7" r="4" style="stroke:${paint};stroke-width:1.5;fill:${!mark || mark === "." ? paint : "none"}"/>`
      : `<path d="M1 7h22" style="stroke:${paint};stroke-width:2" stroke-dasharray="${DASHES[dash || "-"].join(" ")}"/>`;
    return `<svg class="uq-swatch" width="24" height="14" aria-hidden="true">${inner}</svg>`;
  }

  function enlarge(spec, panel) {
    const dialog = element("dialog", "uq-dialog", document.body);
    const close = element("button", "uq-close", dialog, "close");
    close.type = "button";
    close.onclick = () => dialog.close();
    const place = element("div", "", dialog);
    dialog.showModal();
    const big = { ...panel, height: 320, title: "", tinted: false };
    delete big.detail;
    const figure = new Figure(place, {
      name: `${spec.name || "panel"}-${panel.title || ""}`, title: panel.title || spec.title, data: spec.data, columns: 1,
      panels: [big, ...(panel.detail || [])],
    });
    dialog.addEventListener("close", () => { figure.destroy(); dialog.remove(); });
    dialog.addEventListener("click", (e) => e.target === dialog && dialog.close());
  }

  // ---- pictures of a figure ---------------------------------------------------------------------------------------
  function placed(figure) {
    const frame = figure.root.getBoundingClientRect();
    return figure.panels.filter((p) => p.plot).map((p) => {
      const box = p.place.getBoundingClientRect();
      return [p, box.left - frame.left, box.top - frame.top];
    });
  }
  function words(figure) {
    const frame = figure.root.getBoundingClientRect();
    const of = (node, weight) => {
      const b = node.getBoundingClientRect(), style = getComputedStyle(node), size = parseFloat(style.fontSize), row = 1.4 * size;
      return node.textContent.split("\n").map((text, k) => ({ text, x: b.left - frame.left, y: b.top - frame.top + (k + 0.75) * row, weight, size }));
    };
    return [of(figure.heading, 600), ...figure.panels.filter((p) => p.panel.title).map((p) => of(p.title, 400)),
      ...[...figure.legend.querySelectorAll(".uq-name")].map((n) => of(n, 400))].flat().filter((w) => w.text);
  }
  function pictured(figure) {
    const ratio = devicePixelRatio || 1, frame = figure.root.getBoundingClientRect();
    const canvas = element("canvas");
    [canvas.width, canvas.height] = [Math.ceil(frame.width * ratio), Math.ceil(frame.height * ratio)];
    const ctx = canvas.getContext("2d");
    ctx.fillStyle = colour("paper", figure.root);
    ctx.fillRect(0, 0, canvas.width, canvas.height);
    for (const [p, x, y] of placed(figure)) ctx.drawImage(p.plot.ctx.canvas, x * ratio, y * ratio);
    ctx.fillStyle = colour("ink", figure.root);
    for (const w of words(figure)) { ctx.font = `${w.weight} ${w.size * ratio}px system-ui, sans-serif`; ctx.fillText(w.text, w.x * ratio, w.y * ratio); }
    swatches(figure).forEach(({ look, x, y }) => {
      ctx.strokeStyle = ctx.fillStyle = colour(look.colour, figure.root);
      ctx.lineWidth = 2 * ratio;
      ctx.setLineDash(DASHES[look.dash || "-"].map((d) => d * ratio));
      if (look.kind === "map") [0, 1, 2, 3].forEach((k) => { ctx.fillStyle = rampColour(k / 3); ctx.fillRect((x + 1 + 5.5 * k) * ratio, (y + 2) * ratio, 6 * ratio, 10 * ratio); });
      else if (look.kind === "region" || look.kind === "bars") ctx.fillRect(x * ratio, (y + 2) * ratio, 22 * ratio, 10 * ratio);
      else if (look.kind === "points") symbol(ctx, look.symbol || ".", (x + 12) * ratio, (y + 7) * ratio, 4 * ratio);
      else { ctx.beginPath(); ctx.moveTo(x * ratio, (y + 7) * ratio); ctx.lineTo((x + 24) * ratio, (y + 7) * ratio); ctx.stroke(); }
    });
    return canvas;
  }
  function swatches(figure) {
    const frame = figure.root.getBoundingClientRect(), looks = new Map(figure.entries());
    return [...figure.legend.querySelectorAll(".uq-entry")].map((e) => {
      const b = e.querySelector(".uq-swatch").getBoundingClientRect();
      return { look: looks.get(e.querySelector(".uq-name").textContent), x: b.left - frame.left, y: b.top - frame.top };
    });
  }
  /* The figure as vectors: what the canvases show, from the same ticks and data. */
  function vector(figure) {
    const escape = (t) => String(t).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/"/g, "&quot;");
    const frame = figure.root.getBoundingClientRect(), paint = (w) => escape(colour(w, figure.root));
    const out = [`<svg xmlns="http://www.w3.org/2000/svg" width="${frame.width}" height="${frame.height}" font-family="system-ui, sans-serif" font-size="${AXIS}">`,
      `<rect width="100%" height="100%" fill="${paint("paper")}"/>`];
    const text = (x, y, t, anchor, extra = "") => t && out.push(`<text x="${x.toFixed(1)}" y="${y.toFixed(1)}" text-anchor="${anchor}" fill="${paint("muted")}"${extra}>${escape(t)}</text>`);
    placed(figure).forEach(([p, x0, y0], k) => {
      const u = p.plot, ratio = devicePixelRatio || 1;
      const [left, top, w, h] = [x0 + u.bbox.left / ratio, y0 + u.bbox.top / ratio, u.bbox.width / ratio, u.bbox.height / ratio];
      const px = (v) => left + u.valToPos(v, "x"), py = (v) => top + u.valToPos(v, "y");
      out.push(`<clipPath id="c${k}"><rect x="${left}" y="${top}" width="${w}" height="${h}"/></clipPath>`);
      const [xt, xw] = ticksOf(p.panel.x, u.scales.x.min, u.scales.x.max, w, true), [yt, yw] = ticksOf(p.panel.y, u.scales.y.min, u.scales.y.max, h, false);
      if (p.map && !p.hidden.has(mapWords(p.map))) {
        const sheet = element("canvas");
        [sheet.width, sheet.height] = [Math.ceil(w), Math.ceil(h)];
        paintMap(sheet.getContext("2d"), p.map, p.panel, (v) => px(v) - left, (v) => py(v) - top);
        out.push(`<image x="${left}" y="${top}" width="${w}" height="${h}" href=${JSON.stringify(sheet.toDataURL("image/png"))}/>`);
      }
      for (const r of p.panel.regions || []) {
        const [a, b] = r.x ? r.x.map((v, j) => (v == null ? [left, left + w][j] : px(v))) : [left, left + w];
        const [c, d] = r.y ? r.y.map((v, j) => (v == null ? [top + h, top][j] : py(v))) : [top + h, top];
        out.push(`<rect clip-path="url(#c${k})" x="${Math.min(a, b)}" y="${Math.min(c, d)}" width="${Math.abs(b - a)}" height="${Math.abs(d - c)}" fill="${paint(r.colour || "requirement")}" ${(r.colour || "requirement") === "requirement" ? "" : 'opacity=".15"'}/>`);
      }
      const stand = p.panel.x.names ? named(p, p.wide) : null;
      const under = (x, v, word) => {
        if (!stand) return text(x, top + h + 16, word, "middle");
        if (stand.turn) return text(x + 4, top + h + 8, stand.words[v], "end", ` transform="rotate(${stand.turn} ${x + 4} ${top + h + 8})"`);
        stand.words[v].split("\n").forEach((row, k) => text(x, top + h + 16 + ROW * k, row, "middle"));
      };
      xt.forEach((v, j) => { out.push(`<path d="M${px(v).toFixed(1)} ${top}v${h}" stroke="${paint("grid")}"/>`); if (!p.bare.x) under(px(v), v, xw[j]); });
      yt.forEach((v, j) => { out.push(`<path d="M${left} ${py(v).toFixed(1)}h${w}" stroke="${paint("grid")}"/>`); if (!p.bare.y) text(left - 6, py(v) + 4, yw[j], "end"); });
      if (!p.bare.x) text(left + w / 2, top + h + 12 + (stand ? stand.size : NUMBERS), p.panel.x.label, "middle");
      if (!p.bare.y) text(x0 + 12, top + h / 2, p.panel.y.label, "middle", ` transform="rotate(-90 ${x0 + 12} ${top + h / 2})"`);
      for (const c of painted(p.curves)) {
        if (p.hidden.has(c.name)) continue;
        const stroke = `stroke="${paint(c.colour)}" stroke-width="${c.line}" fill="none" stroke-dasharray="${DASHES[c.dash || "-"].join(" ")}" clip-path="url(#c${k})"`;
        const line = (ys) => { let d = "", on = false; for (let j = 0; j < c.x.length; j++) { if (ys[j] == null) { on = false; continue; } d += (on ? "L" : "M") + px(c.x[j]).toFixed(1) + " " + py(ys[j]).toFixed(1); on = true; } return d; };
        if (aligned(c) || c.kind === "path") out.push(`<path d="${line(c.y)}" ${stroke}/>`);
        if (c.low) out.push(`<path d="${line(c.low)}" ${stroke} opacity=".4"/><path d="${line(c.high)}" ${stroke} opacity=".4"/>`);
        if (c.kind === "points") for (let j = 0; j < c.x.length; j++) if (c.y[j] != null) out.push(c.symbol === "x" ? `<path d="M${px(c.x[j]) - 3} ${py(c.y[j]) - 3}l6 6m0 -6l-6 6" ${stroke}/>` : `<circle cx="${px(c.x[j])}" cy="${py(c.y[j])}" r="3" ${stroke}/>`);
        if (c.kind === "bars" || c.kind === "stems") for (let j = 0; j < c.x.length; j++) if (c.y[j] != null) {
          const zero = py(Math.max(u.scales.y.min, Math.min(u.scales.y.max, 0))), half = c.kind === "bars" ? Math.abs(px(c.x[j] + c.width / 2) - px(c.x[j])) : 0.75;
          out.push(`<rect clip-path="url(#c${k})" x="${px(c.x[j]) - half}" y="${Math.min(zero, py(c.y[j]))}" width="${2 * half}" height="${Math.abs(zero - py(c.y[j]))}" fill="${paint(c.colour)}"/>`);
        }
      }
      for (const m of p.panel.marks || []) out.push(`<path d="${m.x != null ? `M${px(m.x)} ${top}v${h}` : `M${left} ${py(m.y)}h${w}`}" stroke="${paint(m.colour || "muted")}" stroke-dasharray="6 4" clip-path="url(#c${k})"/>`);
    });
    for (const w of words(figure)) text(w.x, w.y, w.text, "start", ` font-weight="${w.weight}" font-size="${w.size}"`);
    for (const { look, x, y } of swatches(figure)) out.push(`<path d="M${x} ${y + 7}h24" stroke="${paint(look.colour)}" stroke-width="${look.kind === "region" || look.kind === "bars" ? 10 : 2}" stroke-dasharray="${DASHES[look.dash || "-"].join(" ")}"/>`);
    out.push("</svg>");
    return out.join("\n");
  }

  // ---- shapes in space, moving ------------------------------------------------------------------------------------
  const TURN_S = 2.4, SWING = 0.22, PIXELS_A_RADIAN = 160, TILT = 0.35, LOW = 110, HIGH = 220;
  class Scene {
    constructor(root, spec) {
      Object.assign(this, { root, turn: 0.6, tilt: TILT, visible: false, still: matchMedia("(prefers-reduced-motion: reduce)").matches });
      root.classList.add("uq");
      this.seenBy = new IntersectionObserver((rows) => { this.visible = rows[rows.length - 1].isIntersecting; this.play(); });
      this.sized = new ResizeObserver(() => this.paint());
      this.update(spec);
      this.seenBy.observe(root);
      this.sized.observe(root);
    }
    destroy() { this.seenBy.disconnect(); this.sized.disconnect(); this.visible = false; this.root.replaceChildren(); }
    update(spec) {
      const root = this.root;
      this.spec = spec;
      root.replaceChildren();
      const head = element("div", "uq-head", root);
      element("div", "uq-title", head, spec.title);
      const tools = element("div", "uq-tools", head);
      const button = (word, why, work) => { const made = element("button", "uq-tool", tools, word); made.type = "button"; made.title = why; made.onclick = work; return made; };
      button("stop", "stop or go on", (e) => { this.still = !this.still; e.target.textContent = this.still ? "move" : "stop"; this.play(); }).textContent = this.still ? "move" : "stop";
      button("PNG", "save as PNG", () => this.save("png"));
      button("CSV", "save the numbers", () => this.save("csv"));
      this.points = array(spec.points, spec.data);
      this.shapes = spec.shapes.map((s) => ({ name: s.name, re: array(s.re, spec.data), im: array(s.im, spec.data) }));
      const body = element("div", "uq-body uq-scenes", root);
      this.places = this.shapes.map((s) => {
        const box = element("div", "uq-panel", body);
        element("div", "uq-panel-title", box, s.name);
        const canvas = element("canvas", "uq-scene", box);
        canvas.setAttribute("role", "img");
        canvas.setAttribute("aria-label", `${spec.title}: ${s.name}`);
        this.turned(canvas);
        return canvas;
      });
      const legend = element("div", "uq-legend", root);
      for (const [word, paint] of [["at rest", "open"], ["moving; drag to turn", "chosen"]]) {
        const entry = element("span", "uq-entry", legend);
        entry.innerHTML = swatch({ kind: "line", colour: paint });
        element("span", "", entry, word);
      }
      const n = this.points.length / 3;
      this.middle = [0, 1, 2].map((a) => { let sum = 0; for (let k = 0; k < n; k++) sum += this.points[3 * k + a] / n; return sum; });
      this.reach = 1e-300;
      let [across, up] = [0, 0];
      for (let k = 0; k < n; k++) {
        const [x, y, z] = [0, 1, 2].map((a) => this.points[3 * k + a] - this.middle[a]);
        [this.reach, across, up] = [Math.max(this.reach, Math.hypot(x, y, z)), Math.max(across, Math.hypot(x, y)), Math.max(up, Math.abs(z))];
      }
      this.half = [across, up].map((size) => size + SWING * this.reach); // whatever moves stays within
      this.paint();
    }
    turned(canvas) {
      canvas.onpointerdown = (e) => { canvas.setPointerCapture(e.pointerId); this.from = [e.clientX, e.clientY, this.turn, this.tilt]; };
      canvas.onpointermove = (e) => {
        if (!this.from) return;
        this.turn = this.from[2] + (e.clientX - this.from[0]) / PIXELS_A_RADIAN;
        this.tilt = Math.max(-1.5, Math.min(1.5, this.from[3] + (e.clientY - this.from[1]) / PIXELS_A_RADIAN));
        if (this.still) this.paint();
      };
      canvas.onpointerup = canvas.onpointercancel = () => (this.from = null);
    }
    play() {
      if (this.frame || this.still || !this.visible) return this.still && this.paint();
      const step = () => { this.frame = 0; this.paint(); if (!this.still && this.visible) this.frame = requestAnimationFrame(step); };
      this.frame = requestAnimationFrame(step);
    }
    /* Where a point of a shape is on its canvas: turned about the vertical, tilted, without perspective. */
    seen(shape, angle, k, middle, scale) {
      const at = [0, 1, 2].map((a) => this.points[3 * k + a] - this.middle[a] + (shape ? SWING * this.reach * (shape.re[3 * k + a] * Math.cos(angle) - shape.im[3 * k + a] * Math.sin(angle)) : 0));
      const [c, s, ct, st] = [Math.cos(this.turn), Math.sin(this.turn), Math.cos(this.tilt), Math.sin(this.tilt)];
      const x = c * at[0] - s * at[1], y = s * at[0] + c * at[1];
      return [middle[0] + scale * x, middle[1] - scale * (ct * at[2] + st * y)];
    }
    paint() {
      const angle = this.still ? 0 : (2 * Math.PI * performance.now()) / 1000 / TURN_S, ratio = devicePixelRatio || 1;
      const [across, up] = this.half, tall = (tilt) => Math.cos(tilt) * up + Math.abs(Math.sin(tilt)) * across;
      this.places.forEach((canvas, j) => {
        const w = canvas.clientWidth, wanted = Math.round(Math.max(LOW, Math.min(HIGH, (w * tall(TILT)) / across)));
        if (!w) return;
        if (canvas.style.height !== wanted + "px") canvas.style.height = wanted + "px"; // no more than it needs as it stands
        const h = wanted;
        if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) [canvas.width, canvas.height] = [Math.round(w * ratio), Math.round(h * ratio)];
        const ctx = canvas.getContext("2d"), scale = 0.47 * Math.min(w / across, h / tall(this.tilt));
        ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
        ctx.clearRect(0, 0, w, h);
        for (const [shape, paint, wide] of [[null, "open", 1], [this.shapes[j], "chosen", 2]]) {
          ctx.strokeStyle = ctx.fillStyle = colour(paint, this.root);
          ctx.lineWidth = wide;
          const at = Array.from({ length: this.points.length / 3 }, (_, k) => this.seen(shape, angle, k, [w / 2, h / 2], scale));
          ctx.beginPath();
          for (const [a, b] of this.spec.lines) { ctx.moveTo(...at[a]); ctx.lineTo(...at[b]); }
          ctx.stroke();
          if (shape) for (const [x, y] of at) { ctx.beginPath(); ctx.arc(x, y, 2.5, 0, 2 * Math.PI); ctx.fill(); }
        }
      });
    }
    csv() {
      const rows = ["shape,point,x,y,z,x real,y real,z real,x imaginary,y imaginary,z imaginary"];
      for (const s of this.shapes)
        for (let k = 0; k < this.points.length / 3; k++)
          rows.push([`"${s.name.replace(/"/g, '""')}"`, k + 1, ...[this.points, s.re, s.im].flatMap((v) => Array.from(v.slice(3 * k, 3 * k + 3)))].join());
      return rows.join("\n") + "\n";
    }
    save(form) {
      const offer = (url) => { const a = element("a"); a.href = url; a.download = this.spec.name + "." + form; a.click(); };
      if (form === "csv") {
        const url = URL.createObjectURL(new Blob([this.csv()], { type: "text/csv" }));
        offer(url);
        return setTimeout(() => URL.revokeObjectURL(url), 1000);
      }
      const sheet = element("canvas"), each = this.places.filter((c) => c.width);
      [sheet.width, sheet.height] = [Math.max(...each.map((c) => c.width)), each.reduce((sum, c) => sum + c.height, 0)];
      const ctx = sheet.getContext("2d");
      ctx.fillStyle = colour("paper", this.root);
      ctx.fillRect(0, 0, sheet.width, sheet.height);
      each.reduce((y, c) => { ctx.drawImage(c, 0, y); return y + c.height; }, 0);
      offer(sheet.toDataURL("image/png"));
    }
  }

  // ---- themes -----------------------------------------------------------------------------------------------------
  function theme(word) {
    if (word === "auto") delete document.documentElement.dataset.theme; else document.documentElement.dataset.theme = word;
    drawn.forEach((f) => f.redraw());
  }
  new MutationObserver(() => drawn.forEach((f) => f.redraw())).observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme", "class"] });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawn.forEach((f) => f.redraw()));

  const grid = (root, spec) => new Figure(root, spec), scene = (root, spec) => new Scene(root, spec);
  const chart = (root, spec) => {
    const whole = (one) => ({ ...one, columns: 1, legend: one.legend, title: one.title, panels: [{ ...one, title: "" }] });
    const figure = new Figure(root, whole(spec)), update = figure.update.bind(figure);
    figure.update = (one) => update(one.panels ? one : whole(one));
    return figure;
  };
  return { data, chart, grid, scene, theme, colour, figures: drawn };
})();
