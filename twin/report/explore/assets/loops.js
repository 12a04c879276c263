// Control loops at an operating point: table of margins, Bode and Nyquist diagrams of the open loops.

import { curve, EDGE, framed, line } from "./diagram.js";

const HEIGHT = 190;
const QUIET = 400;
const DECADES = ["0.01", "0.1", "1", "10", "100", "1000"];

const said = (value, unit, digits = 3) => (value === null ? "none" : `${value.toPrecision(digits)} ${unit}`);

export class Loops {
  /** `ask` requests the loops, after a pause without changes or when the previous answer has arrived; `redraw` is
   * called when the margin changes. */
  constructor(box, ask, redraw) {
    Object.assign(this, { box, ask, redraw, margin: null, reason: "not there yet" });
    this.point = made("select", {});
    this.point.setAttribute("aria-label", "Operating point");
    this.table = made("div", { className: "scroll", tabIndex: 0, role: "region", ariaLabel: "Loops" });
    this.canvases = ["Gain (dB) over frequency (Hz)", "Phase (deg) over frequency (Hz)", "Nyquist diagram of the open loops; the cross is -1"].map((text) => {
      const canvas = made("canvas", { role: "img" });
      canvas.setAttribute("aria-label", text);
      return made("figure", { className: "plot" }, made("figcaption", {}, text), made("div", { className: "stage" }, canvas));
    });
    this.problem = made("p", { className: "bad", role: "status" });
    this.canvases.forEach((figure) => figure.classList.add("loop"));
    box.append(this.point, this.problem, this.table, made("div", { className: "diagrams" }, ...this.canvases));
    box.addEventListener("toggle", () => (this.found ? this.draw() : this.changed()));
    this.point.addEventListener("change", () => {
      this.chosen = Number(this.point.value);
      this.changed();
    });
    new ResizeObserver(() => this.draw()).observe(box);
  }

  /** Mark the answer as outdated and request a new one. */
  changed() {
    this.stale = Boolean(this.waiting);
    this.reason = "being computed";
    if (this.waiting) return;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => {
      this.waiting = this.ask(this.chosen);
      this.box.ariaBusy = String(Boolean(this.waiting));
    }, this.box.open ? 0 : QUIET);
  }

  /** The tile above the plots with the smallest gain margin of all loops. */
  get tile() {
    return ["loops' margin", "dB", this.margin, this.reason, 1, "smallest gain margin of all loops at the operating point; see Loops below"];
  }

  /** Forget the pending request, and repeat it if the answer is outdated. */
  lost() {
    this.waiting = 0;
    this.box.ariaBusy = "false";
    if (this.stale) this.changed();
  }

  take(answer) {
    this.lost();
    this.problem.textContent = answer.refused ?? answer.failed ?? (answer.stable ? "" : "Unstable at this point: there are no margins.");
    this.box.classList.toggle("old", !answer.loops);
    const gains = (answer.loops ?? []).map(({ gain_dB }) => gain_dB).filter((gain) => gain !== null);
    this.margin = gains.length ? Math.min(...gains) : null;
    this.reason = gains.length ? "" : answer.loops ? (answer.stable ? "none is limited" : "unstable") : "no linear model";
    this.redraw();
    if (!answer.loops) return;
    this.found = answer;
    this.point.replaceChildren(...answer.points.map((text, value) => made("option", { value }, text)));
    this.point.value = answer.point;
    const head = made("tr", {}, ...["loop", "gain margin", "phase margin", "crossover"].map((text) => made("th", {}, text)));
    const rows = answer.loops.map((loop, number) => {
      const name = made("th", {}, made("span", { className: "loop-name" }, loop.name));
      mark(name.firstChild, number);
      const values = [said(loop.gain_dB, "dB"), said(loop.phase_deg, "deg"), said(loop.crossover_Hz, "Hz")];
      return made("tr", {}, name, ...values.map((text) => made("td", {}, text)));
    });
    this.table.replaceChildren(made("table", {}, made("thead", {}, head), made("tbody", {}, ...rows)));
    this.draw();
  }

  /** Return a column of the block: 0 for frequencies, then gain and phase of each loop. */
  column(number) {
    const { samples, count } = this.found;
    return samples.subarray(number * count, (number + 1) * count);
  }

  draw() {
    if (!this.found || !this.box.open) return;
    const f = this.column(0);
    const span = { from: Math.log10(Math.max(f[0], 0.01)), to: Math.log10(f.at(-1)) };
    const [gain, phase, nyquist] = this.canvases.map((figure) => figure.querySelector("canvas"));
    const loops = this.found.loops.map((_, number) => [this.column(1 + 2 * number), this.column(2 + 2 * number)]);
    this.over(gain, f, span, loops.map(([g]) => g), -60, 60);
    this.over(phase, f, span, loops.map(([, p]) => p), -270, 0);
    this.nyquist(nyquist, loops);
  }

  over(canvas, f, span, curves, bottom, top) {
    const frame = framed(canvas, HEIGHT, bottom, top);
    const { pen, width, floor, y } = frame;
    const x = (log) => EDGE.left + ((log - span.from) / (span.to - span.from)) * (width - EDGE.left - EDGE.right);
    for (const text of DECADES) {
      const log = Math.log10(Number(text));
      if (log < span.from || log > span.to) continue;
      line(pen, [[x(log), EDGE.top], [x(log), floor]]);
      pen.fillText(text, x(log), floor + 6);
    }
    curves.forEach((values, number) => curve(number, Array.from(values, (v, i) => [x(Math.log10(f[i])), y(v)]), frame));
  }

  nyquist(canvas, loops) {
    const frame = framed(canvas, HEIGHT, -2, 2);
    const { pen, width, floor, y } = frame;
    const scale = (floor - EDGE.top) / 4;
    const zero = EDGE.left + (width - EDGE.left - EDGE.right) / 2;
    const x = (value) => zero + scale * value;
    for (let value = -4; value <= 4; value++) if (x(value) > EDGE.left && x(value) < width - EDGE.right) pen.fillText(value, x(value), floor + 6);
    loops.forEach(([gain, phase], number) => {
      const points = Array.from(gain, (dB, i) => {
        const [size, angle] = [10 ** (dB / 20), (phase[i] * Math.PI) / 180];
        return [x(size * Math.cos(angle)), y(size * Math.sin(angle))];
      });
      curve(number, points, frame);
    });
    pen.strokeStyle = color("--vermilion");
    pen.lineWidth = 2;
    line(pen, [[x(-1) - 5, y(0) - 5], [x(-1) + 5, y(0) + 5]]);
    line(pen, [[x(-1) - 5, y(0) + 5], [x(-1) + 5, y(0) - 5]]);
  }
}
