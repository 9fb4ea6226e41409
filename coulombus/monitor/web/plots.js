"use strict";
// The plots: a canvas each. Lines over time share their time axis, so that a zoom is of all of them.

const SPAN_S = 10, RAW_S = 0.2, BEFORE_S = 0.5, AFTER_S = 0.2, ZOOM = 1.25, LEAST = 1e-4;
const hidden = new Set();  // signals that are not drawn

let plots = [], faultEffects = {};

// The time axis of a group of plots, and how it is zoomed; null: all of it.
const times = {envelope: {all: [-SPAN_S, 0], zoom: null}, raw: {all: [-RAW_S, 0], zoom: null}};

class Plot {
  constructor(place, kind, row) {
    Object.assign(this, {place, kind, row, zoomY: null, drag: null, at: null});
    this.time = times[kind] || {all: null, zoom: null};
    this.rangeX = new Range(LEAST_SPAN["rad/s"], true);
    this.rangeY = new Range(LEAST_SPAN[row.unit] || 1e-3, kind === "friction");
    this.last = row.last;
    this.canvas = document.createElement("canvas");
    const title = document.createElement("span");
    title.className = "title";
    title.textContent = row.title;
    const named = kind === "friction" || row.legend.length > 1;  // the title is the name of a single line
    this.top = TITLE + (row.high || named ? LEGEND : 0);
    place.replaceChildren(this.canvas, title, ...(named ? [legend(row.legend, hidden, () => draw())] : []));
    place.setAttribute("role", "img");
    place.setAttribute("aria-label", `${row.title}: ${row.legend.map(([name]) => name).join(", ")}`);
    this.listen();
  }

  // Where it is drawn: pixels of the area, and the ranges.
  area() {
    const width = this.place.clientWidth, height = this.place.clientHeight, scale = window.devicePixelRatio || 1;
    const wide = Math.max(1, Math.round(width * scale)), high = Math.max(1, Math.round(height * scale));
    if (this.canvas.width !== wide || this.canvas.height !== high) Object.assign(this.canvas, {width: wide, height: high});
    const bottom = height - BOTTOM - (this.last ? LABEL : 0);
    const x = this.time.zoom || this.time.all || [this.rangeX.low, this.rangeX.high];
    const y = this.zoomY || [this.rangeY.low, this.rangeY.high];
    return {scale, width, height, left: LEFT, right: width - RIGHT, top: this.top, bottom, x, y};
  }

  lines(data) {
    return this.row.signals.map((name) => hidden.has(name) ? [[], []] : data.lines ? data.lines(name) : this.kind === "envelope" ? envelopeLine(data, name) : data.raw.get(name) || [[], []]);
  }

  draw(data) {
    if (!this.place.clientWidth) return;
    const points = this.kind === "friction" ? null : this.lines(data);
    if (points) this.fit(points);
    else this.fitFriction(data);
    const {ctx, a} = this.within(1, (ctx, a) => points ? this.curves(ctx, a, points) : this.phase(ctx, a, data));
    if (data.marks) data.marks(ctx, a, this);
    this.pointer(ctx, a);
  }

  // Draw the grid, and what `paint` draws within it: no further than `margin` pixels above and below.
  within(margin, paint) {
    const a = this.area(), ctx = this.canvas.getContext("2d");
    const sx = (a.right - a.left) / (a.x[1] - a.x[0]), sy = (a.bottom - a.top) / (a.y[1] - a.y[0]);
    Object.assign(a, {px: (x) => a.left + (x - a.x[0]) * sx, py: (y) => a.bottom - (y - a.y[0]) * sy, sx, sy});
    this.drawn = a;
    ctx.setTransform(a.scale, 0, 0, a.scale, 0, 0);
    ctx.clearRect(0, 0, a.width, a.height);
    this.grid(ctx, a);
    ctx.save();
    ctx.beginPath();
    ctx.rect(a.left, a.top - margin, a.right - a.left, a.bottom - a.top + 2 * margin);
    ctx.clip();
    paint(ctx, a);
    ctx.restore();
    return {ctx, a};
  }

  curves(ctx, a, points) {
    const order = this.row.signals.map((name, i) => [commanded(name) ? 0 : 1, -i, i]).sort((p, q) => p[0] - q[0] || p[1] - q[1]);
    for (const [measured, , i] of order) {
      ctx.globalAlpha = measured ? 1 : 0.6;
      polyline(ctx, a, points[i], colours.series[i % 4], this.kind === "raw", measured ? 1.3 : 3.2);
    }
    ctx.globalAlpha = 1;
  }

  fit(points) {
    const [first, last] = this.time.zoom || this.time.all;
    let low = Infinity, high = -Infinity;
    for (const [x, y] of points) {
      for (let i = 0; i < x.length; i++) {
        if (x[i] < first || x[i] > last || !(y[i] === y[i])) continue;
        if (y[i] < low) low = y[i];
        if (y[i] > high) high = y[i];
      }
    }
    this.rangeY.hold(low, high);
  }

  fitFriction(data) {
    let v = 0, f = 0;
    const [vs, fs] = data.friction || [[], []];
    for (let i = 0; i < vs.length; i++) {
      if (!isFinite(vs[i]) || !isFinite(fs[i])) continue;
      v = Math.max(v, Math.abs(vs[i]));
      f = Math.max(f, Math.abs(fs[i]));
    }
    for (const value of data.law ? data.law.f : []) f = Math.max(f, Math.abs(value));
    this.rangeX.hold(-v, v);
    this.rangeY.hold(-f, f);
  }

  grid(ctx, a) {
    const across = enough(a.x[0], a.x[1], Math.max(2, (a.right - a.left) / 90)), up = enough(a.y[0], a.y[1], Math.min(7, Math.max(2, (a.bottom - a.top) / 22)));
    ctx.font = "11px system-ui, 'DejaVu Sans', sans-serif";
    ctx.strokeStyle = colours.line;
    ctx.fillStyle = colours.text;
    ctx.lineWidth = 1;
    ctx.beginPath();
    for (const x of across.found) {
      ctx.moveTo(Math.round(a.px(x)) + 0.5, a.top);
      ctx.lineTo(Math.round(a.px(x)) + 0.5, a.bottom);
    }
    for (const y of up.found) {
      ctx.moveTo(a.left, Math.round(a.py(y)) + 0.5);
      ctx.lineTo(a.right, Math.round(a.py(y)) + 0.5);
    }
    ctx.rect(a.left + 0.5, a.top + 0.5, a.right - a.left, a.bottom - a.top);
    ctx.stroke();
    const number = (value, digits) => Math.abs(value) < 1e-12 ? "0" : value.toFixed(digits).replace("-", "\u2212");
    ctx.textAlign = "center";
    ctx.textBaseline = "top";
    for (const x of across.found) ctx.fillText(number(x, across.digits), Math.min(a.px(x), a.width - 12), a.bottom + 4);
    ctx.textAlign = "right";
    ctx.textBaseline = "middle";
    for (const y of up.found) ctx.fillText(number(y, up.digits), a.left - 4, Math.min(a.py(y), a.bottom - 4));
    ctx.textAlign = "center";
    ctx.textBaseline = "bottom";
    if (this.last) ctx.fillText(this.row.across, (a.left + a.right) / 2, a.height);
  }

  phase(ctx, a, data) {
    const [v, f] = data.friction || [[], []], n = v.length;
    ctx.fillStyle = colours.series[0];
    for (let i = 0; i < n; i++) {
      ctx.globalAlpha = 0.05 + 0.95 * ((i + 1) / n) ** 2;
      ctx.fillRect(a.px(v[i]) - 2, a.py(f[i]) - 2, 4, 4);
    }
    ctx.globalAlpha = 1;
    this.place.querySelector(".series-law").hidden = !data.law;
    if (!data.law) return;
    ctx.setLineDash([6, 4]);
    polyline(ctx, a, [data.law.v, data.law.f], colours.law, false, 2);
    ctx.setLineDash([]);
  }

  pointer(ctx, a) {
    if (this.drag) {
      const [x, y] = [Math.min(this.drag.x, this.at.x), Math.min(this.drag.y, this.at.y)];
      ctx.strokeStyle = colours.focus;
      ctx.strokeRect(x, y, Math.abs(this.drag.x - this.at.x), Math.abs(this.drag.y - this.at.y));
    } else if (this.at) {
      ctx.strokeStyle = colours.law;
      ctx.beginPath();
      ctx.moveTo(this.at.x, a.top);
      ctx.lineTo(this.at.x, a.bottom);
      ctx.stroke();
      ctx.fillStyle = colours.text;
      ctx.textAlign = this.at.x > (a.left + a.right) / 2 ? "right" : "left";
      ctx.textBaseline = "bottom";
      const side = ctx.textAlign === "right" ? -4 : 4;
      ctx.fillText(`${this.valueX(this.at.x).toPrecision(4)}, ${this.valueY(this.at.y).toPrecision(4)}`, this.at.x + side, a.bottom - 2);
    }
  }

  valueX(px) { return this.drawn.x[0] + (px - this.drawn.left) / this.drawn.sx; }
  valueY(py) { return this.drawn.y[0] + (this.drawn.bottom - py) / this.drawn.sy; }

  // The pointer: the wheel zooms along the x axis, with Shift along the y axis; dragging marks a region.
  listen() {
    new ResizeObserver(requestDraw).observe(this.place);  // a line above the plots comes or goes while they stand still
    const place = (event) => {
      const box = this.canvas.getBoundingClientRect(), a = this.drawn, within = (v, low, high) => Math.min(Math.max(v, low), high);
      return {x: within(event.clientX - box.left, a.left, a.right), y: within(event.clientY - box.top, a.top, a.bottom)};
    };
    const on = (name, react, options) => this.canvas.addEventListener(name, (event) => this.drawn && react(event), options);
    on("wheel", (event) => {
      event.preventDefault();
      const factor = event.deltaY + event.deltaX > 0 ? ZOOM : 1 / ZOOM, at = place(event);
      if (event.shiftKey) this.zoomY = about(this.drawn.y, this.valueY(at.y), factor);
      else this.zoomX(about(this.drawn.x, this.valueX(at.x), factor));
      draw();
    }, {passive: false});
    on("pointerdown", (event) => {
      if (event.button !== 0) return;
      this.canvas.setPointerCapture(event.pointerId);
      this.drag = this.at = place(event);
    });
    on("pointermove", (event) => { this.at = place(event); requestDraw(); });
    on("pointerleave", () => { this.at = this.drag ? this.at : null; requestDraw(); });
    on("pointercancel", () => { this.drag = this.at = null; requestDraw(); });
    on("pointerup", (event) => {
      const from = this.drag, to = place(event);
      this.drag = null;
      if (from && Math.abs(from.x - to.x) <= 3 && known.pick) known.pick(this.valueX(to.x));
      if (from && Math.abs(from.x - to.x) > 8 && Math.abs(from.y - to.y) > 8) {
        const sorted = (one, other) => [Math.min(one, other), Math.max(one, other)];
        this.zoomY = sorted(this.valueY(from.y), this.valueY(to.y));
        this.zoomX(sorted(this.valueX(from.x), this.valueX(to.x)));
      }
      draw();
    });
    on("dblclick", unzoom);
  }

  zoomX([low, high]) {
    if (!(high - low > LEAST)) return;
    const all = this.time.all;
    this.time.zoom = all ? [Math.max(low, all[0]), Math.min(high, all[1])] : [low, high];
    if (all && this.time.zoom[1] - this.time.zoom[0] >= all[1] - all[0]) this.time.zoom = null;
  }
}

function envelopeLine(data, name) {
  const ring = data.envelopes.get(name);
  if (!ring) return [[], []];
  const t = new Float32Array(2 * BINS), y = new Float32Array(2 * BINS);
  for (let i = 0; i < BINS; i++) {
    const bin = ring.newest - BINS + 1 + i, place = bin % BINS;
    t[2 * i] = t[2 * i + 1] = (bin + 0.5 - data.nowBin) / BINS_PER_S;
    y[2 * i] = bin >= 0 ? ring.low[place] : NaN;  // up and down within each bin
    y[2 * i + 1] = bin >= 0 ? ring.high[place] : NaN;
  }
  return [t, y];
}

async function makeLivePlots() {
  const answer = await fetch(`layout${location.search}`);
  if (!answer.ok) return;
  const {rows, arm, effects} = await answer.json(), made = [];
  faultEffects = effects || {};
  readColours();
  rows.forEach((row, i) => {
    const names = row.signals.map((name, k) => [label(name, row.unit, row.title), `series-${k}`, name]), last = i === rows.length - 1;
    for (const [kind, title, across, shown] of [["envelope", `${row.title} [${row.unit}], 10 s`, "time before now [s]", names],
      ["raw", "each sample, 0.2 s", "time before now [s]", []]]) {
      const place = document.getElementById(`${row.title}-${kind}`);
      if (place) made.push(new Plot(place, kind, {...row, name: row.title, title, across, last, legend: shown, high: names.length > 1}));
    }
  });
  if (arm) made.push(...tipPlots());
  else made.push(new Plot(document.getElementById("friction-plot"), "friction", {title: "friction [Nm], 2 s", unit: "Nm",
    across: "velocity [rad/s]", last: true, signals: [], legend: [["measured", "series-0"], ["law", "series-law"]]}));
  plots = made;
  rawTime();
  draw();
}

// The plots of each sample: the last ones, or those around a trip, where these stand still.
function rawTime() {
  const trip = Boolean(frozen && frozen.tripBin);
  Object.assign(times.raw, {all: trip ? [-BEFORE_S, AFTER_S] : [-RAW_S, 0], zoom: null});
  document.body.classList.toggle("trip", trip);
  for (const plot of plots) {
    if (plot.kind !== "raw") continue;
    plot.row.across = trip ? "time since the trip [s]" : "time before now [s]";
    plot.place.querySelector(".title").textContent = trip ? `${plot.row.name} [${plot.row.unit}] at the trip, each sample` : plot.row.title;
  }
}

function unzoom() {
  for (const plot of plots) plot.time.zoom = plot.zoomY = null;
  draw();
}

// By keys and buttons: the time before now, by half or twice as much; while it stands still also to and fro.
function zoomTime(factor) {
  for (const time of Object.values(times)) {
    const [low, high] = time.zoom || time.all, end = frozen ? (low + high) / 2 : high;
    plots.find((plot) => plot.time === time)?.zoomX(about([low, high], end, factor));
  }
  draw();
}

function panTime(share) {
  for (const time of Object.values(times)) {
    if (!time.zoom) continue;
    const [low, high] = time.zoom, by = Math.min(Math.max(share * (high - low), time.all[0] - low), time.all[1] - high);
    time.zoom = [low + by, high + by];
  }
  draw();
}

let draw = () => {
  for (const plot of plots) plot.draw(frozen || known);
};

let drawing = false;
function requestDraw() {
  if (drawing) return;
  drawing = true;
  requestAnimationFrame(() => { drawing = false; draw(); });
}
window.addEventListener("resize", requestDraw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { readColours(); draw(); });
