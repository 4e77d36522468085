// The properties of what is selected, or of the room: numbers with their units.

import { settled } from "./geometry.js";

const shown = (value) => String(Math.round(value * 1e6) / 1e6);

export class Panel {
  /** @param on { set(where, values), remove(), duplicate(), pose(pose) } */
  constructor(root, on) {
    this.root = root;
    this.on = on;
  }

  element(name, properties = {}, ...children) {
    const element = Object.assign(document.createElement(name), properties);
    element.append(...children);
    return element;
  }

  show({ scene, selection, pose, equipment, frozen }) {
    const key = JSON.stringify([selection, frozen]);
    const active = this.root.contains(document.activeElement) ? document.activeElement : null;
    if (active && this.key === key && active.value !== active.defaultValue && active.type !== "checkbox") return; // being typed
    const focused = this.key === key ? active?.name : null;
    this.key = key;
    this.frozen = frozen;
    const content = !scene ? [] : selection.length === 0 ? this.room(scene)
      : selection.length > 1 ? this.several(selection)
        : selection[0].list === "camera" ? this.camera(pose, equipment)
          : this.entry(scene, selection[0], equipment);
    this.root.replaceChildren(...content);
    if (focused) this.root.querySelector(`[name="${focused}"]`)?.focus();
  }

  heading(kind, name) {
    return this.element("h2", {}, this.element("span", { className: "kind", textContent: kind }), name ? ` ${name}` : "");
  }

  row(label, ...fields) {
    return this.element("div", { className: "row" }, this.element("span", { textContent: label }), this.element("span", { className: "fields" }, ...fields));
  }

  number(name, value, unit, commit, options = {}) {
    const input = this.element("input", {
      type: "number", name, step: options.step ?? 0.05, value: value === null ? "" : shown(value),
      placeholder: options.placeholder ?? "", disabled: this.frozen, title: options.title ?? "",
    });
    if (options.min !== undefined) input.min = options.min;
    const last = (input.defaultValue = input.value);
    input.addEventListener("change", () => {
      input.defaultValue = input.value;
      if (input.value === "" && options.optional) return commit(null);
      const number = input.valueAsNumber;
      if (!Number.isFinite(number)) input.value = last;
      else commit(number);
    });
    return this.element("label", { className: "number" }, options.prefix ? this.element("i", { textContent: options.prefix }) : "", input, this.element("i", { textContent: unit }));
  }

  word(name, value, placeholder, commit) {
    const input = this.element("input", { type: "text", name, value, defaultValue: value, placeholder, disabled: this.frozen });
    input.addEventListener("change", () => {
      input.defaultValue = input.value;
      commit(input.value.trim());
    });
    return input;
  }

  buttons() {
    const button = (text, title, run) => this.element("button", { textContent: text, title, disabled: this.frozen, onclick: run });
    return this.element("div", { className: "buttons" }, button("Duplicate", "Ctrl+D", () => this.on.duplicate()), button("Delete", "Delete", () => this.on.remove()));
  }

  note(text) {
    return this.element("p", { className: "note", textContent: text });
  }

  pair(label, name, values, commit, options = {}) {
    const [a, b] = options.names ?? ["x", "y"];
    return this.row(label,
      this.number(`${name}-0`, values[0], "m", (value) => commit([value, values[1]]), { ...options, prefix: a }),
      this.number(`${name}-1`, values[1], "m", (value) => commit([values[0], value]), { ...options, prefix: b }));
  }

  room(scene) {
    const set = (values) => this.on.set([], values), { walls } = scene;
    const box = this.element("input", { type: "checkbox", checked: walls !== null, disabled: this.frozen, name: "walls" });
    box.addEventListener("change", () => set({ walls: box.checked ? { height: 2, thickness: 0.1 } : "none" }));
    const count = (list) => (Array.isArray(scene[list]) ? String(scene[list].length) : "random, drawn each episode");
    return [
      this.heading("Room"),
      this.row("name", this.word("name", scene.name, "the file's name", (name) => set({ name: name || null }))),
      this.pair("size", "size", scene.size, (size) => set({ size }), { min: 0, step: 0.5 }),
      this.row("walls", box, ...(walls ? [
        this.number("wall-height", walls.height, "m high", (height) => set({ walls: { ...scene.walls_given, height } }), { min: 0, step: 0.1 }),
        this.number("wall-thickness", walls.thickness, "m thick", (thickness) => set({ walls: { ...scene.walls_given, thickness } }), { min: 0, step: 0.05 }),
      ] : [])),
      this.row("obstacles", count("obstacles")),
      this.row("starts", count("starts")),
      this.row("goals", count("goals")),
      this.note(scene.obstacles.length ? "Select something to change it. The yellow robot is the camera." : "An empty room. Add a box or a cylinder with the tools above the plan."),
    ];
  }

  several(selection) {
    return [this.heading(`${selection.length} selected`), this.note("Drag one of them, or use the arrows, to move all."), this.buttons()];
  }

  camera([x, y, yaw], { camera }) {
    const set = (pose) => this.on.pose(pose), turn = (yaw * 180) / Math.PI;
    return [
      this.heading("Camera"),
      this.row("at", this.number("x", x, "m", (value) => set([value, y, yaw]), { prefix: "x" }), this.number("y", y, "m", (value) => set([x, value, yaw]), { prefix: "y" })),
      this.row("heading", this.number("yaw", Math.round(turn * 10) / 10, "°", (value) => set([x, y, (value * Math.PI) / 180]), { step: 5 })),
      this.note(`Sits ${camera.mount_z} m above the floor and sees ${camera.horizontal_fov_deg}° wide. It is not part of the world.`),
    ];
  }

  entry(scene, { list, index }, equipment) {
    const thing = scene[list][index], set = (values) => this.on.set([list, index], values), rows = [];
    if (list !== "obstacles") {
      rows.push(this.heading(list === "starts" ? "Start" : "Goal", index));
      rows.push(this.pair("at", "at", thing.at, (at) => set({ at })));
      if (list === "starts") {
        rows.push(this.row("heading", this.number("yaw", thing.yaw_deg, "°", (yaw) => set({ yaw_deg: yaw }), { step: 5, optional: true, placeholder: "drawn" })));
        rows.push(this.note(thing.yaw_deg === null ? "No heading: each episode draws one with a metre of free view." : "Empty the heading to have it drawn each episode."));
      }
    } else {
      rows.push(this.heading(thing.kind, thing.named ? "" : thing.name));
      rows.push(this.row("name", this.word("name", thing.named ? thing.name : "", thing.named ? "" : thing.name, (name) => set({ name: name || null }))));
      if (thing.at) rows.push(this.pair("at", "at", thing.at, (at) => set({ at })));
      if (thing.size) rows.push(this.pair("size", "size", thing.size, (size) => set({ size }), { min: 0 }));
      if (thing.radius !== undefined) rows.push(this.row("radius", this.number("radius", thing.radius, "m", (radius) => set({ radius }), { min: 0, step: 0.01 })));
      if (thing.kind === "box") rows.push(this.row("turned", this.number("yaw", thing.yaw_deg, "°", (yaw) => set({ yaw_deg: yaw }), { step: 5 })));
      rows.push(this.row("height", this.number("height", thing.height, "m", (height) => set({ height }), { min: 0 })));
      rows.push(this.row("base", this.number("base", thing.base, "m", (base) => set({ base }), { min: 0 })));
      rows.push(this.note(this.meaning(thing, equipment)));
      if (thing.points) rows.push(this.note(`${thing.points.length} corners: drag them, drag a dot between two to make a new one, double-click one to take it away.`));
      for (const key of ["motion", "pushable"]) {
        if (thing[key]) rows.push(this.row(key, this.element("code", { textContent: Object.entries(settled(thing[key])).map(([name, value]) => `${name}: ${JSON.stringify(value).replaceAll('"', "")}`).join(", ") })));
      }
    }
    if (thing.shared?.length) rows.push(this.note(`What is changed here changes ${thing.shared.join(", ")} too: the text shares it by an alias.`));
    return [...rows, this.buttons()];
  }

  meaning({ base, height }, { robot, camera }) {
    const top = `Top at ${shown(base + height)} m`;
    if (base >= robot.height) return `${top}. The robot (${robot.height} m) drives under it.`;
    if (base + height <= camera.mount_z) return `${top}, lower than the camera (${camera.mount_z} m).`;
    return base > 0 ? `${top}. It hangs too low for the robot (${robot.height} m).` : `${top}.`;
  }
}
