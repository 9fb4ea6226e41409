"use strict";
// The socket: it is opened again until the server is there.

const AGAIN_MS = 1000;
let socket = null, wanted = 0, cut = false;
let final = "";  // the server has said that it ends: with the "run", or the "server" alone

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
      if (!plots.length) makeLivePlots();
    }
    const head = take(event.data);
    if (head.state) {
      final = head.state.final ? (head.state.host.runs ? "server" : "run") : "";
      words(head);
    }
    if (head.n) wanted = head.n;
    requestFrame();
  };
  mine.onclose = () => {
    document.body.classList.add("cut");
    if (!cut && final === "run") say("The run is over, and the page's server with it. This is the last state.");
    else if (!cut) say("The server does not answer: this page is out of date. STOP from here cannot work: use `coulombus stop`, or the rig's own emergency stop.", "bad");
    cut = true;
    setTimeout(connect, AGAIN_MS);
  };
  socket = mine;
}

// A batch is taken when it is drawn: a tab that sleeps draws nothing, takes nothing and is sent nothing.
let asked = false, frames = 0;
function requestFrame() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => {
    asked = false;
    if (!frozen) draw();
    frames += 1;
    document.body.dataset.frames = frames;
    tell(`took ${wanted}`);
  });
}

makeLivePlots();
connect();
