// Panel of a followed robot: status, its pressing force and the twin's, and the twin's proposal.

import { curve, EDGE, framed, line } from "./diagram.js";

const HEIGHT = 110;
const LEAST = 1;
const READ = 10000;

const put = (node, text) => {
  if (node.textContent !== text) node.textContent = text;
};

export class Robot {
  /** `ask` sends, `say` shows a sentence, `state` gives the present one, `go` takes another one. */
  constructor(box, ask, say, state, go) {
    Object.assign(this, { box, ask, say, state, go });
    const text = (id) => box.querySelector(`.${id}`);
    this.parts = Object.fromEntries(["line", "problem", "events", "proposal", "accepted", "forces"].map((id) => [id, text(id)]));
    this.accept = box.querySelector("button.accept");
    this.use = box.querySelector("button.use");
    this.canvas = box.querySelector("canvas");
    this.refused = "";
    this.accept.addEventListener("click", () => {
      this.accept.disabled = this.waiting = Boolean(this.ask({ op: "accept", proposal: this.now.proposal }));
    });
    this.use.addEventListener("click", () => this.ask({ op: "adopt", state: this.state() }));
    new ResizeObserver(() => this.draw()).observe(box);
  }

  take(answer) {
    if (answer.op === "accept") {
      this.waiting = false;
      this.refused = answer.refused ?? "";
      this.put();
      setTimeout(() => (this.refused = ""), READ);
    } else if (answer.op === "adopt") {
      if (answer.state) {
        this.go(answer.state);
        this.say("The robot's accepted values are set; Undo takes them back.");
      } else if (!answer.outdated) this.say(answer.refused ?? answer.failed, true);
    } else {
      this.now = answer;
      this.put();
      this.draw();
    }
  }

  put() {
    if (!this.now) return;
    const { problem, watches, line: how, none, proposal, asked, accepted, events } = this.now;
    const { parts } = this;
    this.box.hidden = false;
    this.box.classList.toggle("old", Boolean(problem));
    put(parts.line, how);
    put(parts.problem, [...new Set([problem || watches, this.refused])].filter(Boolean).join(" "));
    put(parts.proposal, asked ? `Asked: ${proposal}` : proposal ? `Twin proposes: ${proposal}` : none);
    parts.proposal.hidden = Boolean(problem && !proposal);
    this.accept.hidden = !proposal;
    this.accept.disabled = Boolean(problem || watches || asked || this.waiting);
    put(parts.accepted, accepted.length ? `Accepted by twin: ${accepted.join("; ")}` : "");
    this.use.hidden = accepted.length === 0;
    const old = [...parts.events.children].map((item) => item.textContent);
    if (old.join("\n") !== events.join("\n")) parts.events.replaceChildren(...events.map((text) => made("li", {}, text)));
  }

  /** Draw the pressing forces of the last seconds. */
  draw() {
    const { curves = [], count, span, samples } = this.now ?? {};
    this.canvas.parentElement.hidden = curves.length === 0;
    if (!curves.length) return;
    const values = curves.map((_, number) => samples.subarray(number * count, (number + 1) * count));
    const there = Array.from(samples).filter(Number.isFinite);
    const [low, high] = [Math.min(...there), Math.max(...there)];
    const pad = Math.max(0.06 * (high - low), LEAST / 2);
    const frame = framed(this.canvas, HEIGHT, low - pad, high + pad);
    const { pen, width, floor, y } = frame;
    const x = (share) => EDGE.left + share * (width - EDGE.left - EDGE.right);
    for (const [t, text] of ticks(-span, 0, 5)) {
      line(pen, [[x(1 + t / span), EDGE.top], [x(1 + t / span), floor]]);
      pen.fillText(t === 0 ? "now" : `${text} s`, Math.min(x(1 + t / span), width - 14), floor + 6);
    }
    values.forEach((forces, number) => curve(number, Array.from(forces, (F, i) => [x(i / (count - 1)), y(F)]), frame));
    const labels = curves.map((name, number) => {
      const newest = values[number].at(-1);
      const label = made("span", { className: "loop-name" }, `${name} ${Number.isFinite(newest) ? newest.toFixed(2) : "-"} N`);
      mark(label, number);
      return label;
    });
    this.parts.forces.replaceChildren(...labels);
  }
}
