"use strict";
// The words, the tables and the histograms of what the server tells five times a second.

const SAID_MS = 5000, MOST_US = 20000;

const put = (name, text) => {
  const element = one(name);
  const shown = text === "" || text === null || text === undefined ? "-" : String(text);
  if (element.textContent !== shown) element.textContent = shown;
  return element;
};

function words(head) {
  const state = head.state, host = state.host;
  put("arm", state.arm).className = `badge ${state.arm}`;
  put("mode", host.runs ? host.mode : "no host");
  put("phase", host.phase).title = host.phase;
  put("display_s", host.display_s === null ? "" : `${host.display_s.toFixed(1)} s`);
  put("recording", host.recording ? host.recording.split("/").pop() : "").title = host.recording;
  one("recording-lamp").classList.toggle("on", Boolean(host.recording));
  put("subject", host.subject).title = host.subject;
  put("trial", host.trial).title = host.trial;
  put("load_percent", `${state.load_percent.toFixed(0)} %`);
  one("load-meter").value = state.load_percent;
  put("lost", state.lost);
  put("role", head.controls ? "control" : "look on");
  action("control").hidden = head.controls;
  sliders(host.parameters, head.axis, head.controls, host.arm_key);
  for (const [name, id] of [["wakeup_us", "wakeup"], ["sync_to_rpdo_us", "sync_to_rpdo"]]) {
    put(name, host[name] && `${host[name].map((us) => us.toFixed(0)).join(" / ")} us`);
    histogram(id, host.histograms[id], host.deadline_us);
  }
  if (head.answer) {
    say(head.answer);
    if (/^(set|mark) /.test(head.answer)) setTimeout(() => one("said").textContent === head.answer && say(""), SAID_MS);
  }
  if (head.refused) say("another page controls; close it first");
  const trip = one("trip"), told = host.trip ? `Trip: ${host.trip}${host.advice ? `. Likely causes, and what to do: ${host.advice}` : ""}` : "";
  if (trip.textContent !== told) trip.textContent = told;
  trip.hidden = !told;
  rows("pdos", state.pdos.flatMap(pdoRows));
  rows("nodes", state.nodes.flatMap(nodeRows));
  rows("events", state.events.slice().reverse().map(([t, said, grave]) =>
    [grave ? "grave" : "", [[new Date(1000 * t).toLocaleTimeString([], {hour12: false}), ""], [said, ""]]]));
}

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
  const told = node.emergency || node.power;
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
function histogram(id, told, deadline) {
  const svg = document.getElementById(`${id}-histogram`);
  const {edges, counts} = told || {edges: [], counts: []};
  const x = (us) => 100 * Math.log10(Math.max(us, 1)) / Math.log10(MOST_US), most = Math.log10(Math.max(10, ...counts) * 1.1);
  const bar = (n, k) => n ? `M${x(edges[k]).toFixed(2)} 40V${(40 - 40 * Math.log10(n + 0.1) / most).toFixed(2)}H${x(edges[k + 1]).toFixed(2)}V40Z` : "";
  const line = deadline ? `M${x(deadline).toFixed(2)} 0V40` : "";
  for (const [kind, path] of [["bars", counts.map(bar).join("")], ["deadline", line]]) {
    const shown = svg.querySelector(`.${kind}`);
    if (shown.getAttribute("d") !== path) shown.setAttribute("d", path);
  }
}
