"use strict";
// The words, the tables and the histograms of what the server tells five times a second.

const SAID_MS = 5000, MOST_US = 20000, NEAR_S = 5;

function words(head) {
  const state = head.state, host = state.host;
  driveHeard(state.arm, state.drives);
  put("arm", state.arm).className = `badge ${state.arm}${state.arm === "disarmed" && !host.trip && !/fault|silent/.test(state.drives) ? " well" : ""}`;
  put("drives", state.drives).title = state.drives;
  put("mode", host.mode || "no host");
  put("phase", host.phase).title = host.phase;
  put("display_s", host.display_s === null ? "" : `${host.display_s.toFixed(1)} s`);
  put("recording", host.recording ? host.recording.split("/").pop() : "").title = host.recording;
  one("recording-lamp").classList.toggle("on", host.runs && Boolean(host.recording));
  put("subject", host.subject).title = host.subject;
  put("trial", host.trial).title = host.trial;
  put("load_percent", `${state.load_percent.toFixed(0)} %`);
  one("load-meter").value = state.load_percent;
  put("lost", state.lost);
  document.getElementById("lost").hidden = !state.lost;
  for (const name of ["lost_pdos", "missed"]) put(name, host[name]).classList.toggle("bad", host[name] > 0);
  put("role", head.controls ? "in control" : "viewing");
  action("control").hidden = head.controls || Boolean(state.final);
  document.body.classList.toggle("ended", !host.runs);
  sliders(host.parameters, head.axis, head.controls, host.arm_key);
  for (const [name, id] of [["wakeup_us", "wakeup"], ["sync_to_rpdo_us", "sync_to_rpdo"]]) {
    put(name, host[name] && `${host[name].map((us) => us.toFixed(0)).join(" / ")} us`);
    histogram(id, host.histograms[id], host.deadline_us);
  }
  if (head.answer) {
    say(head.answer, /^(set|mark [0-9]$|inject|clear)/.test(head.answer) ? "good" : "bad");
    if (/^(set|mark|inject|clear) /.test(head.answer)) setTimeout(() => one("said").textContent === head.answer && say(""), SAID_MS);
  }
  if (head.refused) say("another page is in control; close it first", "busy");
  endWords(state, host);
  values(state.pdos);
  bus(state, head.controls);
  busIncidents(state.incidents);
  rows("pdos", state.pdos.flatMap(pdoRows));
  rows("nodes", state.nodes.flatMap(nodeRows));
  rows("events", state.events.slice().reverse().map(([t, said, grave]) => [grave ? "grave" : "", [[clockAt(t, host.tripped_s), ""], [said, ""]]]));
}

// How the host ended, or that none runs, with the next command; a trip with what the runbook says of it.
function endWords(state, host) {
  const when = host.tripped_s !== null ? 1000 * host.tripped_s : host.end && host.end.at;
  const at = when ? ` at ${new Date(when).toLocaleTimeString([], {hour12: false})}` : "";
  const told = host.trip ? `Trip${at}: ${host.trip}` : "", trip = document.getElementById("trip");
  put("trip", told).hidden = trip.hidden = !told;
  put("entry", host.entry || "Look at the last second of the recording.");
  const step = /^1\. (.*)$/m.exec(host.entry), cause = told && causeOf(state.incidents, host.tripped_s);
  put("step", step ? `First: ${step[1]}` : "").hidden = !step;
  put("cause", cause ? `On the bus: ${cause.title}. ${cause.cause}` : "").hidden = !cause;
  const end = document.getElementById("end"), lost = Boolean(host.end) && host.end.kind === "lost";
  if (!told && frozen && frozen.tripBin) stand(null);  // a new run
  end.hidden = host.runs || Boolean(told);
  end.className = lost ? "lost" : "";
  put("end", !host.end ? "No host runs on this bus. Start one:" : lost ? `The host is gone: ${host.end.why}.` : `The host ended${at}: ${host.end.why}. Start it again:`);
  put("start", state.start);
  document.getElementById("start").hidden = lost;
}

// The incident that led to a trip: the most important one of those that began before it.
function causeOf(all, tripped) {
  return all.find((incident) => incident.status !== "warning" && (tripped === null || Math.abs(incident.t - tripped) < NEAR_S));
}

// A time beside the trip's as milliseconds from it, else as the clock shows it.
function clockAt(t, tripped) {
  const ms = Math.round(1000 * (t - tripped));
  return tripped === null || Math.abs(ms) > 1000 * NEAR_S ? clock(t) : `${ms < 0 ? "\u2212" : "+"}${Math.abs(ms)} ms`;
}

// The plotted signals as figures, for a screen that is too small to see the plots first.
function values(pdos) {
  const place = document.getElementById("values"), now = new Map(pdos.flatMap((pdo) => pdo.signals.map((signal) => [signal.name, [signal, pdo.stale]])));
  const shown = plots.filter((plot) => plot.kind === "envelope").flatMap((plot) => plot.row.signals.map((name) => [name, plot.row.unit])).filter(([name]) => now.has(name));
  if (place.dataset.names !== shown.join()) {
    place.dataset.names = shown.join();
    place.replaceChildren(...shown.map(([name, unit]) => {
      const made = document.createElement("div");
      made.appendChild(document.createElement("dt")).textContent = label(name, unit);
      made.appendChild(document.createElement("dd"));
      return made;
    }));
  }
  shown.forEach(([name], i) => {
    const [signal, stale] = now.get(name), text = signal.value === null ? "-" : `${Number(signal.value).toFixed(3)} ${signal.unit}`;
    const place_ = place.children[i].lastChild;
    if (place_.textContent !== text) place_.textContent = text;
    place_.className = stale ? "stale" : "";
  });
}

action("copy").addEventListener("click", async () => {
  const text = one("start").textContent;
  try {
    await navigator.clipboard.writeText(text);
    say("copied", "good");
    setTimeout(() => one("said").textContent === "copied" && say(""), SAID_MS);
  } catch (error) {
    getSelection().selectAllChildren(one("start"));
    say("the command is selected: copy it with Ctrl-C", "busy");
  }
});

function pdoRows(pdo) {
  return pdo.signals.flatMap((signal, i) => {
    const first = i === 0, value = signal.value;
    const shown = value === null ? "-" : typeof value === "number" && !Number.isInteger(value) ? value.toFixed(5) : String(value);
    const made = [[pdo.stale ? "stale" : "", [
      [first ? pdo.name : "", ""], [first ? pdo.id : "", ""], [first ? pdo.raw : "", "raw", first ? `raw:${pdo.name}` : ""],
      [shortName(signal.name, signal.unit), ""], [signal.bits, "n", `bits:${signal.name}`],
      [shown, "n", signal.name], [signal.unit, ""],
      [first ? pdo.rate.toFixed(0) : "", "n", first ? `rate:${pdo.name}` : ""],
      [first && pdo.jitter_ms !== null ? pdo.jitter_ms.toFixed(2) : "", "n", first ? `jitter:${pdo.name}` : ""]]]];
    if (signal.meaning) {
      const cells = [["", ""], ["", ""], ["", ""], [signal.meaning, "meaning", `meaning:${signal.name}`]];
      made.push([pdo.stale ? "stale" : "", cells]);
    }
    return made;
  });
}

function nodeRows(node) {
  const style = node.emergency || node.silent ? "grave" : "";
  const made = [[style, [
    [node.name, "", `node:${node.name}`], [node.id, "n"],
    [node.silent ? `${node.state}, silent` : node.state || "not heard", "", `state:${node.name}`]]]];
  const told = [node.power, node.emergency].filter(Boolean).join("; ");
  if (told) made.push([style, [[told, "drive", `power:${node.name}`]]]);
  return made;
}

const SPANS = {meaning: 6, drive: 3};

function rows(id, wanted) {
  const body = document.getElementById(id);
  while (body.rows.length > wanted.length) body.deleteRow(-1);
  wanted.forEach(([style, cells], r) => {
    const row = body.rows[r] || body.insertRow();
    if (row.className !== style) row.className = style;
    while (row.cells.length > cells.length) row.deleteCell(-1);
    cells.forEach(([text, kind, signal], c) => {
      const cell = row.cells[c] || row.insertCell();
      if (cell.textContent !== String(text)) cell.textContent = text;
      if (cell.className !== kind) {
        cell.className = kind;
        cell.colSpan = SPANS[kind] || 1;
      }
      if (signal) {
        if (cell.dataset.signal !== signal) cell.dataset.signal = signal;
      } else if (cell.dataset.signal) delete cell.dataset.signal;
    });
  });
}

// A histogram over the time's logarithm, 1 us to 20 ms; heights are the counts' logarithms.
const DECADES = [[1, "1 us"], [10, "10"], [100, "100"], [1000, "1 ms"], [10000, "10 ms"]];
const across = (us) => 100 * Math.log10(Math.max(us, 1)) / Math.log10(MOST_US);

function histogram(id, told, deadline) {
  const svg = document.getElementById(`${id}-histogram`);
  const {edges, counts} = told || {edges: [], counts: []};
  const most = Math.log10(Math.max(10, ...counts) * 1.1);
  const bar = (n, k) => n ? `M${across(edges[k]).toFixed(2)} 40V${(40 - 40 * Math.log10(n + 0.1) / most).toFixed(2)}H${across(edges[k + 1]).toFixed(2)}V40Z` : "";
  const line = deadline ? `M${across(deadline).toFixed(2)} 0V40` : "";
  const ticks = DECADES.slice(1).map(([us]) => `M${across(us).toFixed(2)} 0V40`).join("");
  for (const [kind, path] of [["ticks", ticks], ["bars", counts.map(bar).join("")], ["deadline", line]]) {
    const shown = svg.querySelector(`.${kind}`);
    if (shown.getAttribute("d") !== path) shown.setAttribute("d", path);
  }
}

document.querySelector(".times .scale").replaceChildren(...DECADES.map(([us, text], i) => {
  const made = document.createElement("span");
  made.textContent = text;
  made.className = `decade-${i}`;
  return made;
}));
