// A map over two keys, filled coarse to fine while nothing else is wanted; a click goes there.

import { valueAt } from "./sliders.js";

const SIDE = 16;
const QUIET = 400;
const HEIGHT = 320;
const EDGE = { left: 60, right: 12, top: 8, bottom: 34 };
const FINE = 1000;

/** Cells, each with the size of the square that it stands for until finer ones come. */
function coarseToFine() {
  const seen = new Set();
  const cells = [];
  for (let size = SIDE / 2; size >= 1; size /= 2)
    for (let i = 0; i < SIDE; i += size)
      for (let j = 0; j < SIDE; j += size)
        if (!seen.has(i * SIDE + j)) {
          seen.add(i * SIDE + j);
          cells.push({ i, j, size });
        }
  return cells;
}

export class Mapped {
  /** `ask` is called with a state and its number, `go` with a state; `now` gives the present one. */
  constructor(box, ask, go, now) {
    Object.assign(this, { box, ask, go, now, number: 0, found: [] });
    [this.x, this.y, this.which] = ["Key along x", "Key along y", "Number"].map((text) => {
      const select = made("select", {});
      select.setAttribute("aria-label", text);
      return select;
    });
    this.canvas = made("canvas", { role: "img", tabIndex: 0 });
    this.canvas.setAttribute("aria-label", "Map over two keys; a click goes there");
    this.note = made("output", {}, "");
    const stage = made("div", { className: "map" }, this.canvas);
    box.append(made("div", { className: "bar" }, this.x, this.y, this.which), stage, made("p", { className: "hint" }, this.note));
    box.addEventListener("toggle", () => this.changed());
    for (const select of [this.x, this.y]) select.addEventListener("change", () => this.changed());
    this.which.addEventListener("change", () => this.draw());
    this.canvas.addEventListener("pointermove", (event) => this.point(event));
    this.canvas.addEventListener("click", (event) => {
      const cell = this.cell(event);
      if (cell) this.go(this.state(cell));
    });
    new ResizeObserver(() => this.draw()).observe(box);
  }

  describe(sliders) {
    const numbers = sliders.filter(({ kind }) => ["number", "whole", "pace"].includes(kind));
    const before = [this.x.value, this.y.value];
    // also after the server was started anew
    this.form = "";
    this.sliders = new Map(numbers.map((slider) => [slider.key, slider]));
    const first = numbers.filter((one) => one.first !== null).sort((a, b) => a.first - b.first);
    const order = [...first, ...numbers.filter((one) => one.first === null)];
    [this.x, this.y].forEach((select, n) => {
      select.replaceChildren(...order.map(({ key }) => made("option", { value: key }, key)));
      select.value = this.sliders.has(before[n]) ? before[n] : order[2 * n]?.key;
    });
  }

  /** The state is another one: what was found does not hold any more, unless only the two keys have moved. */
  changed() {
    if (!this.box.open || !this.sliders) return;
    const state = this.now();
    const rest = { ...state, set: { ...state.set } };
    delete rest.set[this.x.value];
    delete rest.set[this.y.value];
    const form = JSON.stringify([rest, this.x.value, this.y.value]);
    if (form === this.form) {
      this.draw();
      if (!this.busy) this.next();
      return;
    }
    clearTimeout(this.timer);
    this.form = form;
    this.rest = rest;
    this.number += 1;
    this.found = [];
    this.cells = coarseToFine();
    this.draw();
    this.busy = true;
    this.timer = setTimeout(() => this.next(), QUIET);
  }

  at(key, place) {
    return valueAt(this.sliders.get(key), (FINE * (place + 0.5)) / SIDE);
  }

  state({ i, j }) {
    const set = { ...this.rest.set, [this.x.value]: this.at(this.x.value, i), [this.y.value]: this.at(this.y.value, j) };
    return { ...this.rest, set };
  }

  next() {
    this.busy = this.box.open && this.cells.length > 0;
    if (!this.busy) return;
    this.cell_ = this.cells.shift();
    this.ask(this.state(this.cell_), this.number);
  }

  take(answer) {
    if (answer.slot !== this.number || !this.cell_) return;
    this.found.push({ ...this.cell_, numbers: answer.numbers ?? null, why: answer.refused ?? answer.failed ?? "" });
    const names = (answer.numbers ?? []).map(([name]) => name);
    if (names.length && this.which.options.length !== names.length) this.which.replaceChildren(...names.map((name) => made("option", { value: name }, name)));
    this.draw();
    this.next();
  }

  value(cell) {
    return cell.numbers?.find(([name]) => name === this.which.value)?.[2] ?? null;
  }

  get inner() {
    return { width: this.width - EDGE.left - EDGE.right, height: HEIGHT - EDGE.top - EDGE.bottom };
  }

  draw() {
    if (!this.box.open || !this.sliders) return;
    this.width = this.canvas.parentElement.clientWidth || 300;
    this.canvas.style.height = `${HEIGHT}px`;
    const pen = prepared(this.canvas, this.width, HEIGHT);
    const { width, height } = this.inner;
    const [w, h] = [width / SIDE, height / SIDE];
    const values = this.found.map((cell) => this.value(cell)).filter((value) => value !== null);
    const [low, high] = [Math.min(...values), Math.max(...values)];
    for (const cell of this.found) {
      const value = this.value(cell);
      const share = high > low ? (value - low) / (high - low) : 0.5;
      pen.fillStyle = value === null ? color("--card") : `hsl(205 75% ${88 - 62 * share}%)`;
      const top = EDGE.top + height - (cell.j + cell.size) * h;
      pen.fillRect(EDGE.left + cell.i * w, top, cell.size * w + 0.5, cell.size * h + 0.5);
    }
    pen.strokeStyle = color("--edge");
    pen.strokeRect(EDGE.left, EDGE.top, width, height);
    pen.fillStyle = color("--muted");
    pen.font = "11px system-ui, sans-serif";
    const ends = (key) => [this.at(key, 0), this.at(key, SIDE - 1)].map((value) => String(Number(value.toPrecision(3))));
    pen.textBaseline = "top";
    ends(this.x.value).forEach((text, end) => {
      pen.textAlign = end ? "right" : "left";
      pen.fillText(text, EDGE.left + end * width, HEIGHT - EDGE.bottom + 4);
    });
    pen.textAlign = "center";
    pen.fillText(this.x.value, EDGE.left + width / 2, HEIGHT - EDGE.bottom + 16);
    pen.textAlign = "right";
    ends(this.y.value).forEach((text, end) => {
      pen.textBaseline = end ? "top" : "bottom";
      pen.fillText(text, EDGE.left - 5, EDGE.top + (1 - end) * height);
    });
    this.cross(pen);
    if (values.length) this.note.textContent = `${this.which.value}: light ${low.toPrecision(3)}, dark ${high.toPrecision(3)}; ${this.found.length} of ${SIDE * SIDE} points`;
  }

  /** Where the present state is. */
  cross(pen) {
    const { width, height } = this.inner;
    const share = (key) => {
      const { low, high, log, value, default: usual } = this.sliders.get(key);
      const now = this.now().set[key] ?? value ?? usual;
      return log ? Math.log(now / low) / Math.log(high / low) : (now - low) / (high - low);
    };
    const [x, y] = [EDGE.left + share(this.x.value) * width, EDGE.top + (1 - share(this.y.value)) * height];
    pen.strokeStyle = color("--vermilion");
    pen.lineWidth = 2;
    pen.beginPath();
    pen.arc(x, y, 5, 0, 2 * Math.PI);
    pen.stroke();
  }

  /** The finest cell below the pointer. */
  cell(event) {
    const box = this.canvas.getBoundingClientRect();
    const { width, height } = this.inner;
    const i = ((event.clientX - box.left - EDGE.left) / width) * SIDE;
    const j = SIDE - ((event.clientY - box.top - EDGE.top) / height) * SIDE;
    return this.found.findLast((one) => i >= one.i && i < one.i + one.size && j >= one.j && j < one.j + one.size);
  }

  point(event) {
    const cell = this.cell(event);
    if (!cell) return;
    const [x, y] = [this.at(this.x.value, cell.i), this.at(this.y.value, cell.j)].map((value) => Number(value.toPrecision(3)));
    const value = this.value(cell);
    this.canvas.title = `${this.x.value} ${x}, ${this.y.value} ${y}: ${value === null ? cell.why || "none" : value.toPrecision(3)}`;
  }
}
