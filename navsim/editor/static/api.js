// Questions to the server. Each answer is an object; a refusal is an ApiError with the server's sentence.

export class ApiError extends Error {
  constructor(status, answer) {
    super(answer.error || `the server answered ${status}`);
    this.status = status;
    this.answer = answer;
  }
}

/** The server cannot be reached. */
export class GoneError extends Error {}

async function request(path, options) {
  let response;
  try {
    response = await fetch(path, { cache: "no-store", ...options });
  } catch {
    throw new GoneError("The editor's server has ended.");
  }
  if (!response.ok) {
    let answer = {};
    try { answer = await response.json(); } catch { /* no sentence came with it */ }
    throw new ApiError(response.status, answer);
  }
  return response;
}

async function ask(path, question) {
  const body = JSON.stringify(question);
  return request(path, { method: "POST", headers: { "Content-Type": "application/json" }, body });
}

export const file = async () => (await request("api/file")).json();
export const read = async (text) => (await ask("api/read", { text })).json();
export const edit = async (text, edits) => (await ask("api/edit", { text, edits })).json();
export const paths = async (world) => (await ask("api/paths", { world })).json();
export const oddities = async (world) => (await ask("api/oddities", { world })).json();
export const save = async (text, stamp) => (await ask("api/save", { text, stamp })).json();

/** Depth in millimetres, row by row. */
export async function depth(world, pose, width, height) {
  const response = await ask("api/depth", { world, pose, width, height });
  const view = new DataView(await response.arrayBuffer());
  return Uint16Array.from({ length: width * height }, (_, i) => view.getUint16(2 * i, true));
}

/** Wraps a question so that one is under way at a time and only the latest waiting one is asked next. */
export function latest(run) {
  let waiting = null, busy = false;
  return async function next(...args) {
    waiting = args;
    if (busy) return;
    busy = true;
    try {
      while (waiting) {
        const now = waiting;
        waiting = null;
        await run(...now);
      }
    } finally {
      busy = false;
    }
  };
}
