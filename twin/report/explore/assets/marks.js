// Fault marks in the plots: a line at the onset with a handle at the height of the magnitude; both can be dragged.

const WIDE = 40;
const STEP_S = 0.05;
const STEPS = 40;

export class FaultMarks {
  /** `faults` holds the list of faults. */
  constructor(faults) {
    this.faults = faults;
    this.nodes = new Map();
  }

  /** Add a mark for each fault to each of `plots`. */
  place(plots) {
    const { list } = this.faults;
    for (const plot of this.nodes.keys()) if (!plots.includes(plot)) this.nodes.delete(plot);
    for (const plot of plots) {
      const nodes = this.nodes.get(plot) ?? [];
      while (nodes.length > list.length) nodes.pop().remove();
      while (nodes.length < list.length) nodes.push(this.mark(plot, nodes.length));
      this.nodes.set(plot, nodes);
      nodes.forEach((node, number) => this.put(node, plot, list[number]));
    }
  }

  put(node, plot, fault) {
    const { onset_s: onset, magnitude, kind, target } = fault;
    const { from, to } = plot.span;
    node.hidden = !plot.width || !(onset >= from && onset <= to);
    if (node.hidden) return;
    node.style.left = `${plot.x(onset)}px`;
    const range = this.faults.range(kind);
    node.firstChild.style.top = range ? `${100 * (1 - (magnitude - range.low) / (range.high - range.low))}%` : "50%";
    const text = `${onset} s${range ? `, ${magnitude} ${range.unit}` : ""}`;
    node.title = `${kind} of ${target}: ${text}`;
    node.setAttribute("aria-label", `${kind} of ${target}: left and right move its onset${range ? ", up and down its size" : ""}`);
    node.setAttribute("aria-valuenow", onset);
    node.setAttribute("aria-valuetext", text);
  }

  mark(plot, number) {
    const node = made("div", { className: "fault-mark", tabIndex: 0 }, made("span", { className: "grip" }));
    node.setAttribute("role", "slider");
    node.addEventListener("pointerdown", (event) => this.grab(event, plot, number));
    node.addEventListener("keydown", (event) => this.key(event, number));
    // held keys count as one movement
    for (const end of ["keyup", "blur"]) node.addEventListener(end, () => this.release());
    plot.stage.append(node);
    return node;
  }

  /** Drag until the button is released; plots may be rebuilt meanwhile. */
  grab(event, plot, number) {
    if (event.button !== 0) return;
    event.preventDefault();
    event.stopPropagation();
    // keys continue from here
    event.currentTarget.focus({ preventScroll: true });
    const before = { ...this.faults.list[number] };
    const box = plot.stage.getBoundingClientRect();
    const range = this.faults.range(before.kind);
    const perPixel = [(plot.span.to - plot.span.from) / (plot.width - WIDE), range ? (range.high - range.low) / box.height : 0];
    const move = (now, over) => {
      const onset = before.onset_s + perPixel[0] * (now.clientX - event.clientX);
      this.change(number, onset, range && before.magnitude - perPixel[1] * (now.clientY - event.clientY), over);
    };
    const ending = new AbortController();
    const hear = (name, act) => window.addEventListener(name, act, { signal: ending.signal });
    hear("pointermove", (now) => move(now, false));
    for (const name of ["pointerup", "pointercancel"])
      hear(name, (now) => {
        ending.abort();
        move(now, true);
      });
  }

  key(event, number) {
    const { onset_s: onset, magnitude, kind } = this.faults.list[number];
    const range = this.faults.range(kind);
    const step = range ? (range.high - range.low) / STEPS : 0;
    const moves = { ArrowLeft: [-STEP_S, 0], ArrowRight: [STEP_S, 0], ArrowUp: [0, step], ArrowDown: [0, -step] };
    const [later, more] = moves[event.key] ?? [];
    if (later === undefined) return;
    event.preventDefault();
    event.stopPropagation();
    this.moving = true;
    this.change(number, onset + later, range && magnitude + more, false);
  }

  release() {
    if (this.moving) this.faults.changed(this.faults.list, true);
    this.moving = false;
  }

  change(number, onset, magnitude, over) {
    const { duration, list } = this.faults;
    const { low, high } = this.faults.range(list[number].kind) ?? {};
    const more = { onset_s: Number(Math.min(duration, Math.max(0, onset)).toFixed(3)) };
    if (magnitude !== null) more.magnitude = Number(Math.min(high, Math.max(low, magnitude)).toPrecision(4));
    this.faults.change(number, more, over);
  }
}
