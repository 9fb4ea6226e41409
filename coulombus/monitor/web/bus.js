"use strict";
// The simulated bus with host, nodes and cable: a click breaks one, a click on what is broken repairs it.

const WIRE = "bus", CUT = "cut";
let newestIncident = "";
const faultMenu = document.getElementById("faults"), spots = new Map();  // by button: its name, what acts, what can

function showBus(shown) {
  document.body.classList.toggle("bus", shown);
  action("bus").setAttribute("aria-pressed", String(shown));
  history.replaceState(null, "", shown ? "#bus" : location.pathname + location.search);
  if (!shown) draw();
}

function toggleBus() {
  if (!action("bus").hidden) showBus(!document.body.classList.contains("bus"));
}

// With each state of the server; without simulated nodes there is nothing to show.
function bus(state, controls) {
  const faults = state.faults, button = action("bus");
  if (button.hidden === Boolean(faults) && (faults || !state.final)) {
    button.hidden = !faults;
    showBus(Boolean(faults) && location.hash === "#bus");
  }
  if (!faults || !document.body.classList.contains("bus")) return;
  const all = busNodes(state), usable = controls && !state.final;
  makeStations(all);
  hostBox(state.host);
  all.forEach((node, i) => station(node, document.getElementById("stations").children[i + 1], faults, usable));
  document.getElementById("bus-hint").classList.toggle("viewing", !usable);
  actingList(faults.acting, usable);
}

// The simulated nodes, and others that are on the bus; the host has its own box.
function busNodes(state) {
  const left = state.nodes.filter((row) => row.name !== "host");
  const heard = (test) => left.splice(left.findIndex(test) >>> 0, 1)[0];
  const simulated = state.faults.nodes.map((node) => ({...node,
    heard: heard((row) => row.name === node.name) || heard((row) => row.id === node.node_id)}));
  return [...simulated, ...left.map((row) => ({name: row.name, node_id: row.id, powered: true, faults: [], heard: row}))];
}

function makeStations(all) {
  const place = document.getElementById("stations"), names = all.map((node) => node.name).join("\n");
  if (place.dataset.names === names && place.children.length) return;
  place.dataset.names = names;
  spots.clear();
  const host = document.createElement("li");
  host.innerHTML = '<div class="box host"><b>host</b><span data-signal="bus:host"></span></div>';
  place.replaceChildren(host, ...all.map((node) => {
    const made = document.createElement("li");
    made.innerHTML = '<button class="cable"><i></i><span></span></button><button class="box"><b></b><span class="heard"></span><span class="acts"></span></button>';
    const [cable, box] = made.children;
    cable.dataset.action = `cable:${node.name}`;
    box.dataset.action = `node:${node.name}`;
    box.children[1].dataset.signal = `bus:${node.name}`;
    box.children[2].dataset.signal = `acts:${node.name}`;
    return made;
  }));
}

const setText = (element, text) => { if (element.textContent !== text) element.textContent = text; };

function hostBox(host) {
  const box = one("bus:host").parentElement;
  setText(box.lastChild, host.runs ? `${host.mode}, ${host.phase}` : host.trip ? "tripped" : "no host runs");
  box.classList.toggle("grave", Boolean(host.trip));
}

function station(node, place, faults, usable) {
  const [cable, box] = place.children, row = node.heard;
  const on = (where) => faults.acting.filter((fault) => fault.on === where).map((fault) => fault.fault);
  const acts = on(node.name), wire = on(WIRE), cut = acts.includes(CUT);
  const state = [!node.powered ? "no supply" : "", !row ? "not heard" : row.silent ? `${row.state}, silent` : row.state || "not heard",
    row && row.power, row && row.emergency].filter(Boolean).join("; ");
  setText(box.children[0], `${node.name} ${node.node_id}`);
  setText(box.children[1], state);
  setText(box.children[2], acts.join(", "));
  box.classList.toggle("grave", Boolean(row && (row.silent || row.emergency)));
  spot(box, {label: node.name, acts, can: node.faults.map((fault) => [fault, node.name]), repair: acts.length ? {fault: "", on: node.name} : null}, usable,
    `${node.name}, node ${node.node_id}: ${state}`);
  cable.classList.toggle("cut", cut);
  setText(cable.lastChild, [...(cut ? [CUT] : []), ...wire].join(", "));
  spot(cable, {label: `the cable in front of ${node.name}`, acts: cut ? [CUT, ...wire] : wire,
    can: [...node.faults.filter((fault) => fault === CUT).map((fault) => [fault, node.name]), ...faults.wire.map((fault) => [fault, WIRE])],
    repair: cut ? {fault: CUT, on: node.name} : wire.length ? {fault: "", on: WIRE} : null}, usable, `cable in front of ${node.name}`);
}

function spot(button, what, usable, label) {
  spots.set(button, what);
  button.disabled = !usable || !what.can.length;
  button.classList.toggle("broken", what.acts.length > 0);
  const spoken = `${label}${what.acts.length ? `; ${what.acts.join(", ")} acts` : ""}`;
  if (button.getAttribute("aria-label") !== spoken) button.setAttribute("aria-label", spoken);
  if (what.repair) button.removeAttribute("aria-haspopup");
  else button.setAttribute("aria-haspopup", "dialog");
  button.title = what.repair ? "Repair (with Shift: break it further)" : "Break";
}

const effectOf = (fault) => (faultEffects[fault] || "").replaceAll("`", "");
const repair = (what) => tell(`clear ${JSON.stringify(what)}`);

// Repair what is broken; else, or with Shift, list the faults that it can have.
function strike(event) {
  const button = event.target.closest("button"), what = spots.get(button);
  if (!what) return;
  if (what.repair && !event.shiftKey) repair(what.repair);
  else listFaults(button, what);
}

function listFaults(button, what) {
  setText(document.getElementById("faults-of"), `Break ${what.label}`);
  const choices = what.can.filter(([fault]) => !what.acts.includes(fault));
  faultMenu.querySelector("ul").replaceChildren(...choices.map(([fault, on]) => {
    const item = document.createElement("li"), made = item.appendChild(document.createElement("button"));
    made.dataset.action = `fault:${fault}`;
    made.appendChild(document.createElement("b")).textContent = fault;
    made.append(` ${effectOf(fault)}`);
    made.addEventListener("click", () => {
      faultMenu.hidePopover();
      tell(`inject ${JSON.stringify({fault, on})}`);
    });
    return item;
  }));
  button.focus();
  faultMenu.showPopover();
  const at = button.getBoundingClientRect(), own = faultMenu.getBoundingClientRect();
  faultMenu.style.left = `${Math.max(6, Math.min(at.left, innerWidth - own.width - 6))}px`;
  faultMenu.style.top = `${Math.max(6, Math.min(at.bottom + 4, innerHeight - own.height - 6))}px`;
  const first = faultMenu.querySelector("button");
  if (first) first.focus();
}

// While it is open Escape closes it: see `stop.js`.
faultMenu.addEventListener("beforetoggle", (event) => document.body.classList.toggle("choosing", event.newState === "open"));
faultMenu.addEventListener("keydown", (event) => {
  const step = {ArrowDown: 1, ArrowUp: -1}[event.key];
  if (!step) return;
  event.preventDefault();
  const all = [...faultMenu.querySelectorAll("button")];
  all[(all.indexOf(document.activeElement) + step + all.length) % all.length].focus();
});

function actingList(acting, usable) {
  put("acting", acting.length || "none");
  const list = document.getElementById("acting-list"), keys = acting.map(({fault, on}) => `${fault}:${on}`).join("\n");
  action("repair-all").hidden = !acting.length;
  if (list.dataset.keys !== keys) {
    list.dataset.keys = keys;
    list.replaceChildren(...acting.map(({fault, on}) => {
      const item = document.createElement("li"), made = document.createElement("button");
      made.dataset.action = `repair:${fault}:${on}`;
      made.textContent = "Repair";
      made.setAttribute("aria-label", `Repair ${fault} on ${on}`);
      made.addEventListener("click", () => repair({fault, on}));
      item.append(made, document.createElement("span"));
      return item;
    }));
  }
  acting.forEach((fault, i) => setText(list.children[i].lastChild,
    ` ${fault.fault} on ${fault.on}, since ${Math.max(0, fault.since_s).toFixed(0)} s${fault.for_s && fault.for_s < 1e6 ? ` of ${fault.for_s} s` : ""}: ${effectOf(fault.fault)}`));
  for (const button of [action("repair-all"), ...list.querySelectorAll("button")]) button.disabled = !usable;
}

// Beside the bus the newest incident comes first, and is open when it comes.
function busIncidents(all) {
  if (!document.body.classList.contains("bus")) return incidents(all);
  incidents([...all].sort((a, b) => b.t - a.t));
  const newest = document.getElementById("incident-list").firstChild;
  if (newest && newest.dataset.key !== newestIncident) {
    newestIncident = newest.dataset.key;
    for (const item of newest.parentElement.children) item.firstChild.open = item === newest;
  }
}

document.getElementById("stations").addEventListener("click", strike);
action("repair-all").addEventListener("click", () => repair({fault: "", on: ""}));
action("bus").addEventListener("click", toggleBus);
