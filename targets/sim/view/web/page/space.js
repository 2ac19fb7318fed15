// The fleet in three dimensions, by three.js (vendor/): metres, local ENU, z up. A second canvas above it has the names,
// the numbers along the axes, and the alarms. What stands is built once; what moves is made anew for each picture.
"use strict";

const LEAST = 26; // pixels that a robot measures at least, however far the camera is
const OUTLOOK = [-0.45, -1, 0.75]; // from the middle of the room to the camera, at first
const LIFT = 0.1; // metres from a robot's reference point up to its lidar, about the middle of its body
const TRAIL_POINTS = 600;

// The reason why this browser cannot show the 3D map; "" if it can.
function noSpace() {
  if (typeof DecompressionStream === "undefined") return "this browser is too old for the 3D map";
  const context = document.createElement("canvas").getContext("webgl2");
  if (!context) return "this browser has no WebGL 2";
  const extension = context.getExtension("WEBGL_lose_context");
  if (extension) extension.loseContext(); // browsers give only some
  return "";
}

// Unpacks three.js and runs it, as a script of its own, which the page's policy knows by its digest.
async function loadThree() {
  if (typeof THREE !== "undefined") return;
  const packed = Uint8Array.from(atob($("three").textContent), (letter) => letter.charCodeAt(0));
  const plain = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const script = document.createElement("script");
  script.textContent = await new Response(plain).text();
  document.body.append(script);
}

class Space {
  // `lost` is called when the browser takes WebGL away, `moved` when the camera has moved.
  constructor(canvas, flat, model, { moved, lost }) {
    Object.assign(this, { canvas, flat, model, chased: null, placed: [], steered: false });
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.renderer.setClearColor("#ffffff");
    canvas.addEventListener("webglcontextlost", lost);
    this.camera = new THREE.PerspectiveCamera(40, 1, 0.1, 1000);
    this.camera.up.set(0, 0, 1);
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.controls.screenSpacePanning = false; // along the ground
    this.controls.maxPolarAngle = 0.499 * Math.PI; // not from below the ground
    this.controls.addEventListener("change", moved);
    this.controls.addEventListener("start", () => { this.steered = true; }); // by the user
    this.world = new THREE.Scene();
    const sun = new THREE.DirectionalLight("#ffffff", 1.6);
    sun.position.set(-1, -2, 4);
    this.world.add(new THREE.HemisphereLight("#ffffff", "#b8b8c0", 2.1), sun);
    this.standing = this.moving = null;
    this.look();
  }

  // The whole room, from the south and above.
  look() {
    const [low, high] = view(this.model, room(this.model), 2), middle = low.map((v, k) => (v + high[k]) / 2);
    const size = Math.hypot(...high.map((v, k) => v - low[k])), far = (0.46 * size) / Math.sin(0.5 * this.camera.fov * (Math.PI / 180));
    const long = Math.hypot(...OUTLOOK);
    this.controls.target.set(middle[0], middle[1], low[2]);
    this.camera.position.set(...OUTLOOK.map((v, k) => (k < 2 ? middle[k] : low[2]) + (v / long) * far));
    Object.assign(this.camera, { near: far / 200, far: far * 20 });
    Object.assign(this.controls, { minDistance: far / 60, maxDistance: far * 4 });
    Object.assign(this, { chased: null, steered: false });
    this.controls.update();
  }

  draw(now, { tail, map, chase, height, unfolded }) {
    const width = Math.max(60, this.flat.clientWidth), area = pen(this.flat, height);
    this.renderer.setPixelRatio(window.devicePixelRatio || 1);
    this.renderer.setSize(width, height, false);
    this.canvas.style.height = height + "px";
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this._stand(now);
    this._chase(chase && this.model.pose(chase, now));
    this.controls.update();
    this.camera.updateMatrixWorld();
    this._replace("moving", this._moving(now, tail, map, [width, height], unfolded));
    this.renderer.render(this.world, this.camera);
    this._words(area, now);
  }

  // Builds what stands in the room, when an obstacle has moved or the room has grown.
  _stand(now) {
    const obstacles = this.model.obstacles(now), walls = room(this.model).join(), before = this.obstacles;
    if (walls !== this.walls && this.walls && !this.steered) this.look();
    if (walls === this.walls && obstacles.length === before.length && obstacles.every((each, k) => each === before[k])) return;
    this._replace("standing", standing(this.model, obstacles));
    Object.assign(this, { obstacles, walls });
  }

  // The camera goes along with a robot.
  _chase(pose) {
    if (!pose) { this.chased = null; return; }
    const before = this.chased || this.controls.target.toArray(), by = [0, 1, 2].map((k) => pose[k] - before[k]);
    for (const each of [this.camera.position, this.controls.target]) each.set(each.x + by[0], each.y + by[1], each.z + by[2]);
    this.chased = pose.slice(0, 3);
  }

  _replace(name, group) {
    if (this[name]) {
      this.world.remove(this[name]);
      this[name].traverse(discard);
    }
    this[name] = group;
    this.world.add(group);
  }

  _moving(now, tail, map, size, unfolded) {
    const group = new THREE.Group(), model = this.model;
    if (isMap(map) && map[3]) group.add(this._grid(map));
    for (const marker of model.markers.filter(Boolean)) group.add(place(model, marker, now));
    this.placed = [];
    for (const robot of model.drawn(unfolded)) {
      const pose = model.pose(robot, now);
      if (!pose) continue;
      if (tail > 10) group.add(gone(robot, -Infinity, now, { width: 1.4, alpha: 0.45 }));
      if (tail > 0) group.add(gone(robot, now - Math.min(10, tail), now, { width: 3, alpha: 0.95 }));
      const pixel = this._metres(pose, size[1]), scale = Math.max(1, (LEAST * pixel) / 0.5), figure = vehicle(robot);
      figure.position.set(...pose.slice(0, 3));
      figure.rotation.z = pose[3];
      figure.scale.setScalar(scale);
      const seen = robot.unfolded ? [] : [figure, ...below(pose, scale)];
      for (const each of [...seen, ...wanted(model, robot, now, pose), ...scanned(model, robot, now)]) group.add(each);
      this.placed.push({ robot, pose, beside: Math.max(0, (0.2 * scale) / pixel - 12), ...this._pixel(pose, size) });
    }
    return group;
  }

  // A GridMap on the ground; its image stays as long as the map does.
  _grid(map) {
    const [size, x, y, width, height] = map, sharp = { magFilter: THREE.NearestFilter, minFilter: THREE.NearestFilter, generateMipmaps: false };
    if (this.map !== map) {
      if (this.map) this.sheet.map.dispose();
      this.sheet = this.sheet || new THREE.MeshBasicMaterial({ transparent: true, ...behind(1) });
      this.sheet.map = Object.assign(new THREE.CanvasTexture(mapImage(map)), { ...sharp, colorSpace: THREE.SRGBColorSpace });
      this.map = map;
    }
    const found = new THREE.Mesh(new THREE.PlaneGeometry(width * size, height * size), this.sheet);
    found.position.set((x + width / 2) * size, (y + height / 2) * size, 0);
    return found;
  }

  // How many metres a pixel is at a place.
  _metres(at, height) {
    const away = this.camera.position.distanceTo(new THREE.Vector3(at[0], at[1], at[2]));
    return (2 * away * Math.tan(0.5 * this.camera.fov * (Math.PI / 180))) / height;
  }

  // Where a place is in the picture; `ahead`: in front of the camera.
  _pixel([x, y, z], [width, height]) {
    const at = new THREE.Vector3(x, y, z).project(this.camera);
    return { px: ((at.x + 1) / 2) * width, py: ((1 - at.y) / 2) * height, ahead: at.z < 1 };
  }

  _words(area, now) {
    const chart = { ...area, left: 0, right: 0, top: 0, bottom: 0 }, size = [area.width, area.height];
    const [low, high] = room(this.model), eye = this.camera.position;
    const south = Math.abs(eye.y - low[1]) < Math.abs(eye.y - high[1]), west = Math.abs(eye.x - low[0]) < Math.abs(eye.x - high[0]);
    const most = Math.max(high[0] - low[0], high[1] - low[1]);
    const along = (axis, title) => {
      const step = ticks(0, most, 8), { at, digits } = ticks(low[axis], high[axis], (8 * (high[axis] - low[axis])) / most), out = 0.04 * most, z = Math.min(0, low[2]);
      const spot = (v, far) => (axis ? [west ? low[0] - far : high[0] + far, v, z] : [v, south ? low[1] - far : high[1] + far, z]);
      const write = (words, v, far) => {
        const { px, py, ahead } = this._pixel(spot(v, far), size);
        if (ahead) text(chart.ctx, words, px, py, { align: "center", base: "middle", ink: DIM });
      };
      if (step.at.length) for (const v of at) write(number(v, digits), v, out);
      write(title, (low[axis] + high[axis]) / 2, 3 * out);
    };
    along(0, "x, east (m)");
    along(1, "y, north (m)");
    const seen = this.placed.filter((each) => each.ahead);
    alarms(chart, this.model, now, seen);
    names(chart, seen.map(({ robot, px, py, beside }) => ({ robot, px: px + beside, py: py - beside })));
  }

  // Name, position and heading of the robot near a pixel; "" if there is none.
  hovered(px, py) {
    const near = (each) => Math.hypot(each.px - px, each.py - py), [best] = this.placed.filter((each) => each.ahead && near(each) < 18).sort((a, b) => near(a) - near(b));
    if (!best) return "";
    const [x, y, z, yaw] = best.pose, degrees = ((yaw * 180) / Math.PI % 360 + 360) % 360;
    return `${best.robot.name}: (${[x, y, z].map((v) => number(v)).join(", ")}) m, heading ${number(degrees, 0)}° from east`;
  }
}

function discard(object) {
  if (object.geometry && !object.geometry.kept) object.geometry.dispose();
}

// The material of a look, made once: a shader whose last material goes is compiled anew.
function paint(kind, look) {
  const key = kind + JSON.stringify(look);
  paint.made = paint.made || new Map();
  if (!paint.made.has(key)) paint.made.set(key, new THREE[kind](look));
  return paint.made.get(key);
}

// ---- what stands

function standing(model, obstacles) {
  const group = new THREE.Group(), [low, high] = room(model), { arena } = model.header.world || {};
  group.add(ground(low, high));
  if (arena) group.add(edges(arena.lo, arena.hi, { color: STONE_EDGE }));
  if (model.header.geofence) group.add(edges(...model.header.geofence, { color: DIM, lines: true }));
  for (const obstacle of obstacles) group.add(...stone(obstacle));
  return group;
}

// The floor of the room with a line every so many metres.
function ground([x0, y0], [x1, y1]) {
  const points = [], group = new THREE.Group(), step = Math.max(x1 - x0, y1 - y0);
  for (const x of ticks(x0, x1, (16 * (x1 - x0)) / step).at) points.push(x, y0, 0, x, y1, 0);
  for (const y of ticks(y0, y1, (16 * (y1 - y0)) / step).at) points.push(x0, y, 0, x1, y, 0);
  const floor = new THREE.Mesh(new THREE.PlaneGeometry(x1 - x0, y1 - y0), paint("MeshBasicMaterial", { color: "#f6f6f7", ...behind(3) }));
  floor.position.set((x0 + x1) / 2, (y0 + y1) / 2, 0);
  group.add(floor, new THREE.LineSegments(bare(points), paint("LineBasicMaterial", { color: LINE, ...behind(2) })));
  return group;
}

// Flat things on the ground in the order that is wanted, although they are at one height.
function behind(steps) {
  return { polygonOffset: true, polygonOffsetFactor: steps, polygonOffsetUnits: steps, depthWrite: false };
}

function bare(numbers) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(numbers), 3));
  return geometry;
}

// The twelve edges of a box.
function edges(lo, hi, { color, lines }) {
  const points = [], corner = (k) => [0, 1, 2].map((axis) => (k & (1 << axis) ? hi : lo)[axis]);
  for (let k = 0; k < 8; k++) for (const bit of [1, 2, 4]) if (!(k & bit)) points.push(...corner(k), ...corner(k | bit));
  return strokes(points, { color, width: 1.3, lines: lines ? [0.3, 0.2] : [] });
}

// Line segments, `width` pixels wide, `lines` the lengths (m) of a dash and of a gap.
function strokes(points, { color, width, lines = [], alpha = 1 }) {
  const look = { color, linewidth: width, transparent: alpha < 1, opacity: alpha, depthWrite: alpha === 1 };
  const dashes = lines.length ? { dashed: true, dashSize: lines[0], gapSize: lines[1] } : {};
  const found = new THREE.LineSegments2(new THREE.LineSegmentsGeometry(), paint("LineMaterial", { ...look, ...dashes }));
  found.visible = points.length > 0;
  if (found.visible) found.geometry.setPositions(points);
  if (found.visible && lines.length) found.computeLineDistances();
  return found;
}

// From corners of a line to its segments.
function chained(points) {
  return points.slice(1).flatMap((point, k) => [...points[k], ...point]);
}

function stone(obstacle) {
  const { shape, lo, hi, centre, base, radius, height } = obstacle;
  let solid, at = [0, 0, 0], turned = 0;
  if (shape === "box") {
    solid = new THREE.BoxGeometry(...hi.map((v, k) => v - lo[k]));
    at = hi.map((v, k) => (v + lo[k]) / 2);
  } else if (shape === "sphere") [solid, at] = [new THREE.SphereGeometry(radius, 32, 20), centre];
  else if (shape === "cylinder") {
    solid = new THREE.CylinderGeometry(radius, radius, height, 40);
    at = [base[0], base[1], base[2] + height / 2];
    turned = Math.PI / 2; // three's cylinders stand along y
  } else solid = bare((obstacle.faces || []).flat().flatMap((i) => obstacle.vertices[i]));
  if (!solid.getAttribute("normal")) solid.computeVertexNormals();
  const look = { color: STONE, transparent: true, opacity: 0.82, side: shape === "mesh" ? THREE.DoubleSide : 0 };
  const found = [new THREE.Mesh(solid, paint("MeshLambertMaterial", look))];
  if (shape !== "sphere") found.push(new THREE.LineSegments(new THREE.EdgesGeometry(solid, 25), paint("LineBasicMaterial", { color: STONE_EDGE })));
  for (const each of found) { each.position.set(...at); each.rotation.x = turned; }
  return found;
}

// ---- what moves

function place(model, marker, now) {
  const state = (model.at(marker.states, now, 0) || [0, 0])[1], [color] = STATES[state] || STATES[0];
  const look = { color, transparent: true, opacity: [0.3, 0.5, 0.85][state] || 0.3, depthWrite: false };
  const found = new THREE.Mesh(new THREE.SphereGeometry(marker.radius || 0.2, 24, 16), paint("MeshLambertMaterial", look));
  found.position.set(...marker.position);
  return found;
}

// The way that a robot has gone between two times.
function gone(robot, from, to, { width, alpha }) {
  const first = Math.max(0, upTo(robot.t, from)), last = upTo(robot.t, to), points = [];
  const each = Math.max(1, Math.floor((last - first) / TRAIL_POINTS));
  for (let k = first; k <= last; k += each) points.push([robot.x[k], robot.y[k], robot.z[k] + 0.02]);
  return strokes(chained(points), { color: colour(robot.pid), width, alpha, lines: dash(robot.pid).slice(0, 2).map((v) => v / 40) });
}

// Where a robot was told to go, as in the view from above.
function wanted(model, robot, now, pose) {
  const points = pathAhead(model, robot, now, pose), color = colour(robot.pid);
  if (!points) return [];
  const [x, y, z] = points[points.length - 1], arm = 0.13, cross = [];
  for (const [i, j] of [[1, 1], [1, -1]]) cross.push(x - arm * i, y - arm * j, z + 0.02, x + arm * i, y + arm * j, z + 0.02);
  const way = points.map((point) => [point[0], point[1], point[2] + 0.02]);
  return [strokes(chained(way), { color, width: 1.6, lines: [0.06, 0.08] }), strokes(cross, { color, width: 2.2 })];
}

// The points that a robot's lidar met last, at about its height.
function scanned(model, robot, now) {
  const row = model.at(robot.scans, now), points = [];
  if (!row) return [];
  const [x, y, z] = row[2];
  for (let k = 0; k + 1 < row[3].length; k += 2) points.push(x + row[3][k] / 100, y + row[3][k + 1] / 100, z + LIFT);
  const look = { color: colour(robot.pid), size: 4 * (window.devicePixelRatio || 1), sizeAttenuation: false };
  return [new THREE.Points(bare(points), paint("PointsMaterial", look))];
}

// A shadow on the ground, and for one in the air a line down to it.
function below([x, y, z], scale) {
  const shadow = new THREE.Mesh(new THREE.CircleGeometry(0.2 * scale, 24), paint("MeshBasicMaterial", { color: "#000", transparent: true, opacity: 0.16, ...behind(0) }));
  shadow.position.set(x, y, 0.005);
  return z < 0.1 ? [shadow] : [shadow, new THREE.LineSegments(bare([x, y, 0, x, y, z]), paint("LineBasicMaterial", { color: "#b0b0b6" }))];
}

// A robot's body, heading along x: a quadrotor with its nose, or a car. One that is silent is faint: it was last there.
function vehicle(robot) {
  const faint = robot.silent ? { transparent: true, opacity: 0.35 } : {}, coat = (color) => paint("MeshLambertMaterial", { color, ...faint });
  const group = new THREE.Group(), own = coat(colour(robot.pid)), dark = coat("#2b2b30");
  const part = (geometry, material, x, y, z) => {
    const found = new THREE.Mesh(geometry, material);
    found.position.set(x, y, z);
    group.add(found);
    return found;
  };
  if (robot.target === "squad") {
    part(shapes().disc, coat(colour(robot.pid)), 0, 0, 0.02).rotation.x = Math.PI / 2;
    for (let k = 0; k < 3; k++) part(shapes().rotor, dark, 0.17 * Math.cos(2.094 * k), 0.17 * Math.sin(2.094 * k), 0.05).rotation.x = Math.PI / 2;
  } else if (flies(robot)) {
    part(shapes().hull, own, 0.01, 0, 0.045);
    part(shapes().nose, dark, 0.15, 0, 0.045);
    for (const angle of [1, -1]) part(shapes().arm, dark, 0, 0, 0.04).rotation.z = (angle * Math.PI) / 4;
    for (const [i, j] of [[1, 1], [1, -1], [-1, 1], [-1, -1]]) part(shapes().rotor, own, i * QUAD_ARM, j * QUAD_ARM, 0.07).rotation.x = Math.PI / 2;
  } else {
    part(shapes().chassis, own, 0, 0, 0.09);
    part(shapes().cabin, own, -0.06, 0, 0.165);
    part(shapes().glass, dark, 0.055, 0, 0.165);
    for (const [i, j] of [[1, 1], [1, -1], [-1, 1], [-1, -1]]) part(shapes().wheel, dark, i * 0.16, j * 0.12, 0.06);
  }
  return group;
}

// The geometries of robots' parts, made once; metres.
function shapes() {
  shapes.made = shapes.made || {
    hull: new THREE.BoxGeometry(0.16, 0.09, 0.05), nose: new THREE.BoxGeometry(0.14, 0.035, 0.035), arm: new THREE.BoxGeometry(0.4, 0.022, 0.018),
    rotor: new THREE.CylinderGeometry(ROTOR, ROTOR, 0.012, 24), chassis: new THREE.BoxGeometry(0.5, 0.22, 0.09),
    disc: new THREE.CylinderGeometry(0.32, 0.32, 0.03, 40),
    cabin: new THREE.BoxGeometry(0.22, 0.19, 0.07), glass: new THREE.BoxGeometry(0.02, 0.17, 0.055), wheel: new THREE.CylinderGeometry(0.06, 0.06, 0.05, 20),
  };
  for (const geometry of Object.values(shapes.made)) geometry.kept = true;
  return shapes.made;
}
