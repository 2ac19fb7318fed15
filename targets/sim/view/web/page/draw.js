// Drawing on canvases: frames with axes, lines over time, the view from above and from the side.
"use strict";

// Okabe and Ito, Color Universal Design (2008), without the yellow that vanishes on white; then dashes tell apart.
const COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"];
const DASHES = [[], [9, 4], [3, 3], [10, 3, 3, 3]];
const RED = "#B00020", INK = "#1d1d1f", DIM = "#5f6368", AMBER = "#b36b00", LINE = "#e4e4e7", STONE = "#cfcfd3", STONE_EDGE = "#8a8a90";
const STATES = [["#6B4C9A", "to do"], ["#E69F00", "taken"], ["#1B7F4B", "done"]];
const FONT = "12px system-ui, 'DejaVu Sans', sans-serif";

const timeAxis = () => given.axis || "time since round 1 (s)";
const colour = (pid) => COLOURS[pid % COLOURS.length];
const dash = (pid) => DASHES[Math.floor(pid / COLOURS.length) % DASHES.length];

// A canvas made ready for drawing at the screen's resolution.
function pen(canvas, height) {
  const scale = window.devicePixelRatio || 1, width = Math.max(60, canvas.clientWidth);
  if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
    canvas.style.height = height + "px";
  }
  const ctx = canvas.getContext("2d");
  ctx.setTransform(scale, 0, 0, scale, 0, 0);
  ctx.clearRect(0, 0, width, height);
  ctx.font = FONT;
  ctx.lineJoin = "round";
  return { ctx, width, height };
}

function ticks(low, high, most) {
  const raw = (high - low) / Math.max(0.01, most), power = 10 ** Math.floor(Math.log10(raw || 1));
  const step = [1, 2, 5, 10].map((k) => k * power).find((each) => each >= raw) || raw || 1;
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return { at: found, digits: Math.max(0, Math.min(4, -Math.floor(Math.log10(step) + 1e-9))) };
}

function text(ctx, words, x, y, { align = "left", base = "alphabetic", ink = INK, halo = false, font = FONT } = {}) {
  ctx.font = font;
  ctx.textAlign = align;
  ctx.textBaseline = base;
  if (halo) {
    ctx.strokeStyle = "#fffffff0";
    ctx.lineWidth = 3.5;
    ctx.setLineDash([]);
    ctx.strokeText(words, x, y);
  }
  ctx.fillStyle = ink;
  ctx.fillText(words, x, y);
}

// Axes with a grid; gives x and y from values to pixels, and clips what follows to the frame until `frame.end()`.
function frame(area, [x0, x1], [y0, y1], { left = 52, right = 14, top = 12, bottom = 36, xs, ys, xlabel, ylabel, title }) {
  const { ctx, width, height } = area;
  const x = (v) => left + ((v - x0) / (x1 - x0)) * (width - left - right);
  const y = (v) => height - bottom - ((v - y0) / (y1 - y0)) * (height - top - bottom);
  const across = ticks(x0, x1, xs || (width - left - right) / 80), up = ys === 0 ? { at: [] } : ticks(y0, y1, ys || (height - top - bottom) / 24);
  ctx.lineWidth = 1;
  ctx.strokeStyle = LINE;
  ctx.setLineDash([]);
  ctx.beginPath();
  for (const v of across.at) { ctx.moveTo(x(v), top); ctx.lineTo(x(v), height - bottom); }
  for (const v of up.at) { ctx.moveTo(left, y(v)); ctx.lineTo(width - right, y(v)); }
  ctx.stroke();
  for (const v of across.at) text(ctx, number(v, across.digits), x(v), height - bottom + 15, { align: "center", ink: DIM });
  for (const v of up.at) text(ctx, number(v, up.digits), left - 6, y(v), { align: "right", base: "middle", ink: DIM });
  text(ctx, xlabel || "", (left + width - right) / 2, height - 5, { align: "center", ink: DIM });
  ctx.save();
  ctx.translate(12, (top + height - bottom) / 2);
  ctx.rotate(-Math.PI / 2);
  text(ctx, ylabel || "", 0, 0, { align: "center", ink: DIM });
  ctx.restore();
  if (title) text(ctx, title, left, top - 4, { ink: INK });
  ctx.save();
  ctx.beginPath();
  ctx.rect(left, top, width - left - right, height - top - bottom);
  ctx.clip();
  const time = (px) => x0 + ((px - left) / (width - left - right)) * (x1 - x0);
  return { ...area, x, y, time, left, right, top, bottom, end: () => ctx.restore() };
}

function stroke(ctx, points, ink, { width = 1.6, lines = [], alpha = 1, step = false } = {}) {
  if (points.length < 1) return;
  ctx.globalAlpha = alpha;
  ctx.strokeStyle = ink;
  ctx.lineWidth = width;
  ctx.setLineDash(lines);
  ctx.beginPath();
  points.forEach(([px, py], k) => {
    if (k === 0) return ctx.moveTo(px, py);
    if (step) ctx.lineTo(px, points[k - 1][1]);
    ctx.lineTo(px, py);
  });
  ctx.stroke();
  ctx.setLineDash([]);
  ctx.globalAlpha = 1;
}

// The times shown, the cursor, and what is marked on all charts over time.
function overTime(chart, model, now) {
  const { ctx, height, top, bottom } = chart;
  const line = (t, ink, lines, width) => stroke(ctx, [[chart.x(t), top], [chart.x(t), height - bottom]], ink, { lines, width });
  ctx.fillStyle = "#7a3db820"; // while a cause goes on
  for (const [t, kind, , , , lasts] of model.marks)
    if (kind === "cause" && lasts) ctx.fillRect(chart.x(t), top, chart.x(t + lasts) - chart.x(t), height - bottom - top);
  line(0, STONE_EDGE, [3, 3], 1);
  const inks = { violation: RED, cause: "#7a3db8", monitor: AMBER };
  for (const [t, kind, what] of model.marks)
    if (kind !== "monitor" || what.includes(": violated")) line(t, inks[kind] || STONE_EDGE, [3, 3], 1);
  line(now, INK, [], 1.2);
}

function coordinate(canvas, model, axis, span, now, height) {
  const robots = model.robots.filter((robot) => robot.shown && robot.t.length);
  let low = Infinity, high = -Infinity;
  for (const robot of robots) for (const v of robot[axis]) { if (v < low) low = v; if (v > high) high = v; }
  if (!(low <= high)) [low, high] = [0, 1];
  const room = Math.max(0.25, (high - low) * 0.06), way = { x: "east", y: "north", z: "up" }[axis];
  const labels = { xlabel: timeAxis(), ylabel: `${axis}, ${way} (m)` };
  const chart = frame(pen(canvas, height), span, [low - room, high + room], labels);
  for (const robot of robots) {
    const points = [], from = Math.max(0, upTo(robot.t, span[0])), to = upTo(robot.t, span[1]) + 2;
    const each = Math.max(1, Math.floor((to - from) / (2 * chart.width)));
    for (let k = from; k < Math.min(to, robot.t.length); k += each) points.push([chart.x(robot.t[k]), chart.y(robot[axis][k])]);
    stroke(chart.ctx, points, colour(robot.pid), { width: 2, lines: dash(robot.pid), alpha: 0.9 });
  }
  overTime(chart, model, now);
  chart.end();
  return chart;
}

// Any lines over time: {points: [[t, v]], ink, lines, step, dots}, and a bound with its words, red when it is crossed.
function lines(canvas, model, span, now, height, series, { ylabel, bound, crossed, words }) {
  let high = bound > 0 ? 1.15 * bound : 0, low = 0;
  for (const { points } of series) for (const [, v] of points) { if (v > high) high = v; if (v < low) low = v; }
  if (high === low) high = low + 1;
  const chart = frame(pen(canvas, height), span, [low, low + (high - low) * 1.08], { xlabel: timeAxis(), ylabel });
  for (const { points, ink, lines, step } of series)
    stroke(chart.ctx, points.map(([t, v]) => [chart.x(t), chart.y(v)]), ink, { width: 1.8, lines, step });
  chart.ctx.fillStyle = RED;
  for (const [t, v] of series.flatMap((each) => each.dots || [])) chart.ctx.fillRect(chart.x(t) - 3, chart.y(v) - 3, 6, 6);
  if (bound > 0) {
    const ink = crossed ? RED : DIM;
    stroke(chart.ctx, [[chart.left, chart.y(bound)], [chart.width, chart.y(bound)]], ink, { width: 1.2 });
    text(chart.ctx, words, chart.width - chart.right - 4, chart.y(bound) - 4, { align: "right", ink, halo: true });
  }
  overTime(chart, model, now);
  chart.end();
  return chart;
}
