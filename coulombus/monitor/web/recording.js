"use strict";
// A recording: its plots over all of its time, a cursor, a zoom, a choice of signals.

const WAIT_MS = 80, PLOTS = 8;
const lines = new Map();  // signal -> {t, y, from, to}: what the server gave for a stretch of time
let about_ = null, cursor = null, wanted = "", values = {};

const known = {
  lines: (name) => {
    const line = lines.get(name);
    return line ? [line.t, line.y] : [[], []];
  },
  marks: drawMarks,
  pick: (t) => setCursor(t),
};
const frozen = known;  // it stands still: zooming goes about the middle
const seconds = (t) => `${t.toFixed(3)} s`;

function chosen() {
  return plots.flatMap((plot) => plot.row.signals);
}

// Ask the server for what is to be seen, once the zoom has come to rest.
let timer = null;
function fetchSoon() {
  const [from, to] = times.recording.zoom || times.recording.all, now = `${from} ${to} ${chosen().join()}`;
  put("shown", `${seconds(from)} to ${seconds(to)}`);
  if (now === wanted) return;
  wanted = now;
  clearTimeout(timer);
  timer = setTimeout(() => chosen().forEach((name) => load(name, from, to)), WAIT_MS);
}

async function load(name, from, to) {
  const answer = await fetch(`samples?s=${encodeURIComponent(name)}&a=${from}&b=${to}`);
  if (!answer.ok) return;
  const {t, y} = await answer.json();
  lines.set(name, {t, y: y.map((value) => value === null ? NaN : value)});
  redraw();
}

function redraw() {
  fetchSoon();
  document.body.dataset.lines = lines.size;
  for (const plot of plots) plot.draw(known);
}
// `plots.js` calls this after each zoom.
draw = redraw;

function drawMarks(ctx, a) {
  ctx.setLineDash([2, 3]);
  ctx.strokeStyle = colours.law;
  ctx.lineWidth = 1;
  ctx.beginPath();
  for (const [t] of about_.markers) {
    if (t < a.x[0] || t > a.x[1]) continue;
    ctx.moveTo(a.px(t), a.top);
    ctx.lineTo(a.px(t), a.bottom);
  }
  ctx.stroke();
  ctx.setLineDash([]);
  if (cursor === null || cursor < a.x[0] || cursor > a.x[1]) return;
  ctx.strokeStyle = colours.text;
  ctx.lineWidth = 1;
  ctx.beginPath();
  ctx.moveTo(a.px(cursor), a.top);
  ctx.lineTo(a.px(cursor), a.bottom);
  ctx.stroke();
}

async function setCursor(t) {
  cursor = Math.min(Math.max(t, about_.begin), about_.end);
  put("cursor", seconds(cursor));
  redraw();
  const answer = await fetch(`at?t=${cursor}`);
  if (answer.ok) showValues((await answer.json()).values);
}

function showValues(all) {
  values = all;
  for (const output of document.querySelectorAll("#signals output")) {
    const value = all[output.dataset.name], unit = output.dataset.unit;
    const word = !unit && /word$/.test(output.dataset.name) && Number.isInteger(value);
    const text = word ? `${value.toString(16).toUpperCase().padStart(4, "0")}h` : `${Number((value ?? NaN).toPrecision(5))} ${unit}`;
    output.textContent = value === null || value === undefined ? "-" : text;
  }
}

// Plots of the chosen signals: those of the live page, then one for each other unit.
function makeRows(names) {
  const rows = about_.plots.map((row) => ({...row, signals: row.signals.filter((name) => names.has(name))})).filter((row) => row.signals.length);
  const inRows = new Set(about_.plots.flatMap((row) => row.signals));
  const units = new Map();
  for (const {name, unit} of about_.signals) {
    if (!names.has(name) || inRows.has(name)) continue;
    const key = unit || name;
    if (!units.has(key)) units.set(key, {title: label(name, unit), unit, signals: []});
    const row = units.get(key);
    row.signals.push(name);
    if (row.signals.length > 1) row.title = "";  // their names stand in the legend
  }
  return [...rows, ...units.values()].slice(0, PLOTS);
}

function makePlots(names) {
  const place = document.getElementById("plots"), rows = makeRows(names);
  plots = [];
  place.replaceChildren();
  plots = rows.map((row, i) => {
    const element = place.appendChild(document.createElement("div"));
    element.className = "plot";
    const shown = row.signals.map((name, k) => [label(name, row.unit, row.title), `series-${k % 4}`, name]);
    const title = `${row.title}${row.unit ? ` [${row.unit}]` : ""}`.trim();
    return new Plot(element, "recording", {...row, title, across: "time [s]", last: i === rows.length - 1, legend: shown, high: shown.length > 1});
  });
  redraw();
}

function signalItem({name, unit, samples}, names) {
  const item = document.createElement("li"), made = item.appendChild(document.createElement("label"));
  const box = made.appendChild(document.createElement("input"));
  Object.assign(box, {type: "checkbox", checked: names.has(name), disabled: !samples});
  box.dataset.action = `choose:${name}`;
  made.appendChild(document.createElement("span")).textContent = name;
  made.className = samples ? "" : "none";
  const output = made.appendChild(document.createElement("output"));
  Object.assign(output.dataset, {name, unit});
  output.textContent = samples ? "-" : "never came";
  box.addEventListener("change", () => {
    if (box.checked) names.add(name);
    else names.delete(name);
    makePlots(names);
  });
  return item;
}

function markerItem([t, text]) {
  const item = document.createElement("li"), made = item.appendChild(document.createElement("button"));
  made.appendChild(document.createElement("time")).textContent = seconds(t);
  made.append(text);
  made.addEventListener("click", () => setCursor(t));
  return item;
}

async function begin() {
  const answer = await fetch("recording");
  if (!answer.ok) return;
  about_ = await answer.json();
  readColours();
  clock = seconds;
  untilEnd = "the end";
  times.recording = {all: [about_.begin, about_.end], zoom: null};
  delete times.envelope;
  delete times.raw;
  put("rig", about_.rig);
  put("length", seconds(about_.end - about_.begin));
  const names = new Set(about_.plots.flatMap((row) => row.signals));
  document.getElementById("signals").replaceChildren(...about_.signals.map((signal) => signalItem(signal, names)));
  document.getElementById("marker-list").replaceChildren(...about_.markers.map(markerItem));
  incidents(about_.incidents);
  makePlots(names);
  setCursor(about_.incidents.length ? about_.incidents[0].t : about_.begin);
}

const moves = {ArrowLeft: -1, ArrowRight: 1};
for (const [name, react] of Object.entries({reset: unzoom, "zoom-in": () => zoomTime(0.5), "zoom-out": () => zoomTime(2)})) action(name).addEventListener("click", react);
window.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey || !about_) return;
  if (event.key in moves && event.shiftKey) panTime(0.25 * moves[event.key]);
  else if (event.key in moves) setCursor(cursor + moves[event.key] * (times.recording.zoom ? (times.recording.zoom[1] - times.recording.zoom[0]) : about_.end - about_.begin) / 200);
  else if (event.key === "+" || event.key === "=") zoomTime(0.5);
  else if (event.key === "-") zoomTime(2);
  else if (event.key.toLowerCase() === "z") unzoom();
});

begin();
