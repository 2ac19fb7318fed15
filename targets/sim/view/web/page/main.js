// The page: player, charts, tables; of a report, or live by server-sent events. What a trace says is only ever text.
"use strict";

const given = JSON.parse(document.getElementById("data").textContent);
const model = new Model(given.header);
const $ = (id) => document.getElementById(id);
const state = { now: 0, playing: false, unfolded: false, live: Boolean(given.live), zoom: 1, moved: true, due: 0 };
const charts = {};
let source = null; // of a live page's events

function make(tag, words, attributes = {}) {
  const element = document.createElement(tag);
  if (words !== undefined) element.textContent = words;
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}

function span() {
  const whole = model.last - model.first, wide = whole / state.zoom;
  if (state.zoom === 1) return [model.first, model.last];
  const from = Math.max(model.first, Math.min(state.now - wide / 2, model.last - wide));
  return [from, from + wide];
}

function seek(t) {
  state.now = Math.max(model.first, Math.min(model.last, t));
  state.moved = true;
}

// ---- robots to show

function chips() {
  for (const holder of document.querySelectorAll(".chips.robots")) {
    holder.replaceChildren(...model.robots.map((robot) => {
      const label = make("label", undefined, { title: `${robot.name}, ${robot.target}: click to hide or show` });
      const box = make("input", undefined, { type: "checkbox" });
      box.checked = robot.shown;
      label.classList.toggle("off", !robot.shown);
      box.onchange = () => { robot.shown = box.checked; state.moved = true; chips(); };
      label.append(box, swatch(robot.pid), make("span", robot.name));
      return label;
    }));
  }
}

function swatch(pid) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg"), line = document.createElementNS(svg.namespaceURI, "line");
  svg.setAttribute("viewBox", "0 0 36 10");
  const look = { x1: 1, y1: 5, x2: 35, y2: 5, stroke: colour(pid), "stroke-width": 3, "stroke-dasharray": dash(pid).join(" ") };
  for (const [key, value] of Object.entries(look)) line.setAttribute(key, value);
  svg.append(line);
  return svg;
}

function eventChips() {
  const box = (ink, words) => {
    const label = make("label"), svg = swatch(0);
    svg.firstChild.setAttribute("stroke", ink);
    svg.firstChild.setAttribute("stroke-width", 9);
    label.append(svg, make("span", words));
    return label;
  };
  const key = [...model.events.map((name) => box(eventInk(model, name), name)), box(SKIP, "no event")];
  if (model.robots.some((robot) => robot.rounds.some((row) => row[4] === 2))) key.push(box(RED, "fault"));
  $("events").replaceChildren(...key);
}

// ---- maps

function mapChoices() {
  const choices = [["", "no map"]];
  for (const variable of model.shared.filter((v) => v.type === "GridMap"))
    for (const key of [...variable.series.keys()].sort((a, b) => a - b))
      choices.push([`${variable.name} ${key}`, variable.name + (key >= 0 ? ` of ${(model.robots[key] || {}).name}` : "")]);
  if ($("map").options.length === choices.length) return;
  const before = $("map").value;
  $("map").replaceChildren(...choices.map(([value, words]) => make("option", words, { value })));
  $("map").value = before || (choices[1] || choices[0])[0];
  $("map").hidden = choices.length < 2;
}

function chosenMap() {
  const [name, key] = $("map").value.split(" ");
  const variable = name && model.shared.find((each) => each.name === name);
  const found = variable && model.value(variable.series.get(Number(key)), state.now);
  return found && found.value;
}

// ---- the map in three dimensions

// Switches the map: to three dimensions, or back to the view from above; `why` there is no way back, if so.
async function deepen(on, why = "") {
  try {
    if (on) await loadThree();
    if (on && !state.space) state.space = new Space($("space-view"), $("space-names"), model, { moved: () => { state.moved = true; }, lost: () => deepen(false, "the browser has taken WebGL away") });
  } catch (error) {
    [on, why] = [false, `WebGL cannot be used: ${error.message}`];
  }
  state.deep = on;
  $("top").hidden = on;
  for (const id of ["space", "space-bar", "space-help"]) $(id).hidden = !on;
  $("above").setAttribute("aria-pressed", String(!on));
  $("deep").setAttribute("aria-pressed", String(on));
  if (why) shallow(why);
  state.moved = true;
}

function shallow(why) {
  $("deep").disabled = true;
  $("deep").title = $("space-why").textContent = why;
}

function chaseChoices() {
  const choices = [["", "follow no robot"], ...model.robots.map((robot) => [String(robot.pid), `follow ${robot.name}`])];
  if ($("chase").options.length !== choices.length) $("chase").replaceChildren(...choices.map(([value, words]) => make("option", words, { value })));
}

function drawMapView(now, tail, map) {
  const labels = { xlabel: "x, east (m)", ylabel: "y, north (m)" };
  if (!state.deep) return scene($("top"), model, now, { across: 0, up: 1, labels, most: 620, tail, map, unfolded: state.unfolded });
  const chase = model.robots.find((robot) => String(robot.pid) === $("chase").value);
  return state.space.draw(now, { tail, map, chase, unfolded: state.unfolded, height: Math.min(620, 0.75 * $("space").clientWidth) });
}

// ---- tables

function cellsOf(row, values, classes = []) {
  values.forEach((value, k) => row.append(make("td", value, classes[k] ? { class: classes[k] } : {})));
  return row;
}

function whoChoices() {
  const choices = [["", "as written last"], ...model.robots.map((robot) => [String(robot.pid), `as ${robot.name} knew them`])];
  if ($("who").options.length !== choices.length) $("who").replaceChildren(...choices.map(([value, words]) => make("option", words, { value })));
}

// The variables at this time: the last writes, or the locals of one robot and its copy of the shared ones.
function variables() {
  const robot = model.robots.find((each) => String(each.pid) === $("who").value), records = model.header.records || {}, rows = [];
  const add = (name, of, found, type) => {
    const fresh = found && state.now - found.t < 3 * model.header.delta, by = found && (model.robots[found.pid] || robot || {}).name;
    const row = make("tr", undefined, fresh ? { class: "fresh" } : {}), value = found ? shown(found.value, type, records) : "first value";
    rows.push(cellsOf(row, [name, of, value, found ? `${number(found.t)} s, round ${found.round}, ${by}` : "not yet"], ["p", "p", "v", "p"]));
  };
  for (const [name, series] of robot ? robot.locals : []) add(name, "local", model.value(series, state.now), "");
  for (const variable of model.shared) {
    const members = membersOf(variable.name);
    for (const key of variable.kind === "allwrite" ? [-1] : members) {
      const series = variable.series.get(key), found = robot ? model.believed(robot, series, state.now) : model.value(series, state.now);
      add(key < 0 ? variable.name : `${variable.name}[${members.indexOf(key)}]`, key < 0 ? "all" : model.robots[key].name, found, variable.type);
    }
  }
  $("shared").replaceChildren(...rows);
  copies();
}

// The robots that have a slot of an allread variable, by pid in its application: all robots, if the fleet has one program.
function membersOf(variable) {
  const of = (model.header.composition || []).find((each) => variable.startsWith(`${each.name}.`));
  return of ? of.members : model.robots.map((each) => each.pid);
}

// Which robots go by an old copy of the shared variables.
function copies() {
  const old = [], delta = model.header.delta || 0.1;
  for (const robot of model.end === null || state.now <= model.end ? model.robots : []) {
    const seen = model.copied(robot, state.now);
    if (seen && state.now - seen.t > 3 * delta) old.push(`${robot.name} (of ${number(seen.t)} s)`);
  }
  $("copies").textContent = old.length ? `Old copies of the shared variables: ${old.join(", ")}` : "";
}

function writes() {
  const all = [];
  for (const variable of model.shared)
    for (const series of variable.series.values()) for (const write of series) all.push({ ...write, variable });
  all.sort((a, b) => a.t - b.t);
  const shownNow = all.slice(-400);
  $("writes").replaceChildren(...shownNow.map(({ t, round, pid, value, variable }) => {
    const name = variable.kind === "allwrite" ? variable.name : `${variable.name}[${pid}]`;
    return seekable(t, [number(t), String(round), (model.robots[pid] || {}).name, name, shown(value, variable.type, model.header.records)], ["n", "n", "p", "p", "v"]);
  }));
}

function seekable(t, values, classes) {
  const row = make("tr", undefined, { class: "to", tabindex: "0", title: "go there" });
  row.onclick = () => seek(t);
  row.onkeydown = (event) => event.key === "Enter" && seek(t);
  return cellsOf(row, values, classes);
}

function marksTable() {
  const rows = model.marks.map(([t, kind, what, who, detail]) => {
    const row = seekable(t, [number(t), kind, what, who.join(", "), detail], ["n", "p", "p", "", ""]);
    const good = kind === "verdict" && what.endsWith(": held"), bad = kind === "verdict" && /: (violated|no value)$/.test(what);
    row.classList.toggle("bad", kind === "violation" || bad);
    row.classList.toggle("good", good);
    return row;
  });
  $("marks").replaceChildren(...(rows.length ? rows : [cellsOf(make("tr"), ["", "nothing so far"])]));
}

function linksTable() {
  const digits = (value, many = 1) => (typeof value === "number" ? number(value, many) : "–");
  const rows = [];
  for (const robot of model.robots) {
    const row = model.at(robot.links, state.now);
    for (const [peer, loss, p50, p99, silent, repeats] of row ? row[2] : [])
      rows.push(cellsOf(make("tr"), [robot.name, (model.robots[peer] || {}).name, loss === null ? "–" : number(100 * loss, 1) + " %",
        digits(p50), digits(p99), digits(silent), String(repeats ?? "–"), number(row[1], 1)], ["p", "p", "n", "n", "n", "n", "n", "n"]));
  }
  $("links").replaceChildren(...(rows.length ? rows : [cellsOf(make("tr"), ["no figures by then: robots tell them every 10 s"])]));
}

// ---- drawing

function maximum(robot) {
  const seconds = robot.shown ? robot.late : [], at = ([, t, worst]) => [t + 0.5, 1000 * worst];
  const dots = seconds.filter((row) => row[4] > 0).map(at);
  return { points: seconds.map(at), ink: colour(robot.pid), lines: dash(robot.pid), dots };
}

function draw() {
  const now = state.now, at = span(), tail = Number($("tail").value), map = chosenMap();
  drawMapView(now, tail, map);
  const across = Number($("side-axis").value), side = { xlabel: across ? "y, north (m)" : "x, east (m)", ylabel: "z, up (m)" };
  scene($("side"), model, now, { across, up: 2, labels: side, most: 260, tail, unfolded: state.unfolded });
  for (const axis of ["x", "y", "z"]) charts[axis] = coordinate($(`${axis}-t`), model, axis, at, now, 190);
  charts.timeline = timeline($("timeline"), model, at, now);
  const asked = model.header.min_separation || 0;
  const near = model.near.filter(([t]) => t >= at[0] - 1 && t <= at[1] + 1), each = Math.max(1, Math.floor(near.length / 2000));
  charts.near = lines($("near"), model, at, now, 170, [{ points: near.filter((_, k) => k % each === 0).map(([t, d]) => [t, d]), ink: COLOURS[0] }],
    { ylabel: "closest pair (m)", bound: asked, crossed: model.near.some(([, d]) => d < asked), words: `at least ${asked} m asked` });
  const half = 500 * (model.header.delta || 0.1);
  charts.late = lines($("late"), model, at, now, 170, model.robots.map(maximum), { ylabel: "latest round (ms)", bound: half, words: `late: over ${number(half, 0)} ms` });
  const loss = (robot) => robot.links.map(([, t, peers]) => [t, 100 * Math.max(0, ...peers.map((peer) => peer[1] || 0))]);
  charts.loss = lines($("loss"), model, at, now, 150, model.robots.filter((r) => r.shown).map((robot) => ({ points: loss(robot), ink: colour(robot.pid), lines: dash(robot.pid), step: true })),
    { ylabel: "worst loss (%)" });
  closest();
  $("time").textContent = `${number(now)} s`;
  if (document.activeElement !== $("scrub") || state.playing || state.live) $("scrub").value = now;
}

function closest() {
  const row = model.at(model.near, state.now, 0);
  const name = (who) => (typeof who === "string" ? who : model.robots[who].name); // robots of squads are named
  $("closest").textContent = row ? `closest: ${name(row[2])} and ${name(row[3])}, ${number(row[1])} m` : "";
  const told = ["violation", "cause", "monitor"], recent = ([t, kind]) => told.includes(kind) && t <= state.now && t > state.now - 3;
  const found = model.marks.filter(recent).slice(-2);
  $("alarm").textContent = found.map(([, kind, what, who]) => `${kind}: ${what} ${who.join(", ")}`).join("; ");
  $("alarm").className = found.some(([, kind]) => kind === "violation") ? "bad" : "";
}

// What changes only when rows came.
function refresh() {
  for (const key of ["min", "max"]) $("scrub")[key] = key === "min" ? model.first : model.last;
  mapChoices();
  whoChoices();
  chaseChoices();
  $("unfold").hidden = !model.robots.some((robot) => robot.members.size);
  eventChips();
  marksTable();
  if ($("history").open) writes();
  state.moved = true;
}

let before = 0;
function tick(time) {
  const passed = Math.min(0.25, (time - before) / 1000);
  before = time;
  if (state.live) seek(model.last);
  else if (state.playing) {
    seek(state.now + passed * Number($("speed").value));
    if (state.now >= model.last) play(false);
  }
  if (state.moved && !document.hidden) {
    draw();
    state.moved = false;
    if (time > state.due) { variables(); linksTable(); state.due = time + 150; }
    else setTimeout(() => { state.moved = true; }, 160);
  }
  requestAnimationFrame(tick);
}

function play(on) {
  if (on && state.now >= model.last) seek(model.first < 0 ? 0 : model.first);
  state.playing = on;
  $("play").textContent = on ? "❚❚" : "▶";
  $("play").setAttribute("aria-label", on ? "pause" : "play");
  if (on) follow(false);
}

function follow(on) {
  state.live = on;
  $("follow").disabled = on;
}

// ---- live

function listen() {
  source = new EventSource("events");
  const hear = (name, act) => source.addEventListener(name, (event) => { act(JSON.parse(event.data)); refresh(); });
  $("status").textContent = "connecting";
  source.onopen = () => { $("status").textContent = ""; };
  source.onerror = () => { $("status").textContent = "no connection to the run"; };
  hear("whole", (chunk) => { Object.assign(model, new Model(given.header)); chips(); model.extend(chunk); });
  hear("rows", (chunk) => model.extend(chunk));
  if (given.control) hear("control", controlled);
  hear("over", ({ words }) => { source.close(); follow(false); $("status").textContent = words; if (given.control) ended(); });
}

function wire() {
  $("play").onclick = () => play(!state.playing);
  $("scrub").oninput = () => { play(false); follow(false); seek(Number($("scrub").value)); };
  $("follow").onclick = () => { play(false); follow(true); };
  $("in").onclick = () => { state.zoom = Math.min(64, state.zoom * 2); state.moved = true; };
  $("out").onclick = () => { state.zoom = Math.max(1, state.zoom / 2); state.moved = true; };
  $("above").onclick = () => deepen(false);
  $("deep").onclick = () => deepen(true);
  $("unfold").onclick = () => {
    state.unfolded = !state.unfolded;
    $("unfold").setAttribute("aria-pressed", String(state.unfolded));
    state.moved = true;
  };
  $("whole").onclick = () => { $("chase").value = ""; state.space.look(); state.moved = true; };
  $("space-view").onpointermove = (event) => tip(event, state.space && !event.buttons ? state.space.hovered(event.offsetX, event.offsetY) : "");
  $("space-view").onpointerleave = () => tip(null, "");
  for (const id of ["tail", "map", "side-axis", "who", "chase"]) $(id).onchange = () => { state.moved = true; };
  $("history").ontoggle = () => $("history").open && writes();
  for (const [name, id] of Object.entries({ x: "x-t", y: "y-t", z: "z-t", timeline: "timeline", near: "near", late: "late", loss: "loss" }))
    $(id).onclick = (event) => { play(false); follow(false); seek(charts[name].time(event.offsetX)); };
  $("timeline").onmousemove = (event) => tip(event, hovered(model, charts.timeline, event.offsetX, event.offsetY));
  $("timeline").onmouseleave = () => tip(null, "");
  window.onresize = () => { state.moved = true; };
  document.onkeydown = (event) => {
    if (["INPUT", "SELECT", "BUTTON"].includes(event.target.tagName)) return;
    if (event.key === " ") { event.preventDefault(); play(!state.playing); }
    else if (event.key === "ArrowLeft" || event.key === "ArrowRight") { follow(false); seek(state.now + (event.key === "ArrowLeft" ? -1 : 1)); }
  };
}

function tip(event, words) {
  $("tip").hidden = !words;
  if (!words) return;
  $("tip").textContent = words;
  $("tip").style.left = Math.min(event.clientX + 14, window.innerWidth - $("tip").offsetWidth - 10) + "px";
  $("tip").style.top = Math.min(event.clientY + 14, window.innerHeight - $("tip").offsetHeight - 10) + "px";
}

model.extend(given.rows || {});
chips();
wire();
const lacking = noSpace();
if (lacking) shallow(lacking);
refresh();
const asked = /^#t=(-?[0-9.]+)$/.exec(location.hash); // so that a link can name a moment
const violated = model.marks.find(([, kind]) => kind === "violation");
seek(asked ? Number(asked[1]) : state.live ? model.last : violated ? violated[0] : 0);
$("follow").hidden = !given.live;
if (given.live) listen();
requestAnimationFrame(tick);
