// State of the page: changes against the file, pinned states, undo and redo, and the URL that stores them.

const LONGEST = 20000;
const MOST = 200;
const MOST_PINS = 6;
const MOST_FAULTS = 8;
const STEPS = 200;

export const fresh = () => ({ set: {}, drive: "", body: "", faults: [] });
export const copied = (state) => ({ ...state, set: { ...state.set }, faults: state.faults.map((one) => ({ ...one })) });
const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);

const isPlain = (value) => ["number", "string", "boolean"].includes(typeof value);

/** Parse a state from untrusted data; null if invalid. */
function understood(found) {
  if (typeof found !== "object" || found === null) return null;
  const { set = {}, drive = "", body = "", faults = [] } = found;
  if (typeof drive !== "string" || typeof body !== "string") return null;
  if (typeof set !== "object" || set === null || Array.isArray(set)) return null;
  const pairs = Object.entries(set);
  if (pairs.length > MOST || !pairs.every(([, value]) => isPlain(value))) return null;
  if (!Array.isArray(faults) || faults.length > MOST_FAULTS) return null;
  const broken = faults.map((one) => ({ kind: one?.kind, target: one?.target, onset_s: one?.onset_s, magnitude: one?.magnitude }));
  if (!broken.every((one) => typeof one.kind === "string" && typeof one.target === "string")) return null;
  return { set: Object.fromEntries(pairs), drive, body, faults: broken };
}

const LAYOUTS = ["", "fig4"];
const MOST_PANELS = 100;

/** Parse a view: the layout, and the titles of plots; null for the first plots. */
export const plainView = () => ({ layout: "", panels: null });

/** Return the URL fragment of a state, its pins and view; "" if all are empty. */
export function written(state, pins, { layout, panels } = plainView()) {
  const parts = new URLSearchParams();
  for (const [key, value] of Object.entries(state.set)) parts.append(key, JSON.stringify(value));
  if (state.drive) parts.append("drive", state.drive);
  if (state.body) parts.append("body", state.body);
  for (const fault of state.faults) parts.append("fault", JSON.stringify(fault));
  for (const pin of pins) parts.append("pin", JSON.stringify(pin));
  if (layout) parts.append("layout", layout);
  if (panels) parts.append("panels", JSON.stringify(panels));
  return parts.toString();
}

/** Parse [state, pins, view] from a URL fragment, which is untrusted; null if invalid. */
export function read(text) {
  if (text.length > LONGEST) return null;
  const state = fresh();
  const set = [];
  const pins = [];
  const view = plainView();
  for (const [key, value] of new URLSearchParams(text)) {
    if (key === "drive" || key === "body") {
      state[key] = value;
      continue;
    }
    if (key === "layout" && LAYOUTS.includes(value)) {
      view.layout = value;
      continue;
    }
    let content;
    try {
      content = JSON.parse(value);
    } catch {
      return null;
    }
    if (key === "fault") state.faults.push(content);
    else if (key === "panels") {
      if (!Array.isArray(content) || content.length > MOST_PANELS || !content.every((title) => typeof title === "string")) return null;
      view.panels = content;
    }
    else if (key !== "pin") set.push([key, content]);
    else if (pins.length < MOST_PINS && typeof content?.name === "string") {
      const { name, log, shift_s = 0 } = content;
      const inner = content.run === undefined && log === undefined ? understood(content.state) : null;
      if (typeof content.run === "string") pins.push({ name, run: content.run });
      else if (typeof log === "string" && typeof shift_s === "number") pins.push({ name, log, shift_s });
      else if (inner) pins.push({ name, state: inner });
      else return null;
    } else return null;
  }
  const checked = understood({ ...state, set: Object.fromEntries(set) });
  return checked && [checked, pins, view];
}

/** Current state with its undo and redo steps. */
export class History {
  constructor(state) {
    this.now = copied(state);
    this.before = [];
    this.after = [];
    this.kept = copied(state);
  }

  /** Add the changes since the last step as an undo step. */
  step() {
    if (same(this.now, this.kept)) return false;
    this.before.push(this.kept);
    this.before.splice(0, this.before.length - STEPS);
    this.after = [];
    this.kept = copied(this.now);
    this.stepped = performance.now();
    return true;
  }

  /** Remove the last undo step if it is younger than `age` (ms). */
  forget(age) {
    if (this.before.length && performance.now() - this.stepped < age) this.kept = this.before.pop();
  }

  go(from, to) {
    if (!from.length) return false;
    to.push(this.kept);
    this.kept = from.pop();
    this.now = copied(this.kept);
    return true;
  }

  undo() {
    this.step();
    return this.go(this.before, this.after);
  }

  redo() {
    return this.go(this.after, this.before);
  }
}

export { MOST_FAULTS, MOST_PINS };
