// What is known of a run: rows as rows.py makes them, kept for drawing. Metres, local ENU; seconds since round 1.
"use strict";

const MOST_KEPT = 40000; // poses of one robot, of a view that stays open for long

class Model {
  constructor(header) {
    this.header = header;
    this.robots = header.robots.map((robot) => ({
      ...robot, shown: true, t: [], x: [], y: [], z: [], yaw: [],
      rounds: [], phases: [], logs: [], paths: [], scans: [], late: [], links: [], locals: new Map(),
      members: new Map(), // of a squad: its robots by name
    }));
    this.shared = (header.shared || []).map((variable) => ({ ...variable, series: new Map() }));
    this.near = [];
    this.marks = [];
    this.moved = []; // obstacles: t, number, the obstacle at its new place
    this.markers = ((header.world || {}).markers || []).map((marker) => ({ ...marker, states: [] }));
    this.first = 0;
    this.last = 0.1;
    this.end = null;
    this.events = []; // names, in the order of their first time
  }

  // Takes in a chunk of rows; unknown tables are passed over.
  extend(chunk) {
    for (const table of ["poses", "members", "phases", "logs", "paths", "scans", "late", "links", "rounds", "locals"])
      for (const row of chunk[table] || []) {
        const robot = this.robots[row[0]];
        if (robot) { this["_" + table](robot, row); this._seen(row[1]); }
      }
    for (const row of chunk.shared || []) this._write(row);
    for (const row of chunk.near || []) this.near.push(row);
    for (const row of chunk.marks || []) this._mark(row);
    for (const row of chunk.obstacles || []) this.moved.push(row);
    for (const [t, number, state, marker] of chunk.markers || []) {
      if (marker && !this.markers[number]) this.markers[number] = { ...marker, states: [] };
      if (this.markers[number]) this.markers[number].states.push([t, state]);
    }
    if (this.near.length > MOST_KEPT) this.near = this.near.filter((_, k) => k % 2);
  }

  _seen(t) {
    this.first = Math.min(this.first, t);
    this.last = Math.max(this.last, t);
  }

  _poses(robot, [, t, x, y, z, yaw]) {
    robot.t.push(t); robot.x.push(x); robot.y.push(y); robot.z.push(z); robot.yaw.push(yaw);
    if (robot.t.length > MOST_KEPT)
      for (const key of ["t", "x", "y", "z", "yaw"]) robot[key] = robot[key].filter((_, k) => k % 2);
  }

  _members(squad, [pid, t, name, x, y, z, yaw]) {
    const own = { name: `${squad.name}.${name}`, target: "", shown: true, t: [], x: [], y: [], z: [], yaw: [], paths: [], scans: [], members: new Map() };
    if (!squad.members.has(name)) squad.members.set(name, { ...own, pid: squad.pid });
    this._poses(squad.members.get(name), [pid, t, x, y, z, yaw]);
  }

  _phases(robot, row) { robot.phases.push(row); }
  _logs(robot, row) { robot.logs.push(row); }
  _paths(robot, row) { robot.paths.push(row); }
  _scans(robot, row) {
    robot.scans.push(row);
    if (robot.scans.length > MOST_KEPT / 10) robot.scans.splice(0, robot.scans.length / 2);
  }

  _late(robot, row) { robot.late.push(row); }
  _links(robot, row) { robot.links.push(row); }

  _locals(robot, [, t, round, name, value]) {
    if (!robot.locals.has(name)) robot.locals.set(name, []);
    const series = robot.locals.get(name);
    series.push({ t, round, value });
    if (series.length > MOST_KEPT / 10) series.splice(0, series.length / 2);
  }

  _rounds(robot, row) {
    const before = robot.rounds[robot.rounds.length - 1];
    if (row[4] === 0 && !this.events.includes(row[5])) this.events.push(row[5]);
    if (before && before[4] === row[4] && before[5] === row[5]) {
      before[2] = row[2];
      before[3] += row[3];
    } else robot.rounds.push([...row]);
  }

  _write([name, pid, t, round, value]) {
    let variable = this.shared.find((each) => each.name === name);
    if (!variable) this.shared.push((variable = { name, kind: "allread", type: "", series: new Map() }));
    const key = variable.kind === "allwrite" ? -1 : pid;
    if (!variable.series.has(key)) variable.series.set(key, []);
    const series = variable.series.get(key);
    let at = series.length; // of one round the highest pid's counts, so it comes last
    while (at > 0 && (series[at - 1].round > round || (series[at - 1].round === round && series[at - 1].pid > pid))) at--;
    series.splice(at, 0, { t, round, pid, value });
    if (series.length > MOST_KEPT / 10) series.splice(0, series.length / 2);
  }

  _mark(row) {
    this.marks.push(row);
    this.marks.sort((a, b) => a[0] - b[0]);
    if (row[1] === "end") this.end = row[0];
  }

  // Drops what is older than a time; what still holds stays: the last row before it of each series.
  forget(before) {
    const drop = (rows, end) => { let k = 0; while (k + 1 < rows.length && end(rows[k + 1]) < before) k++; rows.splice(0, k); };
    for (const robot of this.robots) {
      for (const each of [robot, ...robot.members.values()]) {
        const k = Math.max(0, upTo(each.t, before));
        for (const key of ["t", "x", "y", "z", "yaw"]) each[key].splice(0, k);
      }
      for (const table of ["rounds", "phases", "logs", "paths", "late", "links"]) drop(robot[table], (row) => row[1]);
    }
    for (const { series } of this.shared) for (const writes of series.values()) drop(writes, (write) => write.t);
    for (const rows of [this.near, this.marks]) drop(rows, (row) => row[0]);
    this.first = Math.max(this.first, before);
  }

  // The obstacles where they stand at a time: a fault can move them.
  obstacles(t) {
    const found = [...(this.header.obstacles || [])];
    for (const [at, number, obstacle] of this.moved) if (at <= t && number < found.length) found[number] = obstacle;
    return found;
  }

  // The robots to draw: of an unfolded squad its own robots, after the squad itself.
  drawn(unfolded) {
    for (const robot of this.robots) robot.unfolded = Boolean(unfolded && robot.members.size);
    return this.robots.filter((robot) => robot.shown).flatMap((robot) => (robot.unfolded ? [robot, ...robot.members.values()] : [robot]));
  }

  // The largest distance of a squad's robots from its position, in plan view.
  reach(squad, pose, t) {
    const away = [...squad.members.values()].map((member) => this.pose(member, t)).filter(Boolean);
    return Math.max(0.3, ...away.map(([x, y]) => Math.hypot(x - pose[0], y - pose[1])));
  }

  pid(name) { return this.robots.findIndex((robot) => robot.name === name); }

  // Where a robot is at a time: [x, y, z, yaw], between two samples on the straight line; null before the first.
  pose(robot, t) {
    const k = upTo(robot.t, t);
    if (k < 0) return null;
    const next = Math.min(k + 1, robot.t.length - 1);
    const span = robot.t[next] - robot.t[k];
    const share = span > 0 && t > robot.t[k] ? Math.min(1, (t - robot.t[k]) / span) : 0;
    const mix = (values) => values[k] + share * (values[next] - values[k]);
    const turn = Math.atan2(Math.sin(robot.yaw[next] - robot.yaw[k]), Math.cos(robot.yaw[next] - robot.yaw[k]));
    return [mix(robot.x), mix(robot.y), mix(robot.z), robot.yaw[k] + share * turn];
  }

  // The last row (its time in place `column`) that began by then, or null.
  at(rows, t, column = 1) {
    for (let k = rows.length - 1; k >= 0; k--) if (rows[k][column] <= t) return rows[k];
    return null;
  }

  // What a variable's slot held: the last write by then, or null.
  value(series, t) {
    for (let k = (series || []).length - 1; k >= 0; k--) if (series[k].t <= t) return series[k];
    return null;
  }

  // The last round by then in which a robot looked at its copy of the shared variables: {round, t}; null before any.
  copied(robot, t) {
    const delta = this.header.delta || 0.1;
    for (let k = robot.rounds.length - 1; k >= 0; k--) {
      const [, from, to, , outcome, what] = robot.rounds[k];
      if (from > t || (outcome === 1 && what !== "no event enabled")) continue;
      const at = t >= to ? to : from + Math.floor((t - from) / delta + 1e-3) * delta;
      return { round: Math.floor(at / delta + 0.25) + 1, t: at }; // an event is decided within half a round
    }
    return null;
  }

  // What a robot knew of a variable's slot: others' writes of the rounds before the one in which it looked, and its own.
  believed(robot, series, t) {
    const seen = (this.copied(robot, t) || { round: 0 }).round;
    for (let k = (series || []).length - 1; k >= 0; k--) {
      const write = series[k], own = write.pid === robot.pid && write.round <= seen;
      if (write.t <= t && (own || write.round < seen)) return write;
    }
    return null;
  }
}

// The last place of an ascending array whose value is at most t; -1 before all.
function upTo(times, t) {
  let low = 0, high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

const number = (value, digits = 2) => (Object.is(value, -0) ? 0 : value).toFixed(digits).replace(/^-(0(\.0*)?)$/, "$1");

// A value of a type as a person writes it; `records` are the program's record types.
function shown(value, type, records) {
  const inner = /^(List|Queue|Set)<(.*)>$/.exec(type || "");
  if (value === null || value === undefined) return "?";
  if (typeof value === "object" && !Array.isArray(value)) return value.cut !== undefined ? value.cut + " …" : JSON.stringify(value);
  if (type === "GridMap" && isMap(value)) return told(value);
  if (type === "Point" && Array.isArray(value)) return "(" + value.map((each) => (typeof each === "number" ? number(each) : "?")).join(", ") + ")";
  if (inner && Array.isArray(value)) return "[" + value.map((each) => shown(each, inner[2], records)).join(", ") + "]";
  if (records && Object.hasOwn(records, type) && Array.isArray(value))
    return type + "(" + records[type].map(([name, of], k) => name + ": " + shown(value[k], of, records)).join(", ") + ")";
  if (Array.isArray(value)) return "(" + value.map((each) => shown(each, "", records)).join(", ") + ")";
  if (typeof value === "number") return Number.isInteger(value) ? String(value) : number(value);
  return typeof value === "string" ? JSON.stringify(value) : String(value);
}

const isMap = (value) => Array.isArray(value) && value.length === 6 && typeof value[5] === "string";

// The cells of a GridMap, row by row from its lower left corner: 0 unknown, 1 free, 3 occupied.
function cells([, , , width, height, packed]) {
  const bytes = atob(packed);
  const found = new Uint8Array(Math.max(0, Math.min(width * height, 4 * bytes.length)));
  for (let k = 0; k < found.length; k++) found[k] = (bytes.charCodeAt(k >> 2) >> (2 * (k & 3))) & 3;
  return found;
}

function told(map) {
  const all = cells(map);
  const known = all.reduce((sum, cell) => sum + (cell > 0), 0);
  const part = all.length ? Math.round((100 * known) / all.length) : 0;
  return `${map[3]} × ${map[4]} cells of ${number(map[0])} m, ${part} % known`;
}
