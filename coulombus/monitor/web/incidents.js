"use strict";
// The incidents that `coulombus explain` finds: a list that follows each one's state, and opens.

let clock = (t) => new Date(1000 * t).toLocaleTimeString([], {hour12: false});  // of a recording: seconds
let untilEnd = "now";
const WORDS = {unresolved: "unresolved", recovered: "recovered", warning: "warning"};

function lasted(incident) {
  if (incident.end === null) return `${incident.count > 1 ? `${incident.count} times, ` : ""}${clock(incident.t)} until ${untilEnd}`;
  const seconds = incident.end - incident.t;
  if (incident.count > 1) return `${incident.count} times, ${clock(incident.t)} to ${clock(incident.end)}`;
  return seconds < 0.001 ? clock(incident.t) : `${clock(incident.t)}, for ${seconds.toFixed(seconds < 10 ? 2 : 0)} s`;
}

function fill(place, texts) {
  const wanted = texts.join("\n");
  if (place.dataset.texts === wanted) return;
  place.dataset.texts = wanted;
  place.replaceChildren(...texts.map((text) => {
    const line = document.createElement("li");
    line.textContent = text;
    return line;
  }));
}

function incidentItem(key) {
  const item = document.createElement("li"), details = item.appendChild(document.createElement("details"));
  item.dataset.key = key;
  details.appendChild(document.createElement("summary")).dataset.action = `incident:${key}`;
  for (const [tag, name] of [["p", "cause"], ["ol", "checks"], ["ul", "course"]]) details.appendChild(document.createElement(tag)).className = name;
  return item;
}

function incidents(all) {
  const open = all.filter((incident) => incident.status === "unresolved").length;
  put("incidents", all.length ? `${all.length}${open ? `, ${open} unresolved` : ""}` : "none").className = open ? "unresolved" : "";
  const list = document.getElementById("incident-list"), items = new Map([...list.children].map((item) => [item.dataset.key, item]));
  const order = all.map((incident) => items.get(incident.key) || incidentItem(incident.key));
  if (order.length !== list.children.length || order.some((item, i) => list.children[i] !== item)) list.replaceChildren(...order);
  all.forEach((incident, i) => {
    const item = order[i], text = `${incident.number}. ${incident.title}; ${WORDS[incident.status]}, ${lasted(incident)}`;
    item.className = incident.status;
    const summary = item.querySelector("summary");
    if (summary.textContent !== text) summary.textContent = text;
    const cause = `${incident.cause} (${incident.sure})`, shown = item.querySelector(".cause");
    if (shown.textContent !== cause) shown.textContent = cause;
    fill(item.querySelector(".checks"), incident.checks);
    fill(item.querySelector(".course"), incident.course.map(([t, role, words]) => `${clock(t)} ${role}: ${words}`));
  });
}
