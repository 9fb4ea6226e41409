"use strict";
// The page: STOP, the words and tables, and the plots. It needs nothing from the network but its own server.

const BINS_PER_S = 50, BINS = 500;
const AGAIN_MS = 1000, SAID_MS = 5000;
const one = (name) => document.querySelector(`[data-signal="${name}"]`);
const action = (name) => document.querySelector(`[data-action="${name}"]`);

// STOP: of plots and socket it needs none.

function say(text) {
  const said = one("said");
  said.textContent = text;
  said.hidden = !text;
}

async function stop(event) {
  if (event) event.preventDefault();
  action("stop").classList.add("asked");
  say("STOP: asked ...");
  try {
    const answer = await fetch("stop", {method: "POST", cache: "no-store"});
    say(answer.ok ? `STOP: ${(await answer.json()).text}` : `STOP was refused: ${answer.status}; use the rig's own emergency stop`);
  } catch (error) {
    say("STOP did not reach the server: use the rig's own emergency stop");
  }
  action("stop").classList.remove("asked");
}

action("stop-form").addEventListener("submit", stop);
window.addEventListener("keydown", (event) => {
  if (event.key === "Escape") stop(event);
}, true);
window.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey || event.repeat) return;
  if (event.target.matches && event.target.matches("input:not([type=range])")) return;
  if (/^[1-9]$/.test(event.key)) tell(`mark ${event.key}`);
  if (event.key === "f" || event.key === "F") freeze();
  if (event.key === "z" || event.key === "Z") unzoom();
});

let frozen = false;
function freeze() {
  frozen = !frozen;
  action("freeze").setAttribute("aria-pressed", String(frozen));
  if (!frozen) draw();
}
action("freeze").addEventListener("click", freeze);
action("reset").addEventListener("click", unzoom);
action("control").addEventListener("click", () => tell("control"));
action("undo").addEventListener("click", () => order({undo: true}));

function tell(text) {
  if (socket && socket.readyState === 1) socket.send(text);
}

// The live parameters: a slider and a field for each. The host judges every value.

const WINDOW = 20;  // a range that is so many times the value: the slider shows ten times the value
let held = null;    // the slider that somebody moves

function order(what) {
  const key = action("arm-key").value;
  tell(`set ${JSON.stringify(key ? {...what, key: key} : what)}`);
}

function sliders(all, axis, controls, needsKey) {
  const shown = all.filter((one) => one.axis === axis), place = document.getElementById("sliders");
  document.getElementById("live").hidden = !shown.length;
  action("arm-key").hidden = !needsKey;
  action("undo").disabled = !controls;
  if (place.dataset.names !== shown.map((one) => one.name).join()) {
    place.dataset.names = shown.map((one) => one.name).join();
    place.replaceChildren(...shown.map(slider));
  }
  for (const one of shown) {
    const range = action(`set:${one.name}`), field = action(`value:${one.name}`);
    for (const input of [range, field]) input.disabled = !controls;
    if (held !== range) {
      range.max = one.high > WINDOW * one.value && one.value > 0 ? 10 * one.value : one.high;
      range.value = one.value;
    }
    if (document.activeElement !== field) field.value = one.value;
    put(`set:${one.name}`, Number(one.now.toPrecision(4)));
  }
}

function slider(one) {
  const made = document.createElement("label"), words = made.appendChild(document.createElement("span"));
  words.append(`${one.name} `);
  words.appendChild(document.createElement("b")).dataset.signal = `set:${one.name}`;
  const high = one.high >= 1e5 ? one.high.toExponential() : one.high;
  words.append(` ${one.unit} (${one.low} to ${high})`);
  const [field, range] = ["number", "range"].map((kind) => {
    const input = made.appendChild(document.createElement("input"));
    Object.assign(input, {type: kind, step: "any", min: one.low, max: one.high});
    input.setAttribute("aria-label", one.name);
    input.addEventListener("change", () => {
      held = null;
      const value = kind === "range" ? Number(Number(input.value).toPrecision(4)) : Number(input.value);
      if (input.value !== "") order({values: {[one.name]: value}});
    });
    return input;
  });
  field.dataset.action = `value:${one.name}`;
  range.dataset.action = `set:${one.name}`;
  range.addEventListener("input", () => { held = range; });
  return made;
}

// What is known of the signals.

const envelopes = new Map();  // name -> {low, high, newest}: rings over the bin's number
const raw = new Map();
let friction = null, law = null, nowBin = 0;

function takeEnvelope(name, first, low, high) {
  let ring = envelopes.get(name);
  if (!ring || first > ring.newest + 1) {
    ring = {low: new Float64Array(BINS).fill(NaN), high: new Float64Array(BINS).fill(NaN), newest: first - 1};
    envelopes.set(name, ring);
  }
  for (let i = 0; i < low.length; i++) {
    ring.low[(first + i) % BINS] = low[i];
    ring.high[(first + i) % BINS] = high[i];
  }
  ring.newest = Math.max(ring.newest, first + low.length - 1);
}

function take(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const numbers = new Float32Array(buffer, 4 + length);
  let start = 0;
  for (const part of head.parts) {
    const a = numbers.subarray(start, start + part.n), b = numbers.subarray(start + part.n, start + 2 * part.n);
    start += 2 * part.n;
    if (part.k === "envelope") takeEnvelope(part.s, part.first, a, b);
    else if (part.k === "raw") raw.set(part.s, [a, b]);
    else friction = [a, b];
  }
  nowBin = head.now_bin;
  if (head.state) {
    law = head.law;
    words(head);
  }
  return head.n;
}

// The plots, drawn by Bokeh.

let sources = new Map(), figures = [];
let plotted = 0;

async function makePlots() {
  const mine = ++plotted;
  const theme = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
  const query = new URLSearchParams(location.search);
  query.set("theme", theme);
  const answer = await fetch(`plots?${query}`);
  if (!answer.ok) return;
  const {plots: items, legends} = await answer.json();
  const found = new Map(), roots = [];
  Bokeh.documents.splice(0);
  for (const [id, item] of Object.entries(items)) {
    const place = document.getElementById(id);
    place.replaceChildren(legend(legends[id] || []));
    await Bokeh.embed.embed_item(item);
    if (mine !== plotted) return;
    for (const root of Bokeh.documents.at(-1).roots()) {
      roots.push(root);
      for (const renderer of root.renderers) {
        const source = renderer.data_source;
        if (source && source.name) found.set(source.name, source);
      }
    }
  }
  sources = found;
  figures = roots;
  draw();
}

function legend(lines) {
  const made = document.createElement("div");
  made.className = "legend";
  for (const [name, colour] of lines) {
    const line = made.appendChild(document.createElement("span"));
    line.style.color = colour;
    line.textContent = `\u25ac ${name}`;
  }
  return made;
}

function unzoom() {
  for (const figure of figures) {
    if (figure.reset) figure.reset.emit();
  }
  wide = 0;
}

let wide = 0, high = 0, narrowed = 0;
function frameFriction(v, f) {
  let v_ = 0.2, f_ = 0.5;
  for (let i = 0; i < v.length; i++) {
    if (isFinite(v[i]) && isFinite(f[i])) {
      v_ = Math.max(v_, Math.abs(v[i]));
      f_ = Math.max(f_, Math.abs(f[i]));
    }
  }
  for (const value of law ? law.f : []) f_ = Math.max(f_, Math.abs(value));
  v_ *= 1.15;
  f_ *= 1.2;
  const now = performance.now();
  const shrink = (v_ < wide / 2 || f_ < high / 2) && now - narrowed > 2000;
  if (wide && v_ <= wide && f_ <= high && !shrink) return;
  wide = shrink ? v_ : Math.max(v_, wide);
  high = shrink ? f_ : Math.max(f_, high);
  narrowed = now;
  for (const figure of figures) {
    if (figure.renderers.some((one) => one.data_source && one.data_source.name === "friction")) {
      figure.x_range.setv({start: -wide, end: wide});
      figure.y_range.setv({start: -high, end: high});
    }
  }
}

function draw() {
  if (!sources.size) return;
  for (const [name, ring] of envelopes) {
    const source = sources.get(`envelope:${name}`);
    if (!source) continue;
    const t = new Float64Array(2 * BINS), y = new Float64Array(2 * BINS);
    for (let i = 0; i < BINS; i++) {
      const bin = ring.newest - BINS + 1 + i, place = bin % BINS;
      t[2 * i] = t[2 * i + 1] = (bin + 0.5 - nowBin) / BINS_PER_S;
      y[2 * i] = bin >= 0 ? ring.low[place] : NaN;
      y[2 * i + 1] = bin >= 0 ? ring.high[place] : NaN;
    }
    source.data = {t: t, y: y};
  }
  for (const [name, [t, y]] of raw) {
    const source = sources.get(`raw:${name}`);
    if (source) source.data = {t: Float64Array.from(t), y: Float64Array.from(y)};
  }
  if (friction && sources.has("friction")) {
    const [v, f] = friction;
    const alpha = new Float64Array(v.length);
    for (let i = 0; i < v.length; i++) alpha[i] = 0.05 + 0.95 * ((i + 1) / v.length) ** 2;
    sources.get("friction").data = {v: Float64Array.from(v), f: Float64Array.from(f), alpha: alpha};
    sources.get("law").data = law ? {v: law.v, f: law.f} : {v: [], f: []};
    frameFriction(v, f);
  }
}

// Words and tables.

const put = (name, text) => {
  const element = one(name);
  const shown = text === "" || text === null || text === undefined ? "-" : String(text);
  if (element.textContent !== shown) element.textContent = shown;
  return element;
};

function words(head) {
  const state = head.state, host = state.host;
  const arm = put("arm", state.arm);
  arm.className = `badge ${state.arm}`;
  put("mode", host.runs ? host.mode : "no host");
  put("phase", host.phase).title = host.phase;
  put("display_s", host.display_s === null ? "" : `${host.display_s.toFixed(1)} s`);
  put("recording", host.recording ? host.recording.split("/").pop() : "").title = host.recording;
  one("recording-lamp").classList.toggle("on", Boolean(host.recording));
  put("load_percent", `${state.load_percent.toFixed(0)} %`);
  one("load-meter").value = state.load_percent;
  put("lost", state.lost);
  put("role", head.controls ? "control" : "look on");
  action("control").hidden = head.controls;
  sliders(host.parameters, head.axis, head.controls, host.arm_key);
  for (const name of ["wakeup_us", "sync_to_rpdo_us"]) {
    put(name, host[name] && `${host[name].map((us) => us.toFixed(0)).join(" / ")} us`);
  }
  if (head.answer) {
    say(head.answer);
    if (/^(set|mark) /.test(head.answer)) setTimeout(() => one("said").textContent === head.answer && say(""), SAID_MS);
  }
  if (head.refused) say("another page controls; close it first");
  const trip = one("trip");
  const text = host.trip ? `Trip: ${host.trip}${host.advice ? `. Likely causes, and what to do: ${host.advice}` : ""}` : "";
  if (trip.textContent !== text) trip.textContent = text;
  trip.hidden = !text;
  rows("pdos", state.pdos.flatMap(pdoRows));
  rows("nodes", state.nodes.map((node) => [node.emergency || node.silent ? "grave" : "", [
    [node.name, "", `node:${node.name}`], [node.id, "n"],
    [node.silent ? `${node.state}, silent` : node.state || "not heard", "", `state:${node.name}`],
    [node.emergency || node.power, "", `power:${node.name}`]]]));
  rows("events", state.events.slice().reverse().map(([t, said, grave]) =>
    [grave ? "grave" : "", [[new Date(1000 * t).toLocaleTimeString([], {hour12: false}), ""], [said, ""]]]));
}

function short(signal) {
  const name = signal.name.split(".").pop(), ending = `_${signal.unit.replace("/", "_")}`;
  return (signal.unit && name.endsWith(ending) ? name.slice(0, -ending.length) : name).replaceAll("_", " ");
}

function pdoRows(pdo) {
  return pdo.signals.map((signal, i) => {
    const first = i === 0, value = signal.value;
    const shown = value === null ? "-" : typeof value === "number" && !Number.isInteger(value) ? value.toFixed(5) : String(value);
    return [pdo.stale ? "stale" : "", [
      [first ? pdo.name : "", ""], [first ? pdo.id : "", ""], [first ? pdo.raw : "", "raw"],
      [short(signal), ""],
      [shown, "n", signal.name], [signal.unit, ""],
      [first ? pdo.rate.toFixed(0) : "", "n", first ? `rate:${pdo.name}` : ""],
      [first && pdo.jitter_ms !== null ? pdo.jitter_ms.toFixed(2) : "", "n", first ? `jitter:${pdo.name}` : ""]]];
  });
}

function rows(id, wanted) {
  const body = document.getElementById(id);
  while (body.rows.length > wanted.length) body.deleteRow(-1);
  wanted.forEach(([style, cells], r) => {
    const row = body.rows[r] || body.insertRow();
    if (row.className !== style) row.className = style;
    cells.forEach(([text, kind, signal], c) => {
      const cell = row.cells[c] || row.insertCell();
      if (cell.textContent !== String(text)) cell.textContent = text;
      if (cell.className !== kind) cell.className = kind;
      if (signal && cell.dataset.signal !== signal) cell.dataset.signal = signal;
    });
  });
}

// The socket: it is opened again until the server is there.

let socket = null, wanted = 0, cut = false;

function connect() {
  const address = new URL("data", location.href);
  address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
  address.search = location.search;
  const mine = new WebSocket(address);
  mine.binaryType = "arraybuffer";
  mine.onmessage = (event) => {
    if (cut) {
      cut = false;
      document.body.classList.remove("cut");
      say("");
      if (!sources.size) makePlots();
    }
    wanted = take(event.data);
    requestFrame();
  };
  mine.onclose = () => {
    document.body.classList.add("cut");
    if (!cut) say("The server is gone, or refuses: what stands here is old. STOP from here cannot work: use `coulombus stop`, or the rig's own emergency stop.");
    cut = true;
    setTimeout(connect, AGAIN_MS);
  };
  socket = mine;
}

let asked = false, frames = 0;
function requestFrame() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => {
    asked = false;
    if (!frozen) draw();
    frames += 1;
    document.body.dataset.frames = frames;
    if (socket.readyState === 1) socket.send(`took ${wanted}`);
  });
}

window.addEventListener("DOMContentLoaded", () => {
  makePlots();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", makePlots);
  connect();
});
