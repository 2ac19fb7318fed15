// Each robot's rounds over time: events, skips, faults, phases, and what it said.
"use strict";

const ROW = 30, PHASES = { starting: "#d8d8dc", joining: "#b9d4e8", running: "#cfe8da", stopping: "#f0dcb4", stopped: "#e8e8ea" };
const SKIP = "#dadade";

const EVENTS = ["#56B4E9", "#E69F00", "#009E73", "#CC79A7", "#0072B2", "#D55E00", "#8a8a90"];
const eventInk = (model, name) => EVENTS[Math.max(0, model.events.indexOf(name)) % EVENTS.length];

function timeline(canvas, model, span, now) {
  const robots = model.robots, height = robots.length * ROW + 50;
  const area = pen(canvas, height), left = Math.min(150, 20 + Math.max(40, ...robots.map((r) => area.ctx.measureText(r.name).width)));
  const chart = frame(area, span, [0, 1], { left, ys: 0, xlabel: timeAxis(), top: 10 });
  chart.end();
  robots.forEach((robot, k) =>
    text(area.ctx, robot.name, left - 8, 10 + k * ROW + ROW / 2, { align: "right", base: "middle", ink: colour(robot.pid), font: "bold " + FONT }));
  area.ctx.save();
  area.ctx.beginPath();
  area.ctx.rect(left, 0, area.width - left - chart.right, height - 36);
  area.ctx.clip();
  robots.forEach((robot, k) => row(chart, model, robot, 10 + k * ROW));
  overTime(chart, model, now);
  area.ctx.restore();
  return chart;
}

function row(chart, model, robot, top) {
  const { ctx } = chart;
  const bar = (t0, t1, y, high, ink) => {
    const a = chart.x(t0), wide = Math.max(2.5, chart.x(t1) - a);
    if (a + wide < chart.left || a > chart.width) return;
    ctx.fillStyle = ink;
    ctx.fillRect(a, y, wide, high);
  };
  robot.phases.forEach(([, t, phase], k) => {
    const next = robot.phases[k + 1];
    bar(t, next ? next[1] : model.last, top + 3, 4, PHASES[phase] || "#eee");
  });
  const delta = model.header.delta || 0.1;
  for (const kind of [1, 0, 2]) // faults above events above skips
    for (const [, t0, t1, , outcome, what] of robot.rounds)
      if (outcome === kind) bar(t0, Math.max(t1, t0 + delta * 0.8), top + 9, 15, kind === 2 ? RED : kind ? SKIP : eventInk(model, what));
  for (const [, t, level] of robot.logs) {
    const px = chart.x(t);
    ctx.fillStyle = level === "error" ? RED : level === "warning" ? "#b36b00" : "#5f6368";
    ctx.beginPath();
    ctx.moveTo(px, top + 22);
    ctx.lineTo(px - 4, top + 28);
    ctx.lineTo(px + 4, top + 28);
    ctx.fill();
  }
}

// What is under the pointer, in words; "" where nothing is.
function hovered(model, chart, px, py) {
  const robot = model.robots[Math.floor((py - 10) / ROW)], t = chart.time(px);
  if (!robot || px < chart.left) return "";
  const near = 4 * (chart.time(px + 1) - t), delta = model.header.delta || 0.1, said = [`${robot.name}, ${number(t)} s`];
  const round = robot.rounds.filter((r) => r[1] - near <= t && t <= Math.max(r[2], r[1] + delta) + near).sort((a, b) => rank(a) - rank(b))[0];
  if (round) {
    const [, t0, t1, count, outcome, what] = round, when = count > 1 ? `${number(t0)} to ${number(t1)} s, ${count} rounds` : `${number(t0)} s`;
    said.push(`${["event", "skipped", "fault"][outcome]} ${what} (${when})`);
  }
  const phase = model.at(robot.phases, t);
  if (phase) said.push(`phase ${phase[2]}${phase[3] ? ": " + phase[3] : ""}`);
  for (const [, at, level, words] of robot.logs) if (Math.abs(at - t) < near * 1.5) said.push(`${number(at)} s ${level}: ${words}`);
  for (const [at, kind, what, who, detail] of model.marks)
    if (Math.abs(at - t) < near && (!who.length || who.includes(robot.name))) said.push(`${number(at)} s ${kind} ${what} ${detail}`);
  return said.join("\n");
}

const rank = (round) => [1, 2, 0][round[4]] * 1e6 + round[3];
