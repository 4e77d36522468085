// The plan: draws the world, the selection with its handles and the camera, and turns pointer moves into wishes.

import { add, corners, degrees, length, middle, pathOf, radians, rotate, subtract } from "./geometry.js";

const SVG = "http://www.w3.org/2000/svg";
const LIGHT = ["#e6dfd1", "#b3a793", "#7b7162", "#454039"];
const DARK = ["#4b4a48", "#77716a", "#a89f92", "#e6dfd1"];
const ROBOT_FITS = "clear", LOW = "low", OVERHANGING = "overhanging";

const dark = matchMedia("(prefers-color-scheme: dark)");

function mix(ramp, share) {
  const place = Math.min(Math.max(share, 0), 1) * (ramp.length - 1), i = Math.min(Math.floor(place), ramp.length - 2);
  const [a, b] = [ramp[i], ramp[i + 1]].map((hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16)));
  return `rgb(${a.map((value, k) => Math.round(value + (place - i) * (b[k] - value))).join(" ")})`;
}

export const same = (a, b) => a && b && a.list === b.list && a.index === b.index;

export class Plan {
  /** @param on { press(event, hit, point), move(event, point), release(event, point), twice(hit), hover(point) } */
  constructor(svg, on) {
    this.svg = svg;
    this.on = on;
    this.view = { x: 0, y: 0, scale: 80 };
    this.state = {};
    this.waiting = false;
    const point = (event) => {
      const box = svg.getBoundingClientRect();
      return this.toWorld([event.clientX - box.left, event.clientY - box.top]);
    };
    svg.addEventListener("pointerdown", (event) => {
      svg.focus({ preventScroll: true });
      svg.setPointerCapture(event.pointerId);
      on.press(event, this.hit(event), point(event));
    });
    svg.addEventListener("pointermove", (event) => { on.move(event, point(event)); on.hover(point(event)); });
    svg.addEventListener("pointerup", (event) => on.release(event, point(event)));
    svg.addEventListener("pointercancel", (event) => on.release(event, point(event)));
    svg.addEventListener("pointerleave", () => on.hover(null));
    svg.addEventListener("dblclick", (event) => on.twice(this.hit(event), point(event)));
    svg.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(point(event), Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)));
    }, { passive: false });
    new ResizeObserver(() => { if (this.fitted) this.fit(); else this.draw(); }).observe(svg);
    dark.addEventListener("change", () => this.draw());
  }

  /** What lies under the pointer: {handle, …}, {list, index}, {list: "camera"} or null. */
  hit(event) {
    const element = document.elementFromPoint(event.clientX, event.clientY)?.closest?.("[data-hit]");
    return element && this.svg.contains(element) ? JSON.parse(element.dataset.hit) : null;
  }

  toScreen([x, y]) {
    const { width, height } = this.size();
    return [width / 2 + (x - this.view.x) * this.view.scale, height / 2 - (y - this.view.y) * this.view.scale];
  }

  toWorld([u, v]) {
    const { width, height } = this.size();
    return [this.view.x + (u - width / 2) / this.view.scale, this.view.y - (v - height / 2) / this.view.scale];
  }

  size() {
    return { width: this.svg.clientWidth || 1, height: this.svg.clientHeight || 1 };
  }

  zoom(about, factor) {
    this.fitted = false;
    const scale = Math.min(Math.max(this.view.scale * factor, 2), 4000), ratio = this.view.scale / scale;
    this.view = { x: about[0] + (this.view.x - about[0]) * ratio, y: about[1] + (this.view.y - about[1]) * ratio, scale };
    this.draw();
  }

  pan(by) {
    this.fitted = false;
    this.view = { ...this.view, x: this.view.x - by[0], y: this.view.y - by[1] };
    this.draw();
  }

  fit() {
    this.fitted = true;
    const scene = this.state.scene;
    if (!scene) return;
    const margin = (scene.walls?.thickness ?? 0) + 0.15, { width, height } = this.size();
    const scale = Math.min((width - 16) / (scene.size[0] + 2 * margin), (height - 44) / (scene.size[1] + 2 * margin));
    this.view = { x: 0, y: -14 / Math.max(scale, 2), scale: Math.max(scale, 2) };
    this.draw();
  }

  set(state) {
    Object.assign(this.state, state);
    this.draw();
  }

  draw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; this.paint(); });
  }

  paint() {
    const { scene, equipment } = this.state;
    if (!scene || !equipment) return;
    this.root = document.createDocumentFragment();
    this.colours = dark.matches ? DARK : LIGHT;
    this.highest = Math.max(1, ...scene.obstacles.map((o) => o.base + o.height));
    this.room(scene);
    if (this.state.showPaths) this.paths(scene);
    const order = scene.obstacles.map((_, i) => i).sort((a, b) => this.top(a) - this.top(b));
    for (const i of order) this.obstacle(scene.obstacles[i], i);
    for (const thing of scene.obstacles) this.motion(thing);
    if (Array.isArray(scene.goals)) scene.goals.forEach((goal, i) => this.goal(goal, i));
    if (Array.isArray(scene.starts)) scene.starts.forEach((start, i) => this.start(start, i));
    this.names(scene);
    this.camera();
    this.handles(scene);
    this.extras();
    this.svg.replaceChildren(this.patterns(), this.root);
  }

  top(i) {
    const { base, height } = this.state.scene.obstacles[i];
    return base + height;
  }

  node(name, attributes, text) {
    const element = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) if (value !== undefined && value !== null) element.setAttribute(key, value);
    if (text !== undefined) element.textContent = text;
    this.root.append(element);
    return element;
  }

  polygon(points, attributes, closed = true) {
    const places = points.map((p) => this.toScreen(p).map((u) => u.toFixed(1)).join(",")).join(" ");
    return this.node(closed ? "polygon" : "polyline", { points: places, ...attributes });
  }

  circle(at, radius, attributes) {
    const [cx, cy] = this.toScreen(at);
    return this.node("circle", { cx, cy, r: radius, ...attributes });
  }

  patterns() {
    const defs = document.createElementNS(SVG, "defs");
    const lines = { [LOW]: "M-1 7L7 -1M-1 1L1 -1M5 7L7 5", [OVERHANGING]: "M0 0L6 6M6 0L0 6" };
    const pattern = (id, inner) => `<pattern id="${id}" width="6" height="6" patternUnits="userSpaceOnUse">${inner}</pattern>`;
    defs.innerHTML = pattern(LOW, `<path class="hatch" d="${lines[LOW]}"/>`) + pattern(OVERHANGING, `<path class="hatch" d="${lines[OVERHANGING]}"/>`)
      + pattern(ROBOT_FITS, '<circle class="dots" cx="3" cy="3" r="0.9"/>');
    const [a, b] = this.state.scene.size, [u, v] = this.toScreen([-a / 2, b / 2]), { scale } = this.view;
    defs.innerHTML += `<clipPath id="inside-the-room"><rect x="${u}" y="${v}" width="${a * scale}" height="${b * scale}"/></clipPath>`;
    return defs;
  }

  room({ size: [a, b], walls }) {
    const rectangle = (x, y, of) => this.polygon([[-x, -y], [x, -y], [x, y], [-x, y]], { class: of });
    if (walls) rectangle(a / 2 + walls.thickness, b / 2 + walls.thickness, "wall");
    rectangle(a / 2, b / 2, walls ? "floor" : "floor open");
    const pixels = this.view.scale, step = [0.1, 0.25, 0.5, 1, 2, 5, 10, 50, 100].find((s) => s * pixels >= 34) ?? 500;
    let fine = "", axes = "";
    const line = (from, to) => { const [[u, v], [s, t]] = [this.toScreen(from), this.toScreen(to)]; return `M${u.toFixed(1)} ${v.toFixed(1)}L${s.toFixed(1)} ${t.toFixed(1)}`; };
    for (let i = Math.ceil(-a / 2 / step); i * step <= a / 2; i++) i ? (fine += line([i * step, -b / 2], [i * step, b / 2])) : (axes += line([0, -b / 2], [0, b / 2]));
    for (let i = Math.ceil(-b / 2 / step); i * step <= b / 2; i++) i ? (fine += line([-a / 2, i * step], [a / 2, i * step])) : (axes += line([-a / 2, 0], [a / 2, 0]));
    this.node("path", { d: fine, class: "grid" });
    this.node("path", { d: axes, class: "grid axis" });
  }

  isSelected(list, index) {
    return (this.state.selection ?? []).some((item) => same(item, { list, index }));
  }

  marks(list, index) {
    const isIn = (items) => (items ?? []).some((item) => same(item, { list, index }));
    return `${this.isSelected(list, index) ? " selected" : ""}${isIn(this.state.bad) ? " bad" : isIn(this.state.odd) ? " odd" : ""}`;
  }

  kind(thing) {
    const { robot, camera } = this.state.equipment;
    if (thing.base >= robot.height) return ROBOT_FITS;
    if (thing.base + thing.height <= camera.mount_z) return LOW;
    return thing.base > 0 ? OVERHANGING : "plain";
  }

  obstacle(thing, index) {
    const kind = this.kind(thing), hit = JSON.stringify({ list: "obstacles", index });
    const fill = mix(this.colours, (thing.base + thing.height) / this.highest);
    const shape = (attributes) => thing.kind === "cylinder"
      ? this.circle(thing.at, thing.radius * this.view.scale, attributes) : this.polygon(corners(thing), attributes);
    const drawn = shape({ class: `obstacle ${kind}${this.marks("obstacles", index)}`, fill, "data-hit": hit, "data-list": "obstacles", "data-index": index });
    const tip = document.createElementNS(SVG, "title");
    tip.textContent = `${thing.name}: ${thing.base ? `${thing.base} to ` : ""}${Math.round((thing.base + thing.height) * 1000) / 1000} m high`;
    drawn.append(tip);
    if (kind !== "plain") shape({ fill: `url(#${kind})`, class: "hatching" });
  }

  motion(thing) {
    const path = pathOf(thing);
    if (path) this.polygon(path, { class: "motion" }, thing.motion.repeat === "circuit");
    if (!thing.motion?.hinge) return;
    const { hinge, swing_deg: swing } = thing.motion;
    for (const angle of swing) {
      const there = (p) => add(hinge, rotate(subtract(p, hinge), radians(angle)));
      if (thing.kind === "cylinder") this.circle(there(thing.at), thing.radius * this.view.scale, { class: "motion" });
      else this.polygon(corners(thing).map(there), { class: "motion" });
    }
    this.circle(hinge, 3, { class: "hinge" });
  }

  goal(goal, index) {
    const [u, v] = this.toScreen(goal.at), r = 7;
    this.node("path", {
      d: `M${u} ${v - r}L${u + r} ${v}L${u} ${v + r}L${u - r} ${v}Z`, class: `goal${this.marks("goals", index)}`,
      "data-hit": JSON.stringify({ list: "goals", index }), "data-list": "goals", "data-index": index,
    });
    this.node("text", { x: u + 7, y: v - 5, class: "goal-name" }, index);
  }

  start(start, index) {
    const { radius } = this.state.equipment.robot, [u, v] = this.toScreen(start.at);
    if (start.yaw_deg !== null) this.arrow(start.at, radians(start.yaw_deg), radius, radius + 0.24, "start-arrow");
    this.circle(start.at, radius * this.view.scale, {
      class: `start${this.marks("starts", index)}`, "data-hit": JSON.stringify({ list: "starts", index }), "data-list": "starts", "data-index": index,
    });
    this.node("text", { x: u, y: v, class: "start-name" }, index);
  }

  arrow(at, yaw, from, to, name) {
    const place = (distance, aside) => add(at, [Math.cos(yaw) * distance - Math.sin(yaw) * aside, Math.sin(yaw) * distance + Math.cos(yaw) * aside]);
    this.polygon([place(from, 0), place(to, 0)], { class: name }, false);
    const head = 7 / this.view.scale;
    this.polygon([place(to, 0), place(to - head, head / 2), place(to - head, -head / 2)], { class: `${name} head` });
  }

  names(scene) {
    if (!this.state.showNames) return;
    scene.obstacles.forEach((thing, i) => {
      const [u, v] = this.toScreen(middle(thing)), { width, height } = this.size();
      if (u < 0 || v < 0 || u > width || v > height) return;
      // A name much wider than its thing would cover the neighbours; the thing's tooltip has it.
      if (this.extent(thing) * this.view.scale < 4.2 * thing.name.length && !this.isSelected("obstacles", i)) return;
      this.node("text", { x: u, y: v, class: `name${this.marks("obstacles", i)}` }, thing.name);
    });
  }

  extent(thing) {
    if (thing.kind === "cylinder") return 2 * thing.radius;
    const across = corners(thing).map(([x]) => x);
    return Math.max(...across) - Math.min(...across);
  }

  paths(scene) {
    const { pairs } = this.state;
    if (!pairs || !Array.isArray(scene.starts) || !Array.isArray(scene.goals)) return;
    const focus = (this.state.selection ?? []).filter(({ list }) => list === "starts" || list === "goals");
    const isMeant = ({ start, goal }) => focus.some(({ list, index }) => (list === "starts" ? start : goal) === index);
    const many = pairs.length > 40;
    for (const pair of pairs) {
      const ends = [scene.starts[pair.start]?.at, scene.goals[pair.goal]?.at];
      if (!ends[0] || !ends[1]) continue;
      const name = `${focus.length && !isMeant(pair) ? " faint" : ""}${focus.length && isMeant(pair) ? " focus" : ""}${many ? " many" : ""}`;
      if (pair.points === null) this.polygon(ends, { class: `unreachable${name}` }, false);
      else this.polygon(pair.points, { class: `path${name}` }, false);
    }
  }

  camera() {
    const { pose, equipment: { robot, camera } } = this.state;
    if (!pose) return;
    const [x, y, yaw] = pose, at = [x, y], eye = add(at, rotate([camera.mount_x, camera.mount_y], yaw));
    const half = radians(camera.horizontal_fov_deg / 2), far = camera.max_range / Math.cos(half);
    this.polygon([eye, add(eye, rotate([far, 0], yaw + half)), add(eye, rotate([far, 0], yaw - half))], { class: "cone", "clip-path": "url(#inside-the-room)" });
    this.circle(at, robot.radius * this.view.scale, { class: `camera${this.isSelected("camera", 0) ? " selected" : ""}`, "data-hit": '{"list":"camera","index":0}', "data-list": "camera" });
    this.arrow(at, yaw, 0, robot.radius * 0.95, "camera-arrow");
    const knob = add(at, rotate([robot.radius + 22 / this.view.scale, 0], yaw));
    this.polygon([add(at, rotate([robot.radius, 0], yaw)), knob], { class: "stem" }, false);
    this.circle(knob, 5, { class: "handle turn", "data-hit": '{"handle":"camera-turn"}', "data-handle": "camera-turn" });
    if (this.state.seen) this.circle(this.state.seen, 4, { class: "seen" });
  }

  handles(scene) {
    const selection = this.state.selection ?? [];
    if (selection.length !== 1 || this.state.frozen) return;
    const [{ list, index }] = selection, thing = scene[list]?.[index];
    if (!thing || list === "goals") return;
    const knob = (at, handle, name) => this.circle(at, 5, { class: `handle ${name}`, "data-hit": JSON.stringify(handle), "data-handle": handle.handle });
    const stem = (from, angle, reach, handle) => {
      const start = add(from, rotate([reach, 0], angle)), end = add(from, rotate([reach + 24 / this.view.scale, 0], angle));
      this.polygon([start, end], { class: "stem" }, false);
      knob(end, handle, "turn");
    };
    if (list === "starts") {
      const { radius } = this.state.equipment.robot;
      return stem(thing.at, radians(thing.yaw_deg ?? 0), radius + (thing.yaw_deg === null ? 0 : 0.24), { handle: "turn" });
    }
    if (thing.kind === "box") {
      const [a, b] = thing.size, yaw = radians(thing.yaw_deg);
      for (const [i, j] of [[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 0], [-1, 0], [0, 1], [0, -1]]) {
        const at = add(thing.at, rotate([(i * a) / 2, (j * b) / 2], yaw));
        knob(at, { handle: "resize", side: [i, j] }, i && j ? "corner" : "side");
      }
      stem(thing.at, yaw, a / 2, { handle: "turn" });
    } else if (thing.kind === "cylinder") {
      for (const angle of [0, 90, 180, 270]) knob(add(thing.at, rotate([thing.radius, 0], radians(angle))), { handle: "radius" }, "corner");
    } else {
      thing.points.forEach((point, i) => {
        const next = thing.points[(i + 1) % thing.points.length];
        knob([(point[0] + next[0]) / 2, (point[1] + next[1]) / 2], { handle: "new-corner", after: i }, "middle");
      });
      thing.points.forEach((point, i) => knob(point, { handle: "corner", corner: i }, "corner"));
    }
    pathOf(thing)?.forEach((point, i) => i && knob(point, { handle: "way", corner: i }, "way"));
  }

  extras() {
    const { draft, frame } = this.state;
    if (frame) {
      const [[a, b], [c, d]] = frame;
      this.polygon([[a, b], [c, b], [c, d], [a, d]], { class: "frame" });
    }
    if (!draft) return;
    if (draft.kind === "box") this.polygon(corners(draft), { class: "draft" });
    if (draft.kind === "cylinder") this.circle(draft.at, draft.radius * this.view.scale, { class: "draft" });
    if (draft.kind === "polygon") {
      this.polygon(draft.points, { class: "draft" }, false);
      for (const point of draft.points.slice(0, -1)) this.circle(point, 4, { class: "handle corner" });
    }
    if (draft.kind === "start") {
      const { radius } = this.state.equipment.robot;
      this.circle(draft.at, radius * this.view.scale, { class: "draft" });
      if (draft.yaw !== null) this.arrow(draft.at, draft.yaw, radius, radius + 0.24, "start-arrow");
    }
  }

  /** Entries whose middle lies in a frame of two corners. */
  within([[a, b], [c, d]]) {
    const { scene } = this.state, found = [];
    for (const list of ["obstacles", "starts", "goals"]) {
      if (!Array.isArray(scene[list])) continue;
      scene[list].forEach((thing, index) => {
        const [x, y] = middle(thing);
        if (x >= Math.min(a, c) && x <= Math.max(a, c) && y >= Math.min(b, d) && y <= Math.max(b, d)) found.push({ list, index });
      });
    }
    return found;
  }

  /** The ramp of heights, for the legend. */
  ramp() {
    const colours = dark.matches ? DARK : LIGHT, { scene } = this.state;
    return { colours, highest: Math.max(1, ...scene.obstacles.map((o) => o.base + o.height)) };
  }
}

export const angleOf = (from, to) => degrees(Math.atan2(to[1] - from[1], to[0] - from[0]));
export const distance = (a, b) => length(subtract(a, b));
