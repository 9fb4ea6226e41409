"use strict";
// STOP needs neither plots nor socket: it comes second, and needs `elements.js` alone.

// A line under the head; kind: "good", "bad", "busy" or none.
function say(text, kind = "") {
  const said = one("said");
  said.textContent = text;
  said.className = kind;
  said.hidden = !text;
}

// A stop under way: when it was asked for, whether the drive was armed then, and after how many seconds it was not.
let stopping = null, armed = false;

// What the bus says of the drive, with each state of the server.
function driveHeard(arm, drives) {
  armed = arm === "armed";
  if (!stopping || !stopping.armed || arm !== "disarmed") return;
  const seconds = ((performance.now() - stopping.since) / 1000).toFixed(1);
  if (/fault/.test(drives)) say(`stopped, ${seconds} s: the drive is disarmed by a fault`, "busy");
  else say(`stopped safely, ${seconds} s: the drive is disarmed`, "good");
  stopping = null;
}

async function stop(event) {
  if (event) event.preventDefault();
  action("stop").classList.add("asked");
  stopping = {since: performance.now(), armed};
  say("stopping ...", "busy");
  try {
    const answer = await fetch("stop", {method: "POST", cache: "no-store"});
    if (answer.ok) answered(await answer.json());
    else failed(`STOP was refused (${answer.status}): use the rig's own emergency stop`);
  } catch (error) {
    failed("STOP did not reach the server: use the rig's own emergency stop");
  }
  action("stop").classList.remove("asked");
}

function failed(text) {
  stopping = null;
  say(text, "bad");
}

function answered({ok, text, tripped}) {
  if (!ok || tripped) failed(`STOP: ${text}`);
  else if (stopping && stopping.armed) say(`${text}; the drive has not said so yet`, "busy");
  else if (stopping) say(text, "good");
}

action("stop-form").addEventListener("submit", stop);
// Escape closes the list of faults of a simulated bus first (`bus.js`).
window.addEventListener("keydown", (event) => {
  if (event.key === "Escape" && !event.repeat && !document.body.classList.contains("choosing")) stop(event);
}, true);
