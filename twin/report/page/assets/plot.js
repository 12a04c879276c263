// A plot: canvas with curves, cursor, and legend with the values at the cursor.

const MARGIN = { left: 58, right: 10, top: 6, bottom: 22 };
const HEIGHT = 170;
// minimum span, so that rounding errors do not fill a plot
const LEAST_SPAN = 1e-3;
// tolerance of curve simplification in pixels
const UNSEEN = 0.3;

/** Return about `count` round numbers from low to high. */
function ticks(low, high, count) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((candidate) => candidate >= rough);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const values = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k++) values.push(k * step);
  return values.map((value) => [value, (Math.abs(value) < step / 2 ? 0 : value).toFixed(digits)]);
}

/** Whether a run is drawn; removed runs are not. */
const isShown = (run) => run !== undefined && !run.hidden;

class Plot {
  constructor(panel, span) {
    this.panel = panel;
    this.span = span;
    this.canvas = made("canvas", { role: "img" });
    this.cursor = made("div", { className: "cursor" });
    this.brush = made("div", { className: "brush", hidden: true });
    this.stage = made("div", { className: "stage", tabIndex: 0 }, this.canvas, this.brush, this.cursor);
    this.stage.setAttribute("role", "group");
    this.stage.setAttribute("aria-label", `${panel.title}: arrow keys move the time, + and - zoom, 0 shows all`);
    this.values = [];
    const title = made("figcaption", {}, panel.title, panel.unit ? made("span", {}, ` ${panel.unit}`) : "");
    const legend = made("div", { className: page.runs.length > 1 ? "legend several" : "legend" }, ...panel.rows.map((row) => this.entry(row)));
    this.figure = made("figure", { className: "plot" }, title, this.stage, legend);
    this.canvas.setAttribute("aria-label", `${panel.title} over time: ${panel.rows.map((r) => r.label).join(", ")}`);
    this.decimals = this.fittingDecimals();
  }

  /** Add a legend entry that toggles its row and shows the values at the cursor. */
  entry(row) {
    const swatch = made("canvas", { className: "swatch" });
    const values = page.runs.map((_, run) => made("output", { className: "value", hidden: !row.curves[run] }));
    if (page.runs.length > 1)
      values.forEach(mark);
    const button = made("button", { type: "button" }, swatch, made("span", {}, row.label), ...values);
    button.setAttribute("aria-pressed", String(row.shown));
    button.addEventListener("click", () => {
      row.shown = !row.shown;
      button.setAttribute("aria-pressed", String(row.shown));
      this.draw();
    });
    this.values.push({ row, values, swatch });
    return button;
  }

  fittingDecimals() {
    const [low, high] = this.extremes(-Infinity, Infinity, this.panel.rows);
    return Math.max(0, Math.min(6, 4 - Math.ceil(Math.log10(Math.max(high - low, LEAST_SPAN)))));
  }

  /** Return [minimum, maximum] of the rows between two times. */
  extremes(from, to, rows) {
    let low = Infinity;
    let high = -Infinity;
    for (const row of rows)
      row.curves.forEach((curve, run) => {
        if (!curve || !isShown(page.runs[run])) return;
        const last = curve.index(to);
        for (let i = curve.index(from); i <= last; i++) {
          const y = curve.y[i];
          if (y < low) low = y;
          if (y > high) high = y;
        }
      });
    return low <= high ? [low, high] : [0, 1];
  }

  x(t) {
    const { from, to } = this.span;
    return MARGIN.left + ((t - from) / (to - from)) * (this.width - MARGIN.left - MARGIN.right);
  }

  /** Return the time at a pixel of the canvas. */
  t(x) {
    const { from, to } = this.span;
    return from + ((x - MARGIN.left) / (this.width - MARGIN.left - MARGIN.right)) * (to - from);
  }

  draw() {
    this.width = this.stage.clientWidth || 600;
    const pen = prepared(this.canvas, this.width, HEIGHT);
    const rows = this.panel.rows.filter((row) => row.shown);
    const [low, high] = this.extremes(this.span.from, this.span.to, rows);
    const pad = Math.max(0.06 * (high - low), LEAST_SPAN / 2);
    const [bottom, top] = [low - pad, high + pad];
    const floor = HEIGHT - MARGIN.bottom;
    const y = (value) => floor - ((value - bottom) / (top - bottom)) * (floor - MARGIN.top);
    this.drawAxes(pen, bottom, top, y);
    pen.save();
    pen.beginPath();
    pen.rect(MARGIN.left, 0, this.width - MARGIN.left - MARGIN.right, floor);
    pen.clip();
    for (const row of rows)
      row.curves.forEach((curve, run) => {
        if (curve && isShown(page.runs[run])) this.drawCurve(pen, curve, look(row, run), y);
      });
    pen.restore();
    for (const { row, swatch } of this.values) this.drawSwatch(swatch, look(row, 0));
    this.stage.dataset.from = this.span.from;
    this.stage.dataset.to = this.span.to;
  }

  drawAxes(pen, bottom, top, y) {
    pen.font = "11px system-ui, sans-serif";
    pen.lineWidth = 1;
    pen.strokeStyle = color("--grid");
    pen.fillStyle = color("--muted");
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    const right = this.width - MARGIN.right;
    for (const [value, text] of ticks(bottom, top, 5)) {
      pen.beginPath();
      pen.moveTo(MARGIN.left, y(value));
      pen.lineTo(right, y(value));
      pen.stroke();
      pen.fillText(text, MARGIN.left - 6, y(value));
    }
    pen.textAlign = "center";
    pen.textBaseline = "top";
    const marks = ticks(this.span.from, this.span.to, Math.max(2, this.width / 90));
    marks.forEach(([value, text], i) => {
      pen.beginPath();
      pen.moveTo(this.x(value), MARGIN.top);
      pen.lineTo(this.x(value), HEIGHT - MARGIN.bottom);
      pen.stroke();
      const place = Math.min(this.x(value), right - 12);
      pen.fillText(i === marks.length - 1 ? `${text} s` : text, place, HEIGHT - MARGIN.bottom + 6);
    });
    pen.setLineDash([3, 3]);
    for (const event of page.events.filter((e) => e.level !== "debug" && isShown(page.runs[e.run]))) {
      if (event.t < this.span.from || event.t > this.span.to) continue;
      pen.strokeStyle = color(event.level === "info" ? "--muted" : "--vermilion");
      pen.beginPath();
      pen.moveTo(this.x(event.t), MARGIN.top);
      pen.lineTo(this.x(event.t), HEIGHT - MARGIN.bottom);
      pen.stroke();
    }
    pen.setLineDash([]);
  }

  /** Draw a curve through its samples, or as minimum-maximum bars where many samples share a pixel. */
  drawCurve(pen, curve, { color: name, width, dash }, y) {
    const first = curve.index(this.span.from);
    const last = Math.min(curve.y.length - 1, curve.index(this.span.to) + 1);
    const columns = Math.max(1, Math.round(this.width));
    const each = Math.max(1, Math.floor((last - first) / columns));
    pen.strokeStyle = color(name);
    pen.lineWidth = width;
    pen.setLineDash(dash);
    pen.lineJoin = "bevel";
    pen.beginPath();
    let down = false;
    let [x_before, y_before] = [0, 0];
    for (let i = first; i <= last; i += each) {
      let low = Infinity;
      let high = -Infinity;
      for (let k = i; k < i + each && k <= last; k++) {
        const value = curve.y[k];
        if (value < low) low = value;
        if (value > high) high = value;
      }
      if (low > high) {
        down = false;
        continue;
      }
      const x = this.x(curve.start + i * curve.step);
      const [over, under] = [y(high), y(low)];
      if (down && i < last && x - x_before < 1 && Math.abs(over - y_before) < UNSEEN && under - over < UNSEEN) continue;
      [x_before, y_before] = [x, over];
      if (down) pen.lineTo(x, over);
      else pen.moveTo(x, over);
      if (under - over > 0.5) pen.lineTo(x, under);
      down = true;
    }
    pen.stroke();
    pen.setLineDash([]);
  }

  drawSwatch(canvas, { color: name, width, dash }) {
    const pen = prepared(canvas, 26, 8);
    pen.strokeStyle = color(page.runs.length > 1 ? "--ink" : name);
    pen.lineWidth = width;
    pen.setLineDash(dash);
    pen.beginPath();
    pen.moveTo(0, 4);
    pen.lineTo(26, 4);
    pen.stroke();
  }

  /** Move the cursor and the legend's values to time t. */
  point(t) {
    const inside = t >= this.span.from && t <= this.span.to;
    this.cursor.hidden = !inside;
    if (inside) this.cursor.style.transform = `translateX(${this.x(t)}px)`;
    this.stage.dataset.time = t;
    for (const { row, values } of this.values)
      values.forEach((value, run) => {
        if (!row.curves[run]) return;
        const y = row.curves[run].at(t);
        value.textContent = Number.isFinite(y) ? `${y.toFixed(this.decimals)} ${this.panel.unit}`.trimEnd() : "-";
      });
  }
}
