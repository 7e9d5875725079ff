/** Curves beside the picture of a replay, scrubbed by its clock: one panel for each quantity, one colour for each line or run. */
"use strict";
function drawCurves({ data, seek, ends }) {
  const COLORS = ["#0072b2", "#d55e00", "#009e73", "#e69f00", "#cc79a7", "#56b4e9", "#000000", "#9a8f00"], INK = "#1d2733", SOFT = "#5b6876";
  const many = data.runs.length > 1, left = 46, right = 8, top = 6, bottom = 16, tall = 100;
  const add = (tag, text, parent, name = "") => {
    const made = document.createElement(tag);
    made.textContent = text;
    if (name) made.className = name;
    parent.append(made);
    return made;
  };

  // -- what stands beside the picture ------------------------------------------------------------------------------------
  const side = document.createElement("div");
  side.id = "curves";
  side.setAttribute("role", "region");
  side.setAttribute("aria-label", "Curves over time");
  document.getElementById("bar").after(side);
  document.body.classList.add("curves");
  const button = document.createElement("button");
  Object.assign(button, { id: "plots", textContent: "plots", title: "Show or hide the curves (P)" });
  button.setAttribute("aria-pressed", "true");
  button.onclick = () => {
    button.setAttribute("aria-pressed", document.body.classList.toggle("curves"));
    dispatchEvent(new Event("resize"));
  };
  document.getElementById("speed").before(button);

  /** Runs in which a line of a panel is drawn, and its place among the colours. */
  class Panel {
    constructor(described) {
      Object.assign(this, described, { alone: null, drawn: "" });
      this.section = add("section", "", side);
      const head = add("h2", this.title, this.section);
      if (this.unit) add("span", ` [${this.unit}]`, head);
      if (many && this.lines.length > 1) {
        this.chosen = add("select", "", head);
        this.chosen.setAttribute("aria-label", `Curve of ${this.title}`);
        this.lines.forEach((line, k) => { add("option", line.name, this.chosen).value = k; });
        this.chosen.onchange = () => { this.legend(); refresh(); };
      }
      this.box = add("div", "", this.section, "plot");
      this.canvas = add("canvas", "", this.box);
      this.canvas.setAttribute("role", "img");
      this.canvas.setAttribute("aria-label", `${this.title} over time`);
      this.cursor = add("i", "", this.box);
      this.key = add("div", "", this.section, "key");
      this.legend();
      const scrub = event => {
        const box = this.canvas.getBoundingClientRect(), s = (event.clientX - box.left - left) / (box.width - left - right), [a, b] = ends();
        seek(a + Math.min(Math.max(s, 0), 1) * (b - a));
      };
      this.box.onpointerdown = event => { this.box.setPointerCapture(event.pointerId); scrub(event); };
      this.box.onpointermove = event => { if (event.buttons) scrub(event); };
    }
    /** Curves in view: those of one line in all runs, or all lines of one run. */
    curves() {
      if (!many) return this.lines.flatMap((line, k) => this.alone === null || this.alone === k
        ? [{ line, name: line.name || this.title, color: COLORS[k % 8], dashed: k >= 8, own: line.of[0] }] : []);
      const line = this.lines[this.chosen ? Number(this.chosen.value) : 0];
      return line.of.map(own => ({ line, name: data.runs[own.run].name, color: data.runs[own.run].color, dashed: own.run >= 8, own }))
        .filter(({ own }) => !data.runs[own.run].hidden);
    }
    /** Buttons with the values at the cursor; one of them shows its line alone, with the limits. */
    legend() {
      this.key.replaceChildren();
      const shown = many ? this.curves() : this.lines.map((line, k) => ({ line, name: line.name, color: COLORS[k % 8], dashed: k >= 8, own: line.of[0] }));
      this.values = shown.map(({ name, color, dashed, own, line }, k) => {
        const item = add(many || shown.length === 1 ? "span" : "button", "", this.key), swatch = add("i", "", item);
        swatch.style.borderTop = `3px ${dashed ? "dashed" : "solid"} ${color}`;
        if (name) add("span", name, item);
        if (item.tagName === "BUTTON") {
          item.title = "Show this curve alone, with its limits, or all";
          item.setAttribute("aria-pressed", this.alone === null || this.alone === k);
          item.onclick = () => { this.alone = this.alone === k ? null : k; this.legend(); refresh(); };
        }
        return { own, line, output: add("output", "", item) };
      });
    }
    /** Range of the axis, as its ends and its marks. */
    range(curves) {
      let low = Infinity, high = -Infinity;
      const reach = value => { if (Number.isFinite(value)) { low = Math.min(low, value); high = Math.max(high, value); } };
      for (const { own } of curves) for (const values of [own.values, own.reference ?? []])
        for (const value of values) reach(this.log ? Math.max(value, this.least) : value);
      if (low > high) return null;
      if (this.log) {
        const ends = [Math.floor(Math.log10(low)), Math.max(Math.ceil(Math.log10(high)), Math.floor(Math.log10(low)) + 1)], each = Math.ceil((ends[1] - ends[0]) / 3);
        return { ends, marks: Array.from({ length: 1 + Math.floor((ends[1] - ends[0]) / each) }, (_, k) => ends[0] + k * each) };
      }
      // Limits that are near, or of the one curve that is looked at, belong to the picture.
      const span = high - low;
      for (const { line } of curves) for (const limit of line.limits)
        if (limit !== null && (this.alone !== null || limit > low - .15 * span && limit < high + .15 * span)) reach(limit);
      const middle = .5 * (low + high), half = Math.max(.55 * (high - low), .5 * this.least);
      return { ends: [middle - half, middle + half], marks: marks(middle - half, middle + half, 4) };
    }
    draw() {
      const wide = this.box.clientWidth, dots = devicePixelRatio || 1;
      if (!wide) return;
      const curves = this.curves(), range = this.range(curves), [first, last] = ends(), context = this.canvas.getContext("2d");
      Object.assign(this.canvas, { width: wide * dots, height: tall * dots });
      context.scale(dots, dots);
      context.font = "11px system-ui, sans-serif";
      context.fillStyle = SOFT;
      if (!range) { context.fillText("nothing is known of it in this run", left, tall / 2); return; }
      const [low, high] = range.ends, x = t => left + (wide - left - right) * (t - first) / (last - first || 1);
      const y = value => top + (tall - top - bottom) * (high - (this.log ? Math.log10(Math.max(value, this.least)) : value)) / (high - low);
      const stroke = (color, width, dashes = []) => { Object.assign(context, { strokeStyle: color, lineWidth: width }); context.setLineDash(dashes); context.stroke(); };
      context.textAlign = "right";
      for (const mark of range.marks) {
        const at = y(this.log ? 10 ** mark : mark);
        context.beginPath();
        context.moveTo(left, at);
        context.lineTo(wide - right, at);
        stroke("#e3e8ee", 1);
        context.fillText(this.log ? `1e${mark}` : short(mark), left - 5, at + 4);
      }
      context.textAlign = "center";
      for (const mark of marks(first, last, Math.max(2, wide / 90))) {
        context.beginPath();
        context.moveTo(x(mark), top);
        context.lineTo(x(mark), tall - bottom);
        stroke("#eef1f5", 1);
        context.fillText(`${short(mark)}${mark ? "" : " s"}`, Math.min(x(mark), wide - 12), tall - 4);
      }
      context.save();
      context.beginPath();
      context.rect(left, top - 2, wide - left - right, tall - top - bottom + 4);
      context.clip();
      const trace = (times, values) => {
        context.beginPath();
        let apart = true;
        for (let i = 0; i < values.length; i++) {
          if (!Number.isFinite(values[i])) { apart = true; continue; }
          if (apart) context.moveTo(x(times[i]), y(values[i])); else context.lineTo(x(times[i]), y(values[i]));
          apart = false;
        }
      };
      for (const { own } of curves) if (own.reference) { trace(data.runs[own.run].times, own.reference); stroke("#b5b5b5", 4); }
      // The first one lies on top.
      for (const { own, color, dashed, line } of curves.slice().reverse()) {
        if (!this.log) for (const limit of line.limits) if (limit !== null) {
          context.beginPath();
          context.moveTo(left, y(limit));
          context.lineTo(wide - right, y(limit));
          stroke(curves.length > 1 && many ? INK : color, 1, [5, 4]);
        }
        trace(data.runs[own.run].times, own.values);
        stroke(color, 1.6, dashed ? [6, 3] : []);
      }
      context.restore();
      Object.assign(this, { x });
    }
    at(time) {
      this.cursor.style.transform = `translateX(${this.x ? this.x(time) : left}px)`;
      for (const { own, output } of this.values) {
        const value = valueAt(data.runs[own.run].times, own.values, time);
        output.textContent = Number.isFinite(value) ? short(!this.log && Math.abs(value) < 1e-3 * this.least ? 0 : value) : "–";
      }
    }
  }

  /** Round numbers between two ends, about so many. */
  function marks(low, high, about) {
    const rough = (high - low) / about, decade = 10 ** Math.floor(Math.log10(rough)), step = decade * [1, 2, 5, 10].find(k => k * decade >= rough * .99);
    const found = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(Number((k * step).toPrecision(12)));
    return found;
  }
  const short = value => value !== 0 && (Math.abs(value) < 1e-3 || Math.abs(value) >= 1e5) ? value.toExponential(1) : String(Number(value.toPrecision(3)));
  function valueAt(times, values, time) {
    let low = 0, high = times.length - 1;
    while (low < high) { const middle = (low + high + 1) >> 1; if (times[middle] <= time) low = middle; else high = middle - 1; }
    const next = Math.min(low + 1, times.length - 1), gap = times[next] - times[low], s = gap > 0 ? Math.min(Math.max((time - times[low]) / gap, 0), 1) : 0;
    return s ? values[low] + s * (values[next] - values[low]) : values[low];
  }

  // -- what a run that goes on adds --------------------------------------------------------------------------------------
  const panels = data.panels.map(panel => new Panel(panel));
  let now = ends()[0], waiting = false;
  function refresh() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      for (const panel of panels) { panel.draw(); panel.at(now); }
    });
  }
  const all = () => data.panels.flatMap(panel => panel.lines);
  /** Room for what comes: numbers of a packed page stand in arrays that cannot grow. */
  function grow() {
    for (const run of data.runs) run.times = Array.from(run.times);
    for (const line of all()) for (const own of line.of) own.values = Array.from(own.values);
  }
  grow();
  new ResizeObserver(refresh).observe(side);
  refresh();
  return {
    count: all().length,
    refresh,
    show: (run, value) => { data.runs[run].hidden = !value; panels.forEach(panel => panel.legend()); refresh(); },
    at: time => { now = time; for (const panel of panels) panel.at(time); },
    clear: () => { data.runs[0].times.length = 0; for (const line of all()) line.of[0].values.length = 0; },
    push: (time, values) => {
      data.runs[0].times.push(time);
      all().forEach((line, k) => line.of[0].values.push(values[k]));
      refresh();
    },
  };
}
