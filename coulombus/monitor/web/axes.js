"use strict";
// What all plots are made of: ticks, ranges, lines, names.

const LEFT = 50, RIGHT = 12, TITLE = 26, LEGEND = 18, BOTTOM = 18, LABEL = 15;
// Less than this is noise, and does not fill a plot.
const LEAST_SPAN = {Nm: 1, rad: 0.1, "rad/s": 1};
const SHRINK_MS = 1500;

let colours = {};

function readColours() {
  const style = getComputedStyle(document.documentElement), colour = (name) => style.getPropertyValue(`--${name}`).trim();
  colours = {text: colour("text"), dim: colour("dim"), bad: colour("bad"), line: colour("line"), law: colour("law"),
    series: [0, 1, 2, 3].map((i) => colour(`series-${i}`)), focus: colour("focus")};
}

function ticks(low, high, count) {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= raw * 0.999);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + step * 1e-9; k++) found.push(k * step);
  return {step, found, digits: Math.min(6, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)))};
}

// So many ticks, and two at least: one is no scale.
function enough(low, high, count) {
  let made = ticks(low, high, count);
  while (made.found.length < 2 && count < 20) made = ticks(low, high, ++count);
  return made;
}

// A range that holds what is to be seen, with ends at ticks; it grows at once and shrinks after a while.
class Range {
  constructor(least, symmetric = false) {
    Object.assign(this, {least, symmetric, low: 0, high: 0, since: 0});
  }

  hold(low, high) {
    if (!(high >= low)) [low, high] = [0, 0];
    if (this.symmetric) [low, high] = [-Math.max(-low, high), Math.max(-low, high)];
    const span = Math.max(high - low, this.least, 0.02 * Math.max(Math.abs(low), Math.abs(high)));
    const middle = (low + high) / 2, wanted = [Math.min(low, middle - span / 2), Math.max(high, middle + span / 2)];
    const fits = low >= this.low && high <= this.high && this.high > this.low;
    const roomy = wanted[1] - wanted[0] < 0.4 * (this.high - this.low);
    if (!roomy) this.since = performance.now();
    if (fits && performance.now() - this.since < SHRINK_MS) return;
    const pad = 0.06 * (wanted[1] - wanted[0]), {step} = ticks(wanted[0] - pad, wanted[1] + pad, 8);
    this.low = Math.floor((wanted[0] - pad) / step) * step;
    this.high = Math.ceil((wanted[1] + pad) / step) * step;
    this.since = performance.now();
  }
}

const about = ([low, high], at, factor) => [at - (at - low) * factor, at + (high - at) * factor];

function polyline(ctx, a, [x, y], colour, steps, width = 1.3) {
  ctx.strokeStyle = colour;
  ctx.lineWidth = width;
  ctx.lineJoin = "round";
  ctx.beginPath();
  let going = false, before = 0;
  for (let i = 0; i < x.length; i++) {
    if (!(y[i] === y[i])) { going = false; continue; }
    const px = a.px(x[i]), py = a.py(y[i]);
    if (going && steps) ctx.lineTo(px, before);
    if (going) ctx.lineTo(px, py);
    else ctx.moveTo(px, py);
    going = true;
    before = py;
  }
  ctx.stroke();
}

// How a signal is called: without its unit, with its node where there are several of its kind.
function shortName(name, unit) {
  const short = name.split(".").pop(), ending = `_${unit.replace("/", "_")}`;
  const bare = (unit && short.endsWith(ending) ? short.slice(0, -ending.length) : short).replaceAll("_", " ");
  return bare.replace("setpoint", "set-point");
}

// Whose it is, and what; a plot's title says the quantity already.
function label(name, unit, title = "") {
  const node = name.split(".").slice(-2, -1)[0] || "", short = shortName(name, unit);
  const whole = short.startsWith("handle") ? short : `${node} ${short}`.trim();
  return title ? whole.replace(` ${title}`, "") : whole;
}

// What is commanded is drawn wide and under what is measured, so that both are seen.
const commanded = (name) => /target|setpoint/.test(name);

// The lines' names; each is a button that hides and shows its line.
function legend(lines, hidden, changed) {
  const made = document.createElement("div");
  made.className = "legend";
  lines.forEach(([text, style, name]) => {
    const line = made.appendChild(document.createElement(name ? "button" : "span"));
    line.className = style;
    line.textContent = `\u25ac ${text}`;
    if (!name) return;
    line.dataset.action = `show:${name}`;
    const show = () => line.setAttribute("aria-pressed", String(!hidden.has(name)));
    line.addEventListener("click", () => {
      if (!hidden.delete(name)) hidden.add(name);
      show();
      changed();
    });
    show();
  });
  return made;
}
