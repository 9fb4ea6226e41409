"use strict";
// The tip of an arm: its path with the force on the hand, and that force by the direction of motion.

const SECTORS = 48, MOVING_M_S = 0.02, ARROW = 0.3;

// A plot whose axes have the same scale.
class EqualPlot extends Plot {
  constructor(place, row) {
    super(place, "equal", {last: true, signals: [], ...row});
    this.rangeX = new Range(row.least);
    this.rangeY = new Range(row.least);
  }

  area() {
    const a = super.area(), metre = Math.max((a.x[1] - a.x[0]) / (a.right - a.left), (a.y[1] - a.y[0]) / (a.bottom - a.top));
    const around = ([low, high], pixels) => [(low + high) / 2 - metre * pixels / 2, (low + high) / 2 + metre * pixels / 2];
    return {...a, x: around(a.x, a.right - a.left), y: around(a.y, a.bottom - a.top)};
  }

  draw(data) {
    if (!this.place.clientWidth) return;
    this.fitPoints(data);
    const {ctx, a} = this.within(0, (ctx, a) => this.points(ctx, a, data));
    this.pointer(ctx, a);
  }

  hold(xs, ys) {
    const ends = (values) => values.reduce(([low, high], value) => isFinite(value) ? [Math.min(low, value), Math.max(high, value)] : [low, high], [Infinity, -Infinity]);
    this.rangeX.hold(...ends(xs));
    this.rangeY.hold(...ends(ys));
  }
}

function arrow(ctx, a, [x, y], [dx, dy], colour, width) {
  const from = [a.px(x), a.py(y)], to = [a.px(x + dx), a.py(y + dy)], length = Math.hypot(to[0] - from[0], to[1] - from[1]);
  if (!(length > 2)) return;
  const u = [(to[0] - from[0]) / length, (to[1] - from[1]) / length], head = Math.min(3.5 * width + 3, 0.5 * length);
  const neck = [to[0] - head * u[0], to[1] - head * u[1]];
  ctx.strokeStyle = ctx.fillStyle = colour;
  ctx.lineWidth = width;
  ctx.beginPath();
  ctx.moveTo(...from);
  ctx.lineTo(...neck);
  ctx.stroke();
  ctx.beginPath();
  ctx.moveTo(...to);
  ctx.lineTo(neck[0] - 0.45 * head * u[1], neck[1] + 0.45 * head * u[0]);
  ctx.lineTo(neck[0] + 0.45 * head * u[1], neck[1] - 0.45 * head * u[0]);
  ctx.fill();
}

// The size of an arrow: the larger the law or the force, the larger a newton's share is not.
function largest([xs, ys]) {
  let most = 0;
  for (let i = 0; i < xs.length; i++) if (isFinite(xs[i]) && isFinite(ys[i])) most = Math.max(most, Math.hypot(xs[i], ys[i]));
  return most;
}

class TipPlot extends EqualPlot {
  fitPoints(data) {
    const [xs, ys] = data.tip || [[], []], ends = data.arm;
    this.hold([...xs, ...ends.map(([x]) => x)], [...ys, ...ends.map(([, y]) => y)]);
  }

  points(ctx, a, data) {
    const [xs, ys] = data.tip || [[], []], [fx, fy] = data.tip_force || [[], []], n = xs.length;
    ctx.lineCap = ctx.lineJoin = "round";
    ctx.strokeStyle = colours.line;
    ctx.lineWidth = 9;
    ctx.beginPath();
    data.arm.forEach(([x, y], k) => k ? ctx.lineTo(a.px(x), a.py(y)) : ctx.moveTo(a.px(x), a.py(y)));
    ctx.stroke();
    ctx.fillStyle = colours.dim;
    for (const [x, y] of data.arm.slice(0, -1)) {
      ctx.beginPath();
      ctx.arc(a.px(x), a.py(y), 4, 0, 2 * Math.PI);
      ctx.fill();
    }
    ctx.lineWidth = 2;
    ctx.strokeStyle = colours.series[0];
    for (let i = 1; i < n; i++) {
      ctx.globalAlpha = 0.08 + 0.92 * (i / n) ** 2;
      ctx.beginPath();
      ctx.moveTo(a.px(xs[i - 1]), a.py(ys[i - 1]));
      ctx.lineTo(a.px(xs[i]), a.py(ys[i]));
      ctx.stroke();
    }
    ctx.globalAlpha = 1;
    if (!n) return;
    const scale = ARROW * (a.x[1] - a.x[0]) / Math.max(1.3 * largest(data.ring || [[], []]), largest([fx, fy]), 1);
    arrow(ctx, a, [xs[n - 1], ys[n - 1]], [scale * fx[n - 1], scale * fy[n - 1]], colours.series[1], 3);
    ctx.fillStyle = colours.text;
    ctx.beginPath();
    ctx.arc(a.px(xs[n - 1]), a.py(ys[n - 1]), 4, 0, 2 * Math.PI);
    ctx.fill();
  }
}

// The measured force over the directions of motion: the last of each sector stays until the next pass.
class PolarPlot extends EqualPlot {
  constructor(place, row) {
    super(place, row);
    this.held = new Map();
  }

  take(data) {
    const [vx, vy] = data.tip_velocity || [[], []], [fx, fy] = data.tip_force || [[], []], sums = new Map();
    for (let i = 0; i < vx.length; i++) {
      if (!(Math.hypot(vx[i], vy[i]) > MOVING_M_S) || !isFinite(fx[i])) continue;
      const sector = Math.floor(((Math.atan2(vy[i], vx[i]) / (2 * Math.PI) + 1) % 1) * SECTORS) % SECTORS;
      const [n, x, y] = sums.get(sector) || [0, 0, 0];
      sums.set(sector, [n + 1, x + fx[i], y + fy[i]]);
    }
    for (const [sector, [n, x, y]] of sums) this.held.set(sector, [x / n, y / n]);
  }

  fitPoints(data) {
    if (data === known) this.take(data);
    const [rx, ry] = data.ring || [[], []], shown = [...this.held.values()];
    const most = Math.max(largest([rx, ry]), ...shown.map(([x, y]) => Math.hypot(x, y)), 0);
    this.hold([-most, most], [-most, most]);
  }

  points(ctx, a, data) {
    ctx.strokeStyle = colours.law;
    ctx.lineWidth = 2;
    ctx.setLineDash([6, 4]);
    this.place.querySelector(".series-law").hidden = !data.ring;
    if (data.ring) this.closed(ctx, a, data.ring[0].map((x, i) => [x, data.ring[1][i]]));
    ctx.setLineDash([]);
    const order = [...this.held.keys()].sort((one, other) => one - other);
    ctx.strokeStyle = ctx.fillStyle = colours.series[0];
    ctx.lineWidth = 1.5;
    if (order.length === SECTORS) this.closed(ctx, a, order.map((sector) => this.held.get(sector)));
    for (const sector of order) {
      const [x, y] = this.held.get(sector);
      ctx.fillRect(a.px(x) - 2, a.py(y) - 2, 4, 4);
    }
    const [fx, fy] = data.tip_force || [[], []], n = fx.length;
    if (n && isFinite(fx[n - 1])) arrow(ctx, a, [0, 0], [fx[n - 1], fy[n - 1]], colours.series[1], 3);
  }

  closed(ctx, a, points) {
    ctx.beginPath();
    points.forEach(([x, y], k) => k ? ctx.lineTo(a.px(x), a.py(y)) : ctx.moveTo(a.px(x), a.py(y)));
    ctx.closePath();
    ctx.stroke();
  }
}

function tipPlots() {
  document.getElementById("friction-plot").hidden = true;
  const places = ["tip-plot", "polar-plot"].map((id) => document.getElementById(id));
  for (const place of places) place.hidden = false;
  return [
    new TipPlot(places[0], {title: "tip [m], 2 s", unit: "m", across: "x [m]", least: 0.1, high: true,
      legend: [["path", "series-0"], ["force on the hand", "series-1"]]}),
    new PolarPlot(places[1], {title: "force on the hand [N]", unit: "N", across: "x [N]", least: 2, high: true,
      legend: [["measured", "series-0"], ["now", "series-1"], ["law", "series-law"]]}),
  ];
}
