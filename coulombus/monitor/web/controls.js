"use strict";
// What the page asks for besides STOP: other parameters, markers, control; and the keys.

const WINDOW = 20;  // a range that is so many times the value: the slider shows ten times the value
let held = null;    // the slider that somebody moves

function tell(text) {
  if (socket && socket.readyState === 1) socket.send(text);
}

function order(what) {
  const key = action("arm-key").value;
  tell(`set ${JSON.stringify(key ? {...what, key: key} : what)}`);
}

// The number that a text spells, with a point or with a decimal comma; null of any other text.
// A field of type "number" drops a comma: "0,3" became 3.
function number(text) {
  const spelled = text.trim();
  return /^[+-]?(\d+([.,]\d*)?|[.,]\d+)(e[+-]?\d+)?$/i.test(spelled) ? Number(spelled.replace(",", ".")) : null;
}

// A slider and a field for each live parameter. The host judges every value.
function sliders(all, axis, controls, needsKey) {
  const shown = all.filter((one) => one.axis === axis), place = document.getElementById("sliders");
  document.getElementById("live").classList.toggle("none", !shown.length);
  action("arm-key").hidden = !needsKey;
  action("undo").disabled = !controls || !shown.length;
  for (const button of document.querySelectorAll("[data-action^='mark:']")) button.disabled = !controls;
  const names = shown.map((one) => [one.name, one.low, one.high].join(" ")).join();
  if (place.dataset.names !== names) {
    place.dataset.names = names;
    place.replaceChildren(...shown.map(slider));
  }
  for (const one of shown) {
    const range = action(`set:${one.name}`), field = action(`value:${one.name}`);
    for (const input of [range, field]) input.disabled = !controls;
    if (held !== range) {
      range.max = one.high > WINDOW * one.value && one.value > 0 ? 10 * one.value : one.high;
      range.value = one.value;
      range.setAttribute("aria-valuetext", `${one.value} ${one.unit}`);
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
  const [range, field] = ["range", "text"].map((type) => {
    const input = made.appendChild(document.createElement("input"));
    Object.assign(input, {type});
    input.setAttribute("aria-label", `${one.name} ${type === "range" ? "slider" : ""}`.trim());
    return input;
  });
  const bounds = made.appendChild(document.createElement("span"));
  bounds.className = "bounds";
  bounds.textContent = `${one.above_low ? "above " : ""}${one.low} to ${high} ${one.unit}`;
  Object.assign(range, {step: one.step || "any", min: one.low, max: one.high});
  range.addEventListener("change", () => {
    held = null;
    order({values: {[one.name]: Number(Number(range.value).toPrecision(6))}});
  });
  field.inputMode = "decimal";
  field.addEventListener("input", () => field.setCustomValidity(""));
  field.addEventListener("change", () => {
    const value = number(field.value);
    field.setCustomValidity(value === null ? `${field.value}: expected a number, as 0.3` : "");
    if (value !== null) order({values: {[one.name]: value}});
    else if (field.value.trim()) field.reportValidity();
  });
  field.dataset.action = `value:${one.name}`;
  range.dataset.action = `set:${one.name}`;
  range.addEventListener("input", () => { held = range; });
  return made;
}

for (const [name, react] of Object.entries({freeze, reset: unzoom, "zoom-in": () => zoomTime(0.5), "zoom-out": () => zoomTime(2),
  control: () => tell("control"), undo: () => order({undo: true})})) action(name).addEventListener("click", react);

document.getElementById("marks").replaceChildren(...[1, 2, 3, 4, 5, 6, 7, 8, 9].map((k) => {
  const made = document.createElement("button");
  made.dataset.action = `mark:${k}`;
  made.textContent = k;
  made.setAttribute("aria-label", `Mark ${k}`);
  made.addEventListener("click", () => tell(`mark ${k}`));
  return made;
}));

const KEYS = {b: toggleBus, f: freeze, z: unzoom, "+": () => zoomTime(0.5), "=": () => zoomTime(0.5), "-": () => zoomTime(2),
  ArrowLeft: () => panTime(-0.25), ArrowRight: () => panTime(0.25)};
window.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  const typed = event.target.matches && event.target.matches("input:not([type=range])");
  const moves = event.key.startsWith("Arrow") && event.target !== document.body && !event.target.matches("button");
  if (typed || moves) return;
  if (/^[1-9]$/.test(event.key) && !event.repeat) tell(`mark ${event.key}`);
  const react = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (react && !(event.repeat && (react === freeze || react === toggleBus))) react();
});
