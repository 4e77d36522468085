// The page: one text, which the plan, the panel and the textarea all change, and a server that says what it means.

import * as api from "./api.js";
import { DepthView } from "./depth.js";
import { add, middle, millimetres, moved, radians, degrees, rotate, rounded, settled, snapped, subtract, turned, turnedBy, pathOf } from "./geometry.js";
import { History } from "./history.js";
import { Panel } from "./panel.js";
import { Plan, angleOf, distance, same } from "./plan.js";
import { TextView, unitOffset } from "./text.js";

const $ = (id) => document.getElementById(id);
const SMALLEST = 0.01; // metres: what is drawn or resized by hand is no smaller
const mac = /Mac/.test(navigator.platform);

const state = {
  text: "", saved: "", stamp: "", name: "",
  scene: null, // the last world that could be drawn
  frozen: false, // whether the text cannot be read, so that the plan shows an older one
  world: null, // the server's name of the text that `scene` is of
  errors: [], odd: [], problems: [], pairs: null, // odd: legal, but worth a remark
  selection: [], pose: [0, 0, 0], tool: "select", equipment: null,
};
let history, gesture = null, work = Promise.resolve();

const plan = new Plan($("plan"), { press, move, release, twice, hover });
const panel = new Panel($("panel"), {
  set: (where, values) => change([{ op: "set", where, values: withWay(where, values) }], { kind: `set ${where} ${Object.keys(values)}` }),
  remove, duplicate, pose: setPose,
});
const text = new TextView({ area: $("text"), highlight: $("highlight"), gutter: $("gutter") }, { typed, caret });
const depth = new DepthView(
  { canvas: $("depth"), scale: $("scale"), scaleEnd: $("scale-end"), readout: $("readout"), inside: $("inside") },
  (seen) => plan.set({ seen }),
);

// What is said to the user

let toastTimer;
function toast(message) {
  $("toast").textContent = message;
  $("toast").hidden = false;
  clearTimeout(toastTimer);
  toastTimer = setTimeout(() => { $("toast").hidden = true; }, 6000);
}

function notice(message, actions = {}) {
  $("notice").hidden = !message;
  $("notice").firstElementChild.textContent = message ?? "";
  $("notice").lastElementChild.replaceChildren(...Object.entries(actions).map(([name, run]) =>
    Object.assign(document.createElement("button"), { textContent: name, onclick: () => { notice(null); run(); } })));
}

function failed(error) {
  if (error instanceof api.GoneError) {
    notice("The editor's server has ended. Your text is still here: copy it, or start “navsim world edit” again on the same port.", {});
  } else toast(error.message);
}

// Drawing all there is

function show() {
  state.problems = [...state.errors, ...(state.errors.length ? [] : state.odd)];
  const dirty = state.text !== state.saved;
  $("unsaved").hidden = !dirty;
  $("save").disabled = !dirty && state.stamp !== "";
  $("undo").disabled = !history.canUndo;
  $("redo").disabled = !history.canRedo;
  document.title = `${dirty ? "● " : ""}${state.name} – navsim world editor`;
  $("stale").hidden = !state.frozen;
  $("plan-pane").classList.toggle("frozen", state.frozen);
  state.selection = state.selection.filter(({ list, index }) => list === "camera" || (Array.isArray(state.scene?.[list]) && index < state.scene[list].length));
  plan.set({
    scene: state.scene, selection: state.selection, pairs: state.pairs, pose: state.pose, equipment: state.equipment,
    bad: state.errors.flatMap(offenders), odd: state.problems.filter(({ severity }) => severity === "warning").flatMap(offenders),
    frozen: state.frozen, showPaths: $("show-paths").checked, showNames: $("show-names").checked,
  });
  if (!gesture?.edits) panel.show(state);
  text.mark(state.problems, state.frozen ? [] : state.selection.map(({ list, index }) => state.scene?.[list]?.[index]?.span).filter(Boolean));
  showProblems();
  showSummary();
}

/** The entries that a problem is about: the one it stands at, and the obstacles that it names. */
function offenders({ where, text: told }) {
  const named = [...told.matchAll(/(?:from|inside) '([^']+)'/g)].map((match) => match[1]);
  const found = (state.scene?.obstacles ?? []).flatMap((thing, index) => (named.includes(thing.name) ? [{ list: "obstacles", index }] : []));
  return where ? [{ list: where[0], index: where[1] }, ...found] : found;
}

function showProblems() {
  const rows = state.problems.map(({ line, column, end_column: end, text: told, severity }) => {
    const row = Object.assign(document.createElement("button"), { className: `problem ${severity}`, title: "Go to the line" });
    row.append(Object.assign(document.createElement("b"), { textContent: `${line}:${column}` }), ` ${told}`);
    row.onclick = () => text.jump(line, column, end);
    return row;
  });
  const cut = (state.pairs ?? []).filter((pair) => pair.points === null).length;
  if (!rows.length) {
    rows.push(Object.assign(document.createElement("p"), { className: "fine", textContent: cut ? "" : "No problems." }));
  }
  $("problems").replaceChildren(...rows);
}

function showSummary() {
  const { scene, pairs } = state;
  if (!scene) return;
  const lengths = (pairs ?? []).filter((pair) => pair.length !== null).map((pair) => pair.length);
  const cut = (pairs ?? []).length - lengths.length;
  const parts = [`${scene.size[0]} × ${scene.size[1]} m`, `${scene.obstacles.length} obstacle${scene.obstacles.length === 1 ? "" : "s"}`];
  if (lengths.length) parts.push(`${pairs.length} path${pairs.length === 1 ? "" : "s"}, ${Math.min(...lengths).toFixed(1)} to ${Math.max(...lengths).toFixed(1)} m`);
  if (cut) parts.push(`${cut} without a way`);
  $("summary").textContent = parts.join(" · ");
  const { colours, highest } = plan.ramp();
  const legend = $("legend");
  legend.replaceChildren("0 m", Object.assign(document.createElement("i")), `${Math.round(highest * 100) / 100} m high`);
  legend.querySelector("i").style.background = `linear-gradient(to right, ${colours.join(", ")})`;
  legend.hidden = scene.obstacles.length === 0;
}

// Asking the server what the text means

/** Takes in what the server says about `said`, a text that is being shown. */
function take(answer) {
  state.errors = answer.problems;
  state.frozen = answer.scene === null;
  if (answer.scene) {
    state.scene = answer.scene;
    if (state.world !== answer.world) {
      state.world = answer.world;
      state.odd = [];
      look();
      findPaths();
    }
  }
}

const refresh = api.latest(async () => {
  const asked = state.text;
  try {
    const answer = await api.read(asked);
    if (asked === state.text && !gesture?.edits) { take(answer); show(); }
  } catch (error) { failed(error); }
});

const look = api.latest(async () => {
  if (!state.world) return;
  const [width, height] = $("resolution").value.split("x").map(Number), pose = state.pose;
  try {
    depth.show(await api.depth(state.world, pose, width, height), width, height, pose);
  } catch (error) { if (error.status !== 410) failed(error); }
});

let pathTimer;
function findPaths() {
  clearTimeout(pathTimer);
  pathTimer = setTimeout(async () => {
    const world = state.world;
    try {
      const answer = await api.paths(world);
      if (answer.stale || world !== state.world) return;
      state.pairs = answer.pairs;
      show();
      const { problems } = await api.oddities(world);
      if (world !== state.world || gesture?.edits) return;
      state.odd = problems;
      show();
    } catch (error) { if (error.status !== 410) failed(error); }
  }, 350);
}

// Changing the text

function setText(next, { selection = state.selection, kind = null } = {}) {
  state.text = next;
  state.selection = selection;
  history.push(next, selection, kind);
  text.set(next);
}

/** Changes the text by edits, after whatever is being changed already. */
function change(edits, { selection, kind = null } = {}) {
  work = work.then(async () => {
    try {
      const answer = await api.edit(state.text, typeof edits === "function" ? edits() : edits);
      setText(answer.text, { selection: typeof selection === "function" ? selection(answer.scene) : selection, kind });
      take(answer);
    } catch (error) { failed(error); }
    show();
    revealSelection();
  });
  return work;
}

function typed(value) {
  state.text = value;
  const line = value.slice(0, $("text").selectionStart).split("\n").length;
  history.push(value, state.selection, `typing in line ${line}`);
  $("unsaved").hidden = value === state.saved;
  clearTimeout(typed.timer);
  typed.timer = setTimeout(refresh, 120);
}

function caret(offset) {
  if (state.frozen || !state.scene) return;
  for (const list of ["obstacles", "starts", "goals"]) {
    if (!Array.isArray(state.scene[list])) continue;
    const index = state.scene[list].findIndex(({ span }) => span && offset >= unitOffset(state.text, span[0]) && offset <= unitOffset(state.text, span[1]));
    if (index >= 0) return select([{ list, index }], { reveal: false });
  }
  if (state.selection.length) select([], { reveal: false });
}

function select(selection, { reveal = true } = {}) {
  state.selection = selection;
  show();
  if (reveal) revealSelection();
}

function revealSelection() {
  const first = state.selection[0], span = first && state.scene?.[first.list]?.[first.index]?.span;
  if (span && !state.frozen && document.activeElement !== $("text")) text.reveal(span[0]);
}

function step(entry) {
  if (!entry) return;
  state.text = entry.text;
  state.selection = entry.selection;
  text.set(entry.text);
  refresh();
  show();
}

/** What is put elsewhere takes the way along which it moves with it. */
function withWay([list, index], values) {
  const thing = state.scene[list]?.[index];
  return thing?.motion && values.at ? { ...moved(thing, subtract(values.at, thing.at)), ...values } : values;
}

const things = () => state.selection.filter(({ list }) => list !== "camera").map((item) => ({ ...item, thing: state.scene[item.list][item.index] }));
const place = ({ list, index }) => [list, index];

function remove() {
  const gone = things();
  if (!gone.length || blocked()) return;
  gone.sort((a, b) => b.index - a.index); // from the end, so that places stay right
  change(gone.map((item) => ({ op: "remove", where: place(item) })), { selection: [] });
}

function asEntry(list, thing, by) {
  if (list !== "obstacles") {
    const at = rounded(add(thing.at, by));
    return thing.yaw_deg === null || thing.yaw_deg === undefined ? at : { at, yaw_deg: thing.yaw_deg };
  }
  const keys = { box: ["at", "size"], cylinder: ["at", "radius"], polygon: ["points"] }[thing.kind];
  const settings = { ...Object.fromEntries(keys.map((key) => [key, thing[key]])), ...moved(thing, by) };
  const { base, height, yaw_deg: yaw, pushable } = thing;
  return { [thing.kind]: { ...(thing.named ? { name: `${thing.name} copy` } : {}), ...settings, ...(base ? { base } : {}), height, ...(yaw ? { yaw_deg: yaw } : {}),
    ...(settings.motion ? { motion: settings.motion } : {}), ...(pushable ? { pushable: settled(pushable) } : {}) } };
}

function duplicate() {
  const chosen = things();
  if (!chosen.length || blocked()) return;
  chosen.sort((a, b) => a.index - b.index);
  const by = [2, -2].map((steps) => steps * (gridStep() || 0.05) * (gridStep() < 0.05 ? 5 : 1)), seen = {}, selection = [];
  const edits = chosen.map(({ list, index, thing }) => {
    const at = index + 1 + (seen[list] = (seen[list] ?? -1) + 1);
    selection.push({ list, index: at });
    return { op: "add", list, entry: asEntry(list, thing, by), index: at };
  });
  change(edits, { selection });
}

/** Whether the plan must not be changed now; says why. */
function blocked() {
  if (state.frozen) toast("The text cannot be read as it stands: mend it, or undo, before you change the plan.");
  return state.frozen;
}

// The camera

function setPose(pose) {
  state.pose = [millimetres(pose[0]), millimetres(pose[1]), pose[2]];
  look();
  show();
}

// Gestures on the plan. Each is {move(point, event), end(point, event), cancel()}.

const gridStep = () => Number($("grid").value);
const stepOf = (event) => (event.altKey ? 0 : gridStep());
const snap = (point, event) => point.map((value) => snapped(value, stepOf(event)));

/** A gesture that changes entries: it edits the text that it began with, again and again, as fast as the server answers. */
function editing(edits) {
  const before = { text: state.text, scene: state.scene }, { selection } = state;
  let now = null, ended = false;
  const drawn = (list) => list.reduce((scene, { where: [name, index], values }) => {
    const copy = { ...scene, [name]: [...scene[name]] };
    copy[name][index] = { ...copy[name][index], ...values };
    return copy;
  }, before.scene);
  const send = api.latest(async (list) => {
    try {
      const answer = await api.edit(before.text, list);
      if (ended) return;
      state.text = answer.text;
      text.set(answer.text);
      take(answer);
      if (now !== list) state.scene = drawn(now); // the pointer is ahead of the server
      show();
    } catch (error) {
      if (ended) return;
      failed(error);
      own.cancel();
    }
  });
  const own = {
    edits: true,
    move(point, event) {
      now = edits(point, event);
      state.scene = drawn(now);
      plan.set({ scene: state.scene });
      send(now);
    },
    end() {
      ended = true;
      gesture = null;
      if (!now) { refresh(); findPaths(); return; } // what was answered meanwhile has been left out
      work = work.then(async () => {
        try {
          const answer = await api.edit(before.text, now);
          setText(answer.text, { selection });
          take(answer);
        } catch (error) { failed(error); own.cancel(); }
        show();
        revealSelection();
      });
    },
    cancel() {
      ended = true;
      gesture = null;
      state.text = before.text;
      text.set(before.text);
      state.scene = before.scene;
      refresh();
      show();
    },
  };
  return own;
}

function dragging(hit, from) {
  const items = things(), grabbed = state.scene[hit.list][hit.index];
  return editing((point, event) => {
    const step = stepOf(event);
    // What was grabbed lands on the grid; what goes with it keeps its distance.
    const anchor = grabbed.at ?? grabbed.points[0], target = add(anchor, subtract(point, from));
    const by = subtract(target.map((value) => snapped(value, step)), anchor);
    return items.map((item) => ({ op: "set", where: place(item), values: moved(item.thing, by) }));
  });
}

function handling(hit, { list, index }) {
  const thing = state.scene[list][index], where = [list, index], set = (values) => [{ op: "set", where, values }];
  if (hit.handle === "turn") {
    return editing((point, event) => set({ yaw_deg: turned(angleOf(thing.at, point), event.altKey ? 0 : 5) }));
  }
  if (hit.handle === "radius") {
    return editing((point, event) => set({ radius: Math.max(SMALLEST, snapped(distance(thing.at, point), Math.min(stepOf(event), 0.05))) }));
  }
  if (hit.handle === "resize") {
    const yaw = radians(thing.yaw_deg), [i, j] = hit.side;
    const fixed = add(thing.at, rotate([(-i * thing.size[0]) / 2, (-j * thing.size[1]) / 2], yaw));
    return editing((point, event) => {
      const reach = rotate(subtract(point, fixed), -yaw), step = stepOf(event);
      const size = [i, j].map((side, axis) => (side ? Math.max(SMALLEST, snapped(side * reach[axis], step)) : thing.size[axis]));
      const at = rounded(add(fixed, rotate([(i * size[0]) / 2, (j * size[1]) / 2], yaw)));
      const stays = at.map((value, axis) => (Math.abs(value - thing.at[axis]) < 6e-4 ? thing.at[axis] : value));
      const [, ...way] = pathOf(thing) ?? [], by = subtract(stays, thing.at);
      const path = [stays, ...way.map((p) => rounded(add(p, by)))];
      return set({ size, at: stays, ...(way.length ? { motion: { ...settled(thing.motion), path } } : {}) });
    });
  }
  if (hit.handle === "corner") {
    return editing((point, event) => set({ points: thing.points.map((p, k) => (k === hit.corner ? snap(point, event) : p)) }));
  }
  if (hit.handle === "new-corner") {
    const { points } = thing, after = hit.after + 1;
    return editing((point, event) => set({ points: [...points.slice(0, after), snap(point, event), ...points.slice(after)] }));
  }
  return editing((point, event) => set({ motion: { ...settled(thing.motion), path: pathOf(thing).map((p, k) => (k === hit.corner ? snap(point, event) : p)) } }));
}

function panning(from) {
  return { move: (point) => plan.pan(subtract(point, from)), end: () => { gesture = null; }, cancel: () => { gesture = null; } };
}

function framing(from) {
  const close = () => { gesture = null; plan.set({ frame: null }); };
  return {
    move: (point) => plan.set({ frame: [from, point] }),
    end: (point) => { close(); select(plan.within([from, point])); },
    cancel: close,
  };
}

function driving(hit, from) {
  const [x, y, yaw] = state.pose, close = () => { gesture = null; show(); };
  if (hit.handle) {
    return { move: (point) => setPose([x, y, Math.atan2(point[1] - y, point[0] - x)]), end: close, cancel: close };
  }
  return { move: (point) => setPose([...add([x, y], subtract(point, from)), yaw]), end: close, cancel: close };
}

/** Draws something new open; a click without a drag gives it a usual size. */
function drawing(tool, event, point) {
  const from = snap(point, event);
  let draft = null;
  const show = () => plan.set({ draft });
  const close = () => { gesture = null; plan.set({ draft: null }); };
  const far = (to) => distance(from, to) * plan.view.scale > 6;
  return {
    move(to, moving) {
      const there = snap(to, moving);
      if (tool === "box") {
        const size = [0, 1].map((axis) => Math.max(SMALLEST, millimetres(Math.abs(there[axis] - from[axis]))));
        draft = { kind: "box", size, at: rounded([0, 1].map((axis) => (there[axis] + from[axis]) / 2)), yaw_deg: 0 };
      } else if (tool === "cylinder") draft = { kind: "cylinder", at: from, radius: Math.max(SMALLEST, snapped(distance(from, to), Math.min(stepOf(moving), 0.05))) };
      else if (tool === "start") draft = { kind: "start", at: from, yaw: far(to) ? radians(turned(angleOf(from, to), moving.altKey ? 0 : 5)) : null };
      show();
    },
    end(to) {
      close();
      const opened = draft && far(to);
      if (tool === "goal") return insert("goals", from);
      if (tool === "start") return insert("starts", opened ? { at: from, yaw_deg: turned(degrees(draft.yaw), 0) } : from);
      if (tool === "box") return insert("obstacles", { box: { at: opened ? draft.at : from, size: opened ? draft.size : [0.5, 0.5], height: 0.8 } });
      return insert("obstacles", { cylinder: { at: from, radius: opened ? draft.radius : 0.15, height: 0.8 } });
    },
    cancel: close,
  };
}

/** A polygon, corner by corner: it outlives the single press. */
function outlining() {
  const points = [];
  const own = {
    outline: true,
    press(event, point) {
      const at = snap(point, event);
      if (points.length > 2 && distance(at, points[0]) * plan.view.scale < 9) return own.finish();
      if (!points.length || distance(at, points.at(-1)) > 1e-6) points.push(at);
      return own.move(point, event);
    },
    move: (point, event) => plan.set({ draft: points.length ? { kind: "polygon", points: [...points, snap(point, event)] } : null }),
    end() {},
    finish() {
      own.cancel();
      if (points.length > 2) insert("obstacles", { polygon: { points, height: 0.8 } });
      else toast("A polygon has three corners or more.");
    },
    cancel() { gesture = null; plan.set({ draft: null }); },
  };
  return own;
}

function insert(list, entry) {
  const count = Array.isArray(state.scene[list]) ? state.scene[list].length : 0;
  setTool("select");
  return change([{ op: "add", list, entry }], { selection: [{ list, index: count }] });
}

function press(event, hit, point) {
  if (event.button === 1 || event.button === 2) { gesture?.cancel?.(); gesture = panning(point); return; }
  if (event.button !== 0 || !state.scene) return;
  if (gesture?.outline) return void gesture.press(event, point);
  if (state.tool !== "select") {
    if (blocked()) return;
    gesture = state.tool === "polygon" ? outlining() : drawing(state.tool, event, point);
    if (gesture.outline) gesture.press(event, point);
    return;
  }
  if (!hit) {
    gesture = event.shiftKey ? framing(point) : panning(point);
    if (!event.shiftKey && state.selection.length) select([]);
  } else if (hit.handle === "camera-turn" || hit.list === "camera") {
    select([{ list: "camera", index: 0 }]);
    gesture = driving(hit, point);
  } else if (hit.handle) {
    if (!blocked()) gesture = handling(hit, state.selection[0]);
  } else if (event.shiftKey) {
    const others = state.selection.filter((item) => !same(item, hit) && item.list !== "camera");
    const was = state.selection.some((item) => same(item, hit));
    select(was ? others : [...others, { list: hit.list, index: hit.index }]);
  } else {
    if (!state.selection.some((item) => same(item, hit))) select([{ list: hit.list, index: hit.index }]);
    if (state.frozen) return;
    const begun = dragging(hit, point), [u, v] = [event.clientX, event.clientY];
    let far = false; // a click is not a drag
    gesture = { ...begun, move(to, moving) { far ||= Math.hypot(moving.clientX - u, moving.clientY - v) > 3; if (far) begun.move(to, moving); } };
  }
}

function move(event, point) { gesture?.move(point, event); }
function release(event, point) { gesture?.end(point, event); }

function twice(hit) {
  if (gesture?.outline) return gesture.finish();
  if (hit?.handle !== "corner" || hit.corner === undefined) return undefined;
  const { list, index } = state.selection[0], { points } = state.scene[list][index];
  if (points.length < 4) return toast("A polygon keeps three corners.");
  return change([{ op: "set", where: [list, index], values: { points: points.filter((_, k) => k !== hit.corner) } }]);
}

function hover(point) {
  $("position").textContent = point ? `${point[0].toFixed(2)}, ${point[1].toFixed(2)} m` : "";
}

function setTool(tool) {
  if (gesture?.outline) gesture.cancel();
  state.tool = tool;
  $("plan").dataset.tool = tool;
  for (const button of $("tools").children) button.setAttribute("aria-pressed", String(button.dataset.tool === tool));
}

// Keys

const TOOLS = { v: "select", b: "box", c: "cylinder", p: "polygon", s: "start", g: "goal" };
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

function nudge(direction, event) {
  const step = event.altKey ? 0.001 : (gridStep() || 0.01) * (event.shiftKey ? 10 : 1), by = direction.map((value) => value * step);
  if (state.selection[0]?.list === "camera") return setPose([...add(state.pose, by), state.pose[2]]);
  if (blocked()) return undefined;
  return change(() => things().map((item) => ({ op: "set", where: place(item), values: moved(item.thing, by) })), { kind: "nudge" });
}

function turn(by, event) {
  const angle = event.altKey ? by / 50 : by;
  if (state.selection[0]?.list === "camera") return setPose([state.pose[0], state.pose[1], radians(turned(degrees(state.pose[2]) + angle, 0))]);
  if (blocked()) return undefined;
  const able = (item) => item.thing.kind === "box" || item.thing.kind === "polygon" || item.list === "starts";
  return change(() => things().filter(able).map((item) => ({ op: "set", where: place(item), values: turnedBy(item.thing, angle, 0) })), { kind: "turn" });
}

document.addEventListener("keydown", (event) => {
  if (document.querySelector("dialog[open]")) return;
  const control = mac ? event.metaKey : event.ctrlKey, key = event.key.toLowerCase(), typing = event.target.matches("input, select, textarea");
  const act = (run) => { event.preventDefault(); run(); };
  if (control && key === "s") return act(save);
  if (control && key === "z" && (!typing || event.target === $("text"))) return act(() => step(event.shiftKey ? history.redo() : history.undo()));
  if (control && key === "y" && (!typing || event.target === $("text"))) return act(() => step(history.redo()));
  if (event.key === "Escape") {
    if (gesture) return act(() => gesture.cancel());
    if (typing) return act(() => $("plan").focus());
    if (state.tool !== "select") return act(() => setTool("select"));
    return act(() => select([]));
  }
  if (gesture && !gesture.outline) return undefined;
  if (typing || event.target.closest("button") && ["Enter", " "].includes(event.key)) return undefined;
  if (control && key === "d") return act(duplicate);
  if (control && key === "a") return act(() => select(["obstacles", "starts", "goals"].flatMap((list) => (Array.isArray(state.scene?.[list]) ? state.scene[list].map((_, index) => ({ list, index })) : []))));
  if (control || event.metaKey) return undefined;
  if (key === "delete" || key === "backspace") return act(remove);
  if (event.key === "Enter" && gesture?.outline) return act(() => gesture.finish());
  if (ARROWS[event.key] && state.selection.length) return act(() => nudge(ARROWS[event.key], event));
  if ((event.key === "[" || event.key === "]") && state.selection.length) return act(() => turn(event.key === "[" ? 5 : -5, event));
  if (event.key === "?") return act(() => $("help").showModal());
  if (key === "f") return act(() => plan.fit());
  if (TOOLS[key] && !event.altKey) return act(() => setTool(TOOLS[key]));
  return undefined;
});

// The file

async function save() {
  await work;
  const written = state.text;
  const write = async (stamp) => {
    const answer = await api.save(written, stamp);
    Object.assign(state, { saved: written, stamp: answer.stamp });
    toast(`${state.name} is saved.`);
    show();
  };
  try {
    await write(state.stamp);
  } catch (error) {
    if (!error.answer?.disk) return failed(error);
    const { disk } = error.answer;
    const choice = await asked(`${error.message}. Reload it, and lose what you changed here (Undo brings it back), or overwrite it?`);
    if (choice === "reload") reload(disk);
    if (choice === "overwrite") await write(disk.stamp).catch(failed);
  }
  return undefined;
}

function asked(message) {
  const dialog = $("conflict");
  $("conflict-text").textContent = message;
  dialog.returnValue = "cancel";
  dialog.showModal();
  return new Promise((resolve) => dialog.addEventListener("close", () => resolve(dialog.returnValue), { once: true }));
}

function reload(disk) {
  gesture?.cancel?.(); // it would put back the text that it began with
  Object.assign(state, { saved: disk.text, stamp: disk.stamp });
  setText(disk.text, { selection: [] });
  refresh();
  show();
}

async function lookAtDisk() {
  if (!history || document.querySelector("dialog[open]")) return;
  try {
    const disk = await api.file();
    if (disk.stamp === state.stamp || !$("notice").hidden) return;
    if (state.text === state.saved && disk.stamp) { reload(disk); toast(`${state.name} has changed on disk; this is the new text.`); }
    else notice(`${state.name} has been ${disk.stamp ? "changed by another program" : "deleted"}.`, disk.stamp ? { "Reload it": () => reload(disk), "Keep mine": () => {} } : { OK: () => {} });
  } catch (error) { failed(error); }
}

window.addEventListener("focus", lookAtDisk);
window.addEventListener("beforeunload", (event) => { if (state.text !== state.saved) event.preventDefault(); });

// Begin

$("undo").onclick = () => step(history.undo());
$("redo").onclick = () => step(history.redo());
$("save").onclick = save;
$("fit").onclick = () => plan.fit();
$("help-button").onclick = () => $("help").showModal();
$("plan").addEventListener("contextmenu", (event) => event.preventDefault());
for (const button of $("tools").children) button.onclick = () => { setTool(button.dataset.tool); $("plan").focus(); };
for (const id of ["show-paths", "show-names"]) $(id).onchange = show;
$("resolution").onchange = look;
$("text").addEventListener("beforeinput", (event) => {
  if (event.inputType === "historyUndo" || event.inputType === "historyRedo") {
    event.preventDefault();
    step(event.inputType === "historyUndo" ? history.undo() : history.redo());
  }
});

async function begin() {
  const file = await api.file();
  Object.assign(state, { text: file.text, saved: file.stamp ? file.text : "", stamp: file.stamp, name: file.name, equipment: { robot: file.robot, camera: file.camera } });
  history = new History(file.text);
  $("file-name").textContent = file.name;
  $("file-name").title = file.path;
  depth.setCamera(file.camera);
  text.set(file.text);
  const answer = await api.read(file.text);
  const first = Array.isArray(answer.scene?.starts) ? answer.scene.starts[0] : null;
  if (first) {
    const goal = Array.isArray(answer.scene.goals) ? middle(answer.scene.goals[0]) : [0, 0];
    const ahead = subtract(goal, first.at);
    const yaw = first.yaw_deg !== null ? radians(first.yaw_deg) : Math.atan2(ahead[1], ahead[0]);
    state.pose = [...rounded(add(first.at, rotate([0.5, 0], yaw))), yaw]; // beside the start, so that both can be taken hold of
  }
  take(answer);
  show();
  plan.fit();
}

begin().catch(failed);
