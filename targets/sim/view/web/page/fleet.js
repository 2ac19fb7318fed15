// The dashboard's own parts: robots as a table, log lines, what is wrong in one sentence, and the emergency stop.
"use strict";

const WINDOW = 300; // seconds that the page shows
const HOLD = 1000; // ms for which the stop button must be held
const LINES = 200; // log lines that are shown
const LOW = 0.25, EMPTY = 0.15; // of a battery
let fleet = null, came = 0, linesShown = -1; // the last event, when it came (ms), and how many log lines are shown

// Seconds on the dashboard's clock, also between two events and when no more come.
const present = () => fleet.t + (performance.now() - came) / 1000;
const percent = (share) => (share === null || share === undefined ? "–" : `${number(100 * share, 0)} %`);
const figure = (value, digits) => (typeof value === "number" ? number(value, digits) : "–");
const isSilent = (robot) => robot.at === null || present() - robot.at > fleet.fresh;

function phrase(words, kind) { return make("span", words, kind ? { class: kind } : {}); }

function monitors(robot) {
  if (robot.violated.length) return [`violated: ${robot.violated.join(", ")}`, "bad"];
  const told = Object.entries(robot.properties).map(([outcome, count]) => `${count} ${outcome}`);
  return [told.join(", ") || "none", told.length ? "" : "dim"];
}

function position({ pose }) {
  if (!pose) return ["unknown", "warn"];
  const yaw = pose.yaw === null ? "" : ` ${number((pose.yaw * 180) / Math.PI, 0)}°`;
  const old = pose.age > fleet.fresh ? `, ${number(pose.age, 1)} s old` : "";
  return [`(${pose.position.map((each) => number(each)).join(", ")})${yaw}${old}`, old ? "warn" : ""];
}

// Cells of one robot: [words, class] each.
function robotCells(robot, age) {
  const silent = isSilent(robot), note = [robot.note, silent ? "bad" : "warn"];
  const told = robot.at === null ? ["never", "bad n"] : [number(age, 1), silent ? "bad n" : "n"];
  if (robot.phase === undefined) return [["no answer yet", "bad p"], told, note, ...Array(11).fill(["–", "dim"])];
  const phase = silent ? [`silent (was ${robot.phase})`, "bad p"] : [robot.phase, "p"];
  const power = robot.battery === null ? "n" : robot.battery < EMPTY ? "bad n" : robot.battery < LOW ? "warn n" : "n";
  const runs = robot.release.slice(0, 8) || "no release";
  return [phase, told, note, [percent(robot.battery), power], [robot.odd ? `${runs} differs` : runs, robot.odd ? "bad p" : "p"],
    monitors(robot), position(robot), [String(robot.round), "n"], [percent(robot.current), "n"],
    [percent(robot.loss), robot.loss > 0.2 ? "warn n" : "n"], [figure(robot.late, 0), "n"],
    [figure(robot.host.clock_ms, 2), "n"], [figure(robot.host.disk_gb, 1), "n"], [figure(robot.host.temperature, 0), "n"]];
}

function robotsTable() {
  const rows = fleet.robots.map((robot, pid) => {
    const row = make("tr", undefined, isSilent(robot) ? { class: "silent" } : {}), name = make("td", undefined, { class: "p" });
    name.append(swatch(pid), phrase(model.robots[pid].name));
    row.append(name, ...robotCells(robot, present() - robot.at).map(([words, kind]) => make("td", words, kind ? { class: kind } : {})));
    return row;
  });
  $("robots").replaceChildren(...rows);
}

// State of an application: [words, class].
function applicationState(each) {
  if (each.stopped) return ["stopped", "dim"];
  return each.fault ? [`holds: ${each.fault}`, "bad"] : ["runs", ""];
}

// A row for each application of each robot; hidden if the fleet has only one application.
function applicationsTable() {
  const rows = fleet.robots.flatMap((robot, pid) => (robot.applications || []).map((each) => {
    const row = make("tr", undefined, isSilent(robot) ? { class: "silent" } : {}), name = make("td", undefined, { class: "p" });
    name.append(swatch(pid), phrase(model.robots[pid].name));
    const event = each.event ? `${each.event} (round ${each.event_round})` : "none yet", faults = each.counts.faults || 0;
    const cells = [[each.name, "p"], [`${each.pid} of ${each.members.length}`, "n"], [String(each.round), "n"], [event, "p"],
      [String(faults), faults ? "warn n" : "n"], applicationState(each)];
    row.append(name, ...cells.map(([words, kind]) => make("td", words, kind ? { class: kind } : {})));
    return row;
  }));
  $("parts").hidden = !rows.length;
  $("applications").replaceChildren(...rows);
}

// One sentence on the whole fleet; what is wrong comes first.
function summary() {
  const named = (test) => fleet.robots.map((robot, pid) => [robot, model.robots[pid].name]).filter(([robot]) => test(robot)).map(([, name]) => name);
  const known = (test) => named((robot) => robot.phase !== undefined && test(robot));
  const parts = [];
  const tell = (words, names) => names.length && parts.push([`${words} ${names.join(", ")}`, "bad"]);
  const late = (performance.now() - came) / 1000;
  if (late > 1.5) parts.push([`This page is ${number(late, 0)} s old: no connection to the dashboard`, "bad"]);
  tell("silent:", named(isSilent));
  tell("violated:", known((robot) => robot.violated.length));
  tell("another release:", known((robot) => robot.odd));
  tell("battery low:", known((robot) => robot.battery !== null && robot.battery < LOW));
  tell("position unknown:", known((robot) => !robot.pose));
  const phases = new Map();
  for (const robot of fleet.robots)
    if (!isSilent(robot)) phases.set(robot.phase, (phases.get(robot.phase) || 0) + 1);
  const well = [...phases].map(([phase, count]) => `${count} ${phase}`).join(", ") || "none answers";
  parts.push([`${fleet.robots.length} robots: ${well}`, ""]);
  $("summary").replaceChildren(...parts.map(([words, kind]) => phrase(words, kind)));
}

function linesTable() {
  const all = model.robots.flatMap((robot) => robot.logs.map((row) => [row, robot])), count = all.length && all.length + model.last;
  if (count === linesShown) return;
  linesShown = count;
  all.sort(([a], [b]) => b[1] - a[1]);
  $("lines").replaceChildren(...all.slice(0, LINES).map(([[, t, level, words], robot]) => {
    const kind = level === "error" ? "bad" : level === "warning" ? "warn" : "dim";
    const at = new Date(1000 * (fleet.wall - fleet.t + t)).toLocaleTimeString([], { hour12: false });
    return cellsOf(make("tr"), [at, robot.name, level, words], ["n", "p", kind + " p", ""]);
  }));
}

function showFleet() {
  for (const [pid, robot] of model.robots.entries()) robot.silent = isSilent(fleet.robots[pid]);
  robotsTable();
  applicationsTable();
  summary();
}

function hearFleet(event) {
  fleet = JSON.parse(event.data);
  if (fleet.version !== given.version) return location.reload(); // the dashboard knows more of the fleet, or is another
  came = performance.now();
  if (model.last - model.first > 1.1 * WINDOW) model.forget(model.last - WINDOW);
  model.first = Math.max(model.first, model.last - 1.1 * WINDOW);
  showFleet();
  linesTable();
  state.moved = true;
}

// ---- emergency stop

function stopTold(robots, by) {
  const rows = [...robots].sort((a, b) => a.answered - b.answered).map((robot) => {
    const phase = robot.phase === "stopped" ? "has stopped" : "is stopping";
    const words = robot.answered ? `${robot.robot} ${phase}, answered after ${number(robot.after_ms, 0)} ms` : `${robot.robot}: ${robot.note}. STOP IT BY HAND: remote control, kill switch, or cut its power`;
    return make("li", [words, robot.answered ? robot.note : ""].filter(Boolean).join("; "), { class: robot.answered ? "good" : "bad" });
  });
  const list = make("ul"), silent = robots.filter((robot) => !robot.answered).length;
  list.append(...rows);
  const head = silent ? `Emergency stop: ${silent} of ${robots.length} robots did NOT answer` : `Emergency stop: all ${robots.length} robots answered`;
  const close = make("button", "close");
  close.onclick = () => $("stopped").replaceChildren();
  $("stopped").replaceChildren(phrase(`${head} (asked from ${by}) `, silent ? "bad" : "good"), close, list);
}

async function stopAll() {
  const button = $("stop");
  button.disabled = true;
  $("stopped").replaceChildren(phrase("Stopping …", "bad"));
  try {
    const headers = { "Content-Type": "application/json", "X-Koordgen-Token": given.token };
    const answer = await fetch("control", { method: "POST", headers, body: JSON.stringify({ do: "stop" }), signal: AbortSignal.timeout(10000) });
    if (!answer.ok) throw new Error(`the dashboard answered ${answer.status}`);
    stopTold((await answer.json()).robots, "here");
  } catch (error) {
    $("stopped").replaceChildren(phrase(`NOT STOPPED: ${error.message}. Stop the robots by hand, now: remote control, kill switch, or cut their power`, "bad"));
  }
  button.disabled = false;
}

// A click, a brush of a sleeve or a double tap does nothing: the button must be held.
function holdToStop(button) {
  let timer = 0;
  const release = () => { clearTimeout(timer); timer = 0; button.classList.remove("held"); };
  const press = () => {
    if (timer || button.disabled) return;
    button.classList.add("held");
    timer = setTimeout(() => { release(); stopAll(); }, HOLD);
  };
  button.onpointerdown = (event) => { if (event.isPrimary && event.button === 0) press(); };
  for (const name of ["pointerup", "pointercancel", "pointerleave", "blur"]) button.addEventListener(name, release);
  button.onkeydown = (event) => { if (!event.repeat && [" ", "Enter"].includes(event.key)) press(); };
  button.onkeyup = release;
  button.oncontextmenu = (event) => event.preventDefault(); // a long touch
}

document.querySelector(".views").after($("fleet"), $("parts"), $("said"));
source.addEventListener("fleet", hearFleet);
source.addEventListener("stopped", (event) => { const { robots, by } = JSON.parse(event.data); stopTold(robots, by); });
setInterval(() => fleet && showFleet(), 250);
if ($("stop")) holdToStop($("stop"));
