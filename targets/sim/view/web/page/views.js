// The fleet from above and from the side, at one time.
"use strict";

const CAR = [[0.28, 0], [0.2, 0.13], [-0.22, 0.13], [-0.22, -0.13], [0.2, -0.13]]; // metres about the middle
const QUAD_ARM = 0.14, ROTOR = 0.085;

// What the run takes place in, [[x, y, z], [x, y, z]]: arena and geofence, or all that was seen.
function room(model) {
  const arena = (model.header.world || {}).arena;
  const frames = [arena && [arena.lo, arena.hi], model.header.geofence].filter(Boolean);
  if (frames.length)
    return [Math.min, Math.max].map((pick, side) => [0, 1, 2].map((axis) => pick(...frames.map((frame) => frame[side][axis]))));
  const low = [0, 0, 0], high = [1, 1, 1];
  for (const robot of model.robots)
    ["x", "y", "z"].forEach((axis, k) => robot[axis].forEach((v) => {
      low[k] = Math.min(low[k], v - 0.5);
      high[k] = Math.max(high[k], v + 0.5);
    }));
  return [low, high];
}

// A frame with the same scale on both axes; the canvas gets the height that the room's shape wants.
function level(canvas, [low, high], across, up, labels, most) {
  const spanX = high[across] - low[across] || 1, spanY = high[up] - low[up] || 1;
  const margin = 0.04 * Math.max(spanX, spanY);
  const edge = { left: 52, right: 14, top: 14, bottom: 36 };
  const width = Math.max(60, canvas.clientWidth) - edge.left - edge.right;
  let scale = width / (spanX + 2 * margin);
  const height = Math.min(most, scale * (spanY + 2 * margin));
  scale = Math.min(scale, height / (spanY + 2 * margin));
  const extra = (width / scale - spanX) / 2;
  const x = [low[across] - extra, high[across] + extra], y = [low[up] - margin, low[up] - margin + height / scale];
  const xs = Math.max(3, width / 70), ys = Math.max(0.01, (xs * height) / width); // the same step on both axes
  return { ...frame(pen(canvas, height + edge.top + edge.bottom), x, y, { ...edge, ...labels, xs, ys }), scale };
}

function fence(chart, [low, high], across, up, lines, ink) {
  const corners = [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]];
  stroke(chart.ctx, corners.map(([i, j]) => [chart.x([low, high][i][across]), chart.y([low, high][j][up])]), ink, { lines, width: 1.3 });
}

function solid(chart, obstacle, across, up) {
  const { ctx } = chart;
  ctx.fillStyle = STONE;
  ctx.strokeStyle = STONE_EDGE;
  ctx.lineWidth = 1;
  ctx.setLineDash([]);
  ctx.beginPath();
  const box = (x0, y0, x1, y1) => ctx.rect(chart.x(x0), chart.y(y1), (x1 - x0) * chart.scale, (y1 - y0) * chart.scale);
  const middle = obstacle.centre || obstacle.base;
  if (obstacle.shape === "box") box(obstacle.lo[across], obstacle.lo[up], obstacle.hi[across], obstacle.hi[up]);
  else if (obstacle.shape === "cylinder" && up === 2)
    box(middle[across] - obstacle.radius, middle[2], middle[across] + obstacle.radius, middle[2] + obstacle.height);
  else if (middle) ctx.arc(chart.x(middle[across]), chart.y(middle[up]), obstacle.radius * chart.scale, 0, 7);
  else
    for (const face of obstacle.faces || [])
      face.forEach((i, k) => {
        const at = [chart.x(obstacle.vertices[i][across]), chart.y(obstacle.vertices[i][up])];
        k ? ctx.lineTo(...at) : ctx.moveTo(...at);
      });
  ctx.fill();
  ctx.stroke();
}

// A GridMap as an image: unknown stays clear, free is light, occupied dark.
function mapImage(map) {
  const image = document.createElement("canvas"), all = cells(map);
  image.width = Math.max(1, map[3]);
  image.height = Math.max(1, map[4]);
  const pixels = image.getContext("2d").createImageData(image.width, image.height);
  for (let k = 0; k < all.length; k++) {
    const at = 4 * ((map[4] - 1 - Math.floor(k / map[3])) * map[3] + (k % map[3]));
    const shade = all[k] === 3 ? [52, 58, 70, 255] : all[k] === 1 ? [214, 234, 248, 255] : [0, 0, 0, 0];
    pixels.data.set(shade, at);
  }
  image.getContext("2d").putImageData(pixels, 0, 0);
  return image;
}

function drawMap(chart, map) {
  if (!isMap(map) || !map[3]) return;
  const [size, x, y, width, height] = map, { ctx } = chart;
  ctx.imageSmoothingEnabled = false;
  ctx.drawImage(mapImage(map), chart.x(x * size), chart.y((y + height) * size), width * size * chart.scale, height * size * chart.scale);
}

function markers(chart, model, now, across, up) {
  for (const marker of model.markers.filter(Boolean)) {
    const state = (model.at(marker.states, now, 0) || [0, 0])[1], [ink] = STATES[state] || STATES[0];
    const px = chart.x(marker.position[across]), py = chart.y(marker.position[up]), { ctx } = chart;
    ctx.setLineDash(state === 1 ? [3, 2] : []);
    ctx.lineWidth = 2;
    ctx.strokeStyle = ctx.fillStyle = ink;
    ctx.globalAlpha = 0.9;
    ctx.beginPath();
    ctx.arc(px, py, Math.max(6, Math.min(11, (marker.radius || 0.2) * chart.scale)), 0, 7);
    ctx.stroke();
    if (state === 2) ctx.fill();
    ctx.globalAlpha = 1;
    ctx.setLineDash([]);
    if (state === 2) stroke(ctx, [[px - 3, py], [px - 1, py + 3], [px + 4, py - 3]], "#fff", { width: 2 });
    else if (state === 1) { ctx.beginPath(); ctx.arc(px, py, 3, 0, 7); ctx.fill(); }
  }
}

function trail(chart, robot, from, to, across, up, look) {
  const keys = ["x", "y", "z"], points = [];
  const first = Math.max(0, upTo(robot.t, from)), last = upTo(robot.t, to);
  const each = Math.max(1, Math.floor((last - first) / 1500));
  for (let k = first; k <= last; k += each) points.push([chart.x(robot[keys[across]][k]), chart.y(robot[keys[up]][k])]);
  stroke(chart.ctx, points, colour(robot.pid), { ...look, lines: dash(robot.pid) });
}

// The path that a robot was given last, from the robot if it is one point; null when there is none, or its end is reached.
function pathAhead(model, robot, now, pose) {
  const row = model.at(robot.paths, now);
  if (!row || !pose || !row[2].length) return null;
  const goal = row[2][row[2].length - 1];
  if (Math.hypot(goal[0] - pose[0], goal[1] - pose[1]) < 0.05) return null;
  return row[2].length > 1 ? row[2] : [pose, goal];
}

function ahead(chart, model, robot, now, pose, across, up) {
  const path = pathAhead(model, robot, now, pose);
  if (!path) return;
  const points = path.map((p) => [chart.x(p[across]), chart.y(p[up])]);
  stroke(chart.ctx, points, colour(robot.pid), { width: 1.4, lines: [2, 4] });
  const [px, py] = points[points.length - 1];
  stroke(chart.ctx, [[px - 4, py - 4], [px + 4, py + 4]], colour(robot.pid), { width: 1.8 });
  stroke(chart.ctx, [[px - 4, py + 4], [px + 4, py - 4]], colour(robot.pid), { width: 1.8 });
}

// A squad: a ring with three discs, or, with its robots unfolded, a dashed ring around them.
function squad(chart, robot, px, py, reach) {
  const { ctx } = chart, size = Math.max(chart.scale, 42), radius = robot.unfolded ? (reach + 0.35) * chart.scale : 0.34 * size;
  ctx.strokeStyle = ctx.fillStyle = colour(robot.pid);
  ctx.lineWidth = robot.unfolded ? 1.2 : 2.4;
  ctx.setLineDash(robot.unfolded ? [5, 4] : []);
  ctx.beginPath();
  ctx.arc(px, py, radius, 0, 7);
  ctx.stroke();
  ctx.setLineDash([]);
  for (let k = 0; k < 3 && !robot.unfolded; k++) {
    ctx.beginPath();
    ctx.arc(px + 0.17 * size * Math.cos(2.094 * k), py + 0.17 * size * Math.sin(2.094 * k), 0.09 * size, 0, 7);
    ctx.fill();
  }
}

function body(chart, robot, px, py, yaw) {
  const { ctx } = chart, size = Math.max(chart.scale, flies(robot) ? 56 : 42);
  ctx.save();
  ctx.translate(px, py);
  ctx.rotate(-yaw);
  ctx.globalAlpha = robot.silent ? 0.35 : 1; // where it was last
  ctx.setLineDash([]);
  ctx.fillStyle = colour(robot.pid);
  ctx.strokeStyle = "#fff";
  ctx.lineWidth = 1.2;
  if (flies(robot)) {
    for (const [i, j] of [[1, 1], [1, -1], [-1, 1], [-1, -1]]) {
      ctx.beginPath();
      ctx.arc(i * QUAD_ARM * size, j * QUAD_ARM * size, ROTOR * size, 0, 7);
      ctx.fill();
      ctx.stroke();
    }
    ctx.beginPath();
    ctx.moveTo(0.3 * size, 0);
    ctx.lineTo(0.02 * size, 0.11 * size);
    ctx.lineTo(0.02 * size, -0.11 * size);
  } else {
    ctx.beginPath();
    CAR.forEach(([i, j], k) => (k ? ctx.lineTo(i * size, -j * size) : ctx.moveTo(i * size, -j * size)));
  }
  ctx.closePath();
  ctx.fill();
  ctx.stroke();
  ctx.restore();
}

// A quad is drawn as one that flies, and so is a robot of another target that was ever off the ground.
function flies(robot) {
  if (robot.target === "quad") return true;
  for (let k = robot.looked || 0; k < robot.z.length && !robot.flew; k++) robot.flew = robot.z[k] > 0.3;
  robot.looked = robot.z.length;
  return robot.flew;
}

// Names beside robots, each at the first of some places where it covers no other.
function names(chart, placed) {
  const taken = [];
  for (const { robot, px, py } of placed) {
    const words = robot.silent ? `${robot.name} (silent)` : robot.name, wide = chart.ctx.measureText(words).width + 4;
    const places = [[16, -10], [16, 16], [-16 - wide, -10], [-16 - wide, 16], [-wide / 2, -22], [-wide / 2, 30]];
    const boxes = places.map(([dx, dy]) => [px + dx, py + dy - 11, px + dx + wide, py + dy + 3]);
    const inside = (b) => b[0] > chart.left && b[2] < chart.width - chart.right && b[1] > chart.top && b[3] < chart.height - chart.bottom;
    const free = (b) => taken.every((o) => b[2] < o[0] || b[0] > o[2] || b[3] < o[1] || b[1] > o[3]);
    const k = Math.max(0, boxes.findIndex((b) => inside(b) && free(b)));
    taken.push(boxes[k]);
    text(chart.ctx, words, boxes[k][0], boxes[k][1] + 11, { ink: colour(robot.pid), halo: true, font: "bold " + FONT });
  }
}

function scene(canvas, model, now, { across, up, labels, most, tail, map, unfolded }) {
  const box = room(model), chart = level(canvas, view(model, box, up), across, up, labels, most);
  if (map) drawMap(chart, map);
  for (const obstacle of model.obstacles(now)) solid(chart, obstacle, across, up);
  const arena = (model.header.world || {}).arena;
  if (arena) fence(chart, [arena.lo, arena.hi], across, up, [], STONE_EDGE);
  if (model.header.geofence) fence(chart, model.header.geofence, across, up, [6, 4], DIM);
  if (up === 2) stroke(chart.ctx, [[0, chart.y(0)], [chart.width, chart.y(0)]], STONE_EDGE, { width: 1 });
  markers(chart, model, now, across, up);
  const placed = [];
  for (const robot of model.drawn(unfolded)) {
    const pose = model.pose(robot, now);
    if (!pose) continue;
    if (tail > 10) trail(chart, robot, -Infinity, now, across, up, { width: 1.4, alpha: 0.45 });
    if (tail > 0) trail(chart, robot, now - Math.min(10, tail), now, across, up, { width: 2.4, alpha: 0.9 });
    ahead(chart, model, robot, now, pose, across, up);
    placed.push({ robot, pose, px: chart.x(pose[across]), py: chart.y(pose[up]) });
  }
  for (const { robot, pose, px, py } of placed)
    if (up === 1 && robot.target === "squad") squad(chart, robot, px, py, model.reach(robot, pose, now));
    else if (up === 1) body(chart, robot, px, py, pose[3]);
    else if (!robot.unfolded) { chart.ctx.fillStyle = colour(robot.pid); chart.ctx.fillRect(px - 8, py - (flies(robot) ? 3 : 7), 16, flies(robot) ? 6 : 7); }
  alarms(chart, model, now, placed);
  names(chart, placed);
  chart.end();
  return chart;
}

// From the side, only the heights that are used.
function view(model, [low, high], up) {
  if (up !== 2) return [low, high];
  let top = 1;
  for (const robot of model.robots) for (const z of robot.z) if (z > top) top = z;
  for (const marker of model.markers.filter(Boolean)) top = Math.max(top, marker.position[2]);
  return [[low[0], low[1], 0], [high[0], high[1], Math.min(Math.max(high[2], 1), top + 0.4)]];
}

// Whoever takes part in a violation within a second has a red ring.
function alarms(chart, model, now, placed) {
  const named = new Set(model.marks.filter(([t, kind]) => kind === "violation" && Math.abs(t - now) < 1).flatMap((mark) => mark[3]));
  for (const { robot, px, py } of placed)
    if (named.has(robot.name) || (!robot.unfolded && [...robot.members.values()].some((each) => named.has(each.name)))) {
      chart.ctx.beginPath();
      chart.ctx.arc(px, py, 22, 0, 7);
      stroke(chart.ctx, [], RED);
      chart.ctx.strokeStyle = RED;
      chart.ctx.lineWidth = 3;
      chart.ctx.stroke();
    }
}
