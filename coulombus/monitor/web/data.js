"use strict";
// What the server's batches bring: envelopes, samples, the phase plot's points, the law's curve, the state.

const BINS_PER_S = 50, BINS = 500;

const fresh = () => ({envelopes: new Map(), raw: new Map(), friction: null, law: null, tip: null, arm: [], ring: null, nowBin: 0});
let known = fresh();  // what came; envelopes: name -> {low, high, newest}, rings over the bin's number
let frozen = null;    // what is drawn instead, while the plots stand still

function takeEnvelope(into, name, first, low, high) {
  let ring = into.envelopes.get(name);
  if (!ring || first > ring.newest + 1) {
    ring = {low: new Float32Array(BINS).fill(NaN), high: new Float32Array(BINS).fill(NaN), newest: first - 1};
    into.envelopes.set(name, ring);
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
  const into = "trip_bin" in head ? Object.assign(fresh(), {tripBin: head.trip_bin, marks: tripMark}) : known;
  for (const part of head.parts) {
    const a = numbers.subarray(start, start + part.n), b = numbers.subarray(start + part.n, start + 2 * part.n);
    start += 2 * part.n;
    if (part.k === "envelope") takeEnvelope(into, part.s, part.first, a, b);
    else if (part.k === "raw") into.raw.set(part.s, [a, b]);
    else into[part.k] = [a, b];  // friction, and an arm's tip, tip_velocity, tip_force
  }
  into.nowBin = head.now_bin;
  if (head.arm) into.arm = head.arm;
  if ("law" in head) Object.assign(into, {law: head.law, ring: head.ring});
  if (into !== known) stand(into);
  return head;
}

function freeze() {
  stand(frozen ? null : structuredClone(known));
}

// What is drawn from now on: `still`, or with null what comes.
function stand(still) {
  frozen = still;
  action("freeze").setAttribute("aria-pressed", String(frozen !== null));
  rawTime();
  draw();
}

// The trip's time in each plot over time.
function tripMark(ctx, a, plot) {
  const x = a.px(plot.kind === "raw" ? 0 : (frozen.tripBin - frozen.nowBin) / BINS_PER_S);
  if (!(plot.time === times[plot.kind]) || x < a.left || x > a.right) return;
  ctx.strokeStyle = colours.bad;
  ctx.lineWidth = 1.5;
  ctx.beginPath();
  ctx.moveTo(x, a.top);
  ctx.lineTo(x, a.bottom);
  ctx.stroke();
}
