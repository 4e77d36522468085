// Undo and redo over the whole text, whoever changed it.

const PAUSE = 900; // milliseconds within which changes of one kind are one step

export class History {
  constructor(text) {
    this.steps = [{ text, selection: [] }];
    this.place = 0;
    this.kind = null;
    this.time = 0;
  }

  get canUndo() { return this.place > 0; }
  get canRedo() { return this.place < this.steps.length - 1; }

  /** @param kind changes of one kind in a row, within a pause, are undone together; null is always a step of its own. */
  push(text, selection, kind = null) {
    if (text === this.steps[this.place].text) return;
    const now = performance.now(), joins = kind !== null && kind === this.kind && now - this.time < PAUSE && !this.canRedo;
    this.steps.length = this.place + 1;
    if (joins && this.place > 0) this.steps[this.place] = { text, selection };
    else this.steps.push({ text, selection });
    if (this.steps.length > 1000) this.steps.shift();
    this.place = this.steps.length - 1;
    this.kind = kind;
    this.time = now;
  }

  undo() { return this.canUndo ? this.go(-1) : null; }
  redo() { return this.canRedo ? this.go(1) : null; }

  go(by) {
    this.place += by;
    this.kind = null;
    return this.steps[this.place];
  }
}
