// Ways of Fig. 5 that have no time axis: a task in space, and on the surface. The clock's time is a dot on them.

const HEIGHT = { 2: 190, 3: 230 };
const EDGE = { left: 46, right: 10, top: 8, bottom: 30 };
const REACH = 25;
const ROOM = 3;
const HIGH = 0.75;
const [ELEVATION, AZIMUTH] = [(24 * Math.PI) / 180, (-52 * Math.PI) / 180];
const LOOKS = {
  truth: { color: "--ink", width: 1.1, dash: [] },
  mark: { color: "--vermilion", width: 2, dash: [] },
  reference: { color: "--blue", width: 1.5, dash: [7, 4] },
  display: { color: "--purple", width: 1, dash: [2, 3] },
};
const OF_SEVERAL = ["truth", "mark"];

/** Coordinates of a row, one Float32Array each. */
function coordinates(way, row, samples) {
  const [at, count] = row.place;
  const n = count / way.axes.length;
  return way.axes.map((_, i) => samples.subarray(at + i * n, at + (i + 1) * n));
}

/** An answer's ways with their samples. */
export const withPoints = (answer) =>
  (answer.ways ?? []).map((way) => ({ ...way, rows: way.rows.map((row) => ({ ...row, at: coordinates(way, row, answer.samples) })) }));

export class Way {
  /** `runs`: the same picture of each run, null where one has none. */
  constructor(runs, clock) {
    this.clock = clock;
    this.way = runs[0];
    this.off = new Set();
    this.canvas = made("canvas", { role: "img" });
    this.canvas.setAttribute("aria-label", `${this.way.title}: ${this.way.rows.map(({ label }) => label).join(", ")}`);
    this.stage = made("div", { className: "stage" }, this.canvas);
    this.value = made("output", { className: "value" });
    const entries = [...new Set(this.way.rows.map(({ label }) => label))].map((label) => this.entry(label));
    const legend = made("div", { className: "legend" }, ...entries);
    this.figure = made("figure", { className: "plot way" }, made("figcaption", {}, this.way.title), this.stage, legend, this.value);
    this.canvas.addEventListener("pointermove", (event) => this.point(event));
    this.put(runs);
  }

  entry(label) {
    const { role } = this.way.rows.find((row) => row.label === label);
    const swatch = made("canvas", { className: "swatch" });
    this.swatches = [...(this.swatches ?? []), [swatch, LOOKS[role]]];
    const button = made("button", { type: "button" }, swatch, made("span", {}, label));
    button.setAttribute("aria-pressed", "true");
    button.addEventListener("click", () => {
      if (!this.off.delete(label)) this.off.add(label);
      button.setAttribute("aria-pressed", String(!this.off.has(label)));
      this.draw();
    });
    return button;
  }

  put(runs) {
    this.runs = runs;
    this.way = runs[0];
  }

  /** [least, largest] of each coordinate. */
  extents() {
    const found = this.way.axes.map(() => [Infinity, -Infinity]);
    for (const way of this.runs)
      for (const row of way?.rows ?? [])
        row.at.forEach((values, i) => {
          for (const value of values) if (Number.isFinite(value)) found[i] = [Math.min(found[i][0], value), Math.max(found[i][1], value)];
        });
    return found.map(([low, high]) => (low <= high ? [low, high] : [0, 1]));
  }

  draw() {
    const flat = this.way.axes.length === 2;
    const height = HEIGHT[this.way.axes.length];
    const width = this.stage.clientWidth || 300;
    this.canvas.style.width = "100%";
    this.canvas.style.height = `${height}px`;
    const pen = prepared(this.canvas, width, height);
    pen.font = "11px system-ui, sans-serif";
    const extents = this.extents();
    this.pixel = flat ? this.plane(pen, extents, width, height) : this.space(pen, extents, width, height);
    this.runs.forEach((way, run) => {
      for (const row of way?.rows ?? []) if (!this.off.has(row.label) && (run === 0 || OF_SEVERAL.includes(row.role))) this.line(pen, row, run);
    });
    for (const [swatch, { color: name, width: wide, dash }] of this.swatches) {
      const small = prepared(swatch, 26, 8);
      Object.assign(small, { strokeStyle: color(name), lineWidth: wide });
      small.setLineDash(dash);
      small.beginPath();
      small.moveTo(0, 4);
      small.lineTo(26, 4);
      small.stroke();
    }
    this.dot(pen);
  }

  line(pen, row, run) {
    const style = LOOKS[row.role];
    pen.strokeStyle = color(this.runs.length > 1 && row.role !== "reference" ? runColor(run) : style.color);
    pen.lineWidth = style.width;
    pen.setLineDash(style.dash);
    pen.beginPath();
    let down = false;
    for (let i = 0; i < row.at[0].length; i++) {
      const [x, y] = this.pixel(row.at.map((values) => values[i]));
      if (!Number.isFinite(x)) down = false;
      else if (down) pen.lineTo(x, y);
      else {
        pen.moveTo(x, y);
        down = true;
      }
    }
    pen.stroke();
    pen.setLineDash([]);
  }

  path(pen, points) {
    pen.beginPath();
    points.map(this.pixel).forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  }

  /** Two axes; the way from a point to its pixel. */
  plane(pen, extents, width, height) {
    const room = [width - EDGE.left - EDGE.right, height - EDGE.top - EDGE.bottom];
    const middle = extents.map(([low, high]) => (low + high) / 2);
    const wide = extents.map(([low, high]) => Math.max(1.1 * (high - low), 0.02));
    const each = wide.map((size, i) => room[i] / size);
    const scale = this.way.equal ? [Math.min(...each), Math.min(...each)] : each;
    const centre = [EDGE.left + room[0] / 2, EDGE.top + room[1] / 2];
    pen.fillStyle = color("--muted");
    pen.strokeStyle = color("--grid");
    const ends = [0, 1].map((i) => [-1, 1].map((side) => middle[i] + (side * room[i]) / 2 / scale[i]));
    pen.textBaseline = "top";
    pen.textAlign = "center";
    for (const [value, text] of ticks(...ends[0], 4)) {
      const x = centre[0] + scale[0] * (value - middle[0]);
      pen.strokeRect(x, EDGE.top, 0, room[1]);
      pen.fillText(text, x, height - EDGE.bottom + 3);
    }
    pen.fillText(`${this.way.axes[0]}; up: ${this.way.axes[1]}`, centre[0], height - 13);
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const [value, text] of ticks(...ends[1], 4)) {
      const y = centre[1] - scale[1] * (value - middle[1]);
      pen.strokeRect(EDGE.left, y, room[0], 0);
      pen.fillText(text, EDGE.left - 4, y);
    }
    return ([x, y]) => [centre[0] + scale[0] * (x - middle[0]), centre[1] - scale[1] * (y - middle[1])];
  }

  /** A box with the untouched surface in it, seen as in the paper: z is drawn larger. */
  space(pen, extents, width, height) {
    const reach = Math.max(REACH, ...extents.slice(0, 2).flat().map(Math.abs));
    const [bottom, top] = [Math.min(extents[2][0], this.way.surface) - ROOM, extents[2][1] + ROOM];
    const tall = (2 * reach * HIGH) / (top - bottom);
    const scale = Math.min(width / (2.9 * reach), (height - 14) / (2 * reach * (HIGH + 0.6)));
    const [s, c] = [Math.sin(AZIMUTH), Math.cos(AZIMUTH)];
    this.pixel = ([x, y, z]) => {
      const up = tall * (z - (bottom + top) / 2) * Math.cos(ELEVATION) - Math.sin(ELEVATION) * (c * x + s * y);
      return [width / 2 + scale * (-s * x + c * y), height / 2 - scale * up];
    };
    const [a, b] = [-reach, reach];
    const ring = (z) => [[a, a, z], [b, a, z], [b, b, z], [a, b, z], [a, a, z]];
    pen.fillStyle = color("--surface");
    this.path(pen, ring(this.way.surface));
    pen.globalAlpha = 0.6;
    pen.fill();
    pen.globalAlpha = 1;
    pen.strokeStyle = color("--muted");
    pen.lineWidth = 0.8;
    const posts = ring(0).slice(1).map(([x, y]) => [[x, y, bottom], [x, y, top]]);
    for (const points of [ring(bottom), ring(top), ...posts]) {
      this.path(pen, points);
      pen.stroke();
    }
    pen.fillStyle = color("--muted");
    pen.textAlign = "left";
    pen.fillText(`x, y: ${-reach.toFixed(0)} to ${reach.toFixed(0)} mm; z: ${bottom.toFixed(0)} to ${top.toFixed(0)} mm`, 2, height - 4);
    return this.pixel;
  }

  /** The rows with times, what is true or worked. */
  timed() {
    return this.way.rows.filter(({ start, role }) => start !== null && OF_SEVERAL.includes(role));
  }

  dot(pen) {
    this.value.textContent = "";
    for (const row of this.timed()) {
      const i = Math.round((this.clock.time - row.start) / row.step);
      const at = i >= 0 && i < row.at[0].length ? row.at.map((values) => values[i]) : [NaN];
      if (!Number.isFinite(at[0])) continue;
      pen.fillStyle = color("--ink");
      pen.beginPath();
      pen.arc(...this.pixel(at), 4, 0, 2 * Math.PI);
      pen.fill();
      this.value.textContent = this.way.axes.map((name, k) => `${name.replace(" (mm)", "")} ${at[k].toFixed(2)} mm`).join(", ");
      return;
    }
  }

  /** The clock goes to the point that is nearest to the pointer. */
  point(event) {
    if (this.clock.playing) return;
    const box = this.canvas.getBoundingClientRect();
    let best = [Infinity, 0];
    for (const row of this.timed())
      for (let i = 0; i < row.at[0].length; i++) {
        const [x, y] = this.pixel(row.at.map((values) => values[i]));
        const far = Math.hypot(x - event.clientX + box.left, y - event.clientY + box.top);
        if (far < best[0]) best = [far, row.start + i * row.step];
      }
    if (best[0] < Infinity) this.clock.set(best[1]);
  }
}
