// The text: a textarea over a coloured copy of itself, with line numbers and marks under problems.

const TOKENS = /((?:^|\s)#.*$)|("(?:[^"\\]|\\.)*"|'(?:[^']|'')*')|([&*][\w-]+)|(<<|[A-Za-z_]\w*)(?=\s*:(?:\s|$))|([-+]?\.?\d[\d.]*(?:[eE][-+]?\d+)?)(?![\w.])/g;
const KINDS = ["", "comment", "string", "anchor", "key", "number"];
const MOST_COLOURED = 200000;

const escaped = (text) => text.replace(/[&<>]/g, (sign) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;" })[sign]);

/** A place in a text counted in characters, as the server counts, in the units that a textarea counts in. */
export function unitOffset(text, characters) {
  if (!/[\ud800-\udbff]/.test(text)) return characters;
  let units = 0;
  for (const character of text) {
    if (characters-- <= 0) break;
    units += character.length;
  }
  return units;
}

function coloured(line) {
  let out = "", position = 0;
  for (const match of line.matchAll(TOKENS)) {
    const kind = KINDS[match.findIndex((group, i) => i > 0 && group !== undefined)];
    out += `${escaped(line.slice(position, match.index))}<span class="${kind}">${escaped(match[0])}</span>`;
    position = match.index + match[0].length;
  }
  return out + escaped(line.slice(position));
}

export class TextView {
  /** @param on { typed(text), caret(offset) } */
  constructor({ area, highlight, gutter }, on) {
    Object.assign(this, { area, highlight, gutter });
    this.problems = [];
    this.spans = [];
    area.addEventListener("input", () => { this.draw(); on.typed(area.value); });
    area.addEventListener("scroll", () => this.follow());
    for (const event of ["click", "keyup"]) area.addEventListener(event, () => on.caret(area.selectionStart));
    area.addEventListener("keydown", (event) => {
      if (event.key !== "Tab" || event.shiftKey || event.ctrlKey || event.altKey) return;
      event.preventDefault();
      const { selectionStart: start, selectionEnd: end, value } = area;
      area.value = `${value.slice(0, start)}  ${value.slice(end)}`;
      area.setSelectionRange(start + 2, start + 2);
      area.dispatchEvent(new Event("input"));
    });
  }

  set(text) {
    if (this.area.value === text) return;
    const { scrollTop, scrollLeft, selectionStart } = this.area;
    this.area.value = text;
    this.area.setSelectionRange(selectionStart, selectionStart);
    this.area.scrollTop = scrollTop;
    this.area.scrollLeft = scrollLeft;
    this.draw();
  }

  /** @param problems of the text; @param spans [start, end] of what is selected, in characters. */
  mark(problems, spans) {
    this.problems = problems;
    this.spans = spans;
    this.draw();
  }

  draw() {
    const text = this.area.value, lines = text.split("\n");
    const bad = new Map();
    for (const { line, severity } of this.problems) if (bad.get(line) !== "error") bad.set(line, severity);
    const chosen = new Set();
    for (const span of this.spans) {
      const [first, last] = span.map((end) => text.slice(0, unitOffset(text, end)).split("\n").length);
      for (let line = first; line <= last; line++) chosen.add(line);
    }
    const plain = text.length > MOST_COLOURED;
    this.highlight.innerHTML = lines.map((line, i) => {
      const classes = ["line", chosen.has(i + 1) ? "chosen" : "", bad.has(i + 1) ? `bad ${bad.get(i + 1)}` : ""].join(" ");
      return `<span class="${classes}">${plain ? escaped(line) : coloured(line)}\n</span>`;
    }).join("");
    this.gutter.innerHTML = lines.map((_, i) => `<span class="${bad.has(i + 1) ? `bad ${bad.get(i + 1)}` : ""}">${i + 1}</span>`).join("");
    this.follow();
  }

  follow() {
    this.highlight.style.transform = `translate(${-this.area.scrollLeft}px, ${-this.area.scrollTop}px)`;
    this.gutter.style.transform = `translateY(${-this.area.scrollTop}px)`;
  }

  /** Shows a place, in characters, without taking the focus. */
  reveal(offset) {
    const line = this.area.value.slice(0, unitOffset(this.area.value, offset)).split("\n").length - 1;
    const height = parseFloat(getComputedStyle(this.area).lineHeight);
    const top = line * height, { scrollTop, clientHeight } = this.area;
    if (top < scrollTop + height || top > scrollTop + clientHeight - 2 * height) this.area.scrollTop = Math.max(0, top - clientHeight / 3);
  }

  /** Selects what a problem is about; lines and columns count from 1. */
  jump(line, column, end) {
    const lines = this.area.value.split("\n"), own = lines[line - 1] ?? "";
    const before = lines.slice(0, line - 1).reduce((sum, each) => sum + each.length + 1, 0);
    const [first, last] = [column, end].map((place) => before + Math.min(unitOffset(own, place - 1), own.length));
    this.area.focus();
    this.area.setSelectionRange(first, last);
    this.reveal(first);
  }
}
