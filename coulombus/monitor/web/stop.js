"use strict";
// STOP, and the helpers of all scripts. STOP needs neither plots nor socket: this script is the first, and needs no other.

const one = (name) => document.querySelector(`[data-signal="${name}"]`);
const action = (name) => document.querySelector(`[data-action="${name}"]`);

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
  if (event.key === "Escape" && !event.repeat) stop(event);
}, true);
