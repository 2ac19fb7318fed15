// The controls of a live run: pause, step, speed, and faults by hand. The run judges each command, and says what became
// of it in an event `control`.
"use strict";

const RUN_CLOCK = "only with --lockstep: in real time the robots' own clocks go on";
const FOLLOWS = "a run that follows a counterexample takes no faults";
const run = { paused: false };
const field = (name) => $(`fault-${name}`);

function say(words, bad) {
  $("run-said").textContent = words;
  $("run-said").className = bad ? "bad" : "";
}

async function command(what) {
  const headers = { "Content-Type": "application/json", "X-Koordgen-Token": given.control.token };
  try {
    const answer = await fetch("control", { method: "POST", headers, body: JSON.stringify(what) });
    if (!answer.ok) say(`refused: ${answer.statusText}`, true);
  } catch (error) {
    say("no connection to the run", true);
  }
}

// The number in a field; one that is none is marked, and nothing is sent.
function amount(name, scale = 1) {
  const value = field(name).value.trim().replace(",", "."), found = value === "" ? NaN : Number(value) / scale;
  if (Number.isFinite(found)) return found;
  throw new Error(`${field(name).getAttribute("aria-label") || name}: ${value || "nothing"} is no number`);
}

const vector = (name) => ["x", "y", "z"].map((axis) => amount(`${name}-${axis}`));
const pair = () => [field("one").value, field("other").value];

// Each button's event as a scenario file has it; `true`: it lasts as long as the field beside says.
const FAULTS = {
  crash: [() => field("robot").value, true],
  restart: [() => field("robot").value, false],
  freeze: [() => field("robot").value, true],
  continue: [() => field("robot").value, false],
  cut: [pair, true],
  restore: [pair, false],
  network: [() => ({ loss: amount("loss", 100), delay: amount("delay") }), true],
  wind: [() => ({ mean: vector("wind"), gust: amount("gust") }), true],
  obstacle: [() => ({ number: Number(field("number").value), by: vector("by") }), false],
  positioning: [() => ({ robot: field("lost").value, bias: vector("bias"), dropout: amount("dropout", 100) }), true],
  lag: [() => ({ robot: field("slow").value, seconds: amount("seconds") }), true],
  battery: [() => ({ robot: field("empty").value, level: amount("level", 100) }), false],
};

function fault(kind) {
  const [made, lasts] = FAULTS[kind];
  try {
    const event = { [kind]: made() };
    if (lasts && field("for").value.trim()) event.for = amount("for");
    command({ do: "fault", event });
  } catch (error) {
    say(error.message, true);
  }
}

function disable(element, why) {
  element.disabled = true;
  element.title = why;
}

function controlled({ paused, factor, message, bad }) {
  run.paused = paused;
  $("run-pause").textContent = paused ? "go on" : "pause";
  $("run-pause").classList.toggle("paused", paused);
  const value = factor === null ? "" : String(factor), speed = $("run-speed");
  if (![...speed.options].some((option) => option.value === value)) speed.append(make("option", `${value} × real time`, { value }));
  speed.value = value;
  if (message) say(message, bad);
  else if (paused) say("paused", false);
  else if (!bad && $("run-said").textContent === "paused") say("", false);
}

function ended() {
  for (const element of document.querySelectorAll("#controls button, #controls select, #controls input")) disable(element, "the run is over");
  say("", false);
}

function offer() {
  const robots = given.control.robots || model.robots.map((robot) => robot.name); // in a run with squads, all physical robots
  for (const name of ["robot", "one", "other", "lost", "slow", "empty"]) field(name).replaceChildren(...robots.map((robot) => make("option", robot)));
  if (robots.length > 1) field("other").selectedIndex = 1;
  field("number").replaceChildren(...(model.header.obstacles || []).map((obstacle, k) => make("option", String(k), { value: k })));
  $("run-pause").onclick = () => command({ do: run.paused ? "go" : "pause" });
  $("run-step").onclick = () => command({ do: "step" });
  $("run-speed").onchange = () => command({ do: "speed", factor: $("run-speed").value ? Number($("run-speed").value) : null });
  for (const kind of Object.keys(FAULTS)) field(kind).onclick = () => fault(kind);
  if (!given.control.lockstep) $("run-speed").options[0].textContent = "1 × real time";
  if (!given.control.lockstep) for (const id of ["run-pause", "run-step", "run-speed"]) disable($(id), RUN_CLOCK);
  if (!given.control.faults) for (const kind of Object.keys(FAULTS)) disable(field(kind), FOLLOWS);
  if (robots.length < 2) for (const kind of ["cut", "restore"]) disable(field(kind), "there is one robot, and no link");
  if (!field("number").options.length) disable(field("obstacle"), "this world has no obstacles");
}

offer();
