// Plots and player of the report, fed by answers. Run 0 is the current state, the others are pinned.

const MAIN = ["truth", "reference"];

/** Return the panels of an answer with the curves that the plots draw. */
function withCurves(answer) {
  return answer.panels.map((panel) => ({
    ...panel,
    rows: panel.rows.map((row) => ({ ...row, curve: row.curve && new Curve(answer.samples, row.curve) })),
  }));
}

export class Picture {
  /** `zoomed` is called when the time span changes, `drawn` after the plots are drawn. */
  constructor(zoomed, drawn) {
    this.zoomed = zoomed;
    this.drawn = drawn;
    this.box = document.getElementById("plots");
    this.clock = new Clock(1);
    this.player = new Player(document.getElementById("robot"), this.clock);
    this.lasting = [...this.clock.listeners];
    this.answers = [null];
    this.switched = new Map();
    this.labels = ["now"];
    const by = (id, act) => document.getElementById(id).addEventListener("click", () => this.plots && act(this.plots));
    by("closer", (plots) => plots.zoomBy(0.5));
    by("wider", (plots) => plots.zoomBy(2));
    by("all", (plots) => plots.all());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.plots?.redraw();
      this.player.draw();
    });
  }

  /** Visible time span; null for the whole run. */
  get span() {
    const span = this.plots?.span;
    return !span || (span.from === 0 && span.to === this.clock.end) ? null : [span.from, span.to];
  }

  get width() {
    return Math.max(50, Math.min(4000, Math.round((this.box.firstElementChild ?? this.box).clientWidth || 600)));
  }

  /** Set the names of the runs and drop the data of removed runs. */
  name(labels) {
    this.labels = labels;
    this.answers.length = labels.length;
    this.answers = Array.from(this.answers, (answer) => answer ?? null);
    this.put();
  }

  /** Show an answer as run `number`. */
  take(number, answer) {
    this.answers[number] = { panels: withCurves(answer), end: answer.end };
    if (number === 0) {
      page.events = answer.events;
      if (answer.scene) answer.scene.samples = answer.samples;
      page.scenes[0] = answer.scene;
      this.player.scenes = [answer.scene && new Scene(answer.scene, this.player.canvas)];
    }
    this.put();
    if (number === 0) this.player.markEvents();
    if (number === 0 && answer.scene) this.player.draw();
  }

  /** Whether a row is shown: as switched in the legend; else, of several runs, the true and reference rows, and all
   * rows of a run without these, such as a robot's log. */
  isShown({ title, rows }, row) {
    const asSwitched = this.switched.get(`${title} ${row.label}`);
    const wanted = this.labels.some((_, run) => {
      const own = rows.filter(({ curves }) => curves[run]);
      return row.curves[run] && !own.some(({ role }) => MAIN.includes(role));
    });
    const usual = row.shown && (this.labels.length === 1 || MAIN.includes(row.role));
    return asSwitched ?? (usual || (this.labels.length > 1 && wanted));
  }

  /** Rebuild the plots only if their curves changed. */
  put() {
    const now = this.answers[0];
    if (!now) return;
    const panels = now.panels
      .map((panel) => {
        const others = this.answers.map((answer) => answer?.panels.find(({ title }) => title === panel.title));
        const rows = panel.rows.map((row, i) => ({ ...row, curves: others.map((other) => other?.rows[i].curve ?? null) }));
        return { ...panel, rows: rows.filter(({ curves }) => curves.some(Boolean)) };
      })
      .filter(({ rows }) => rows.length);
    const end = Math.max(...this.answers.map((answer) => answer?.end ?? 0));
    const form = JSON.stringify([end, this.labels, this.answers.map(Boolean), panels.map(({ title, rows }) => [title, rows.map(({ label }) => label)])]);
    if (form === this.form) {
      page.panels.forEach((panel, p) => panel.rows.forEach((row, r) => (row.curves = panels[p].rows[r].curves)));
      for (const plot of this.plots.plots) plot.decimals = plot.fittingDecimals();
      this.plots.redraw();
      this.plots.point();
      return;
    }
    for (const panel of page.panels)
      for (const row of panel.rows)
        if (row.shown !== row.before) this.switched.set(`${panel.title} ${row.label}`, row.shown);
    page.runs.length = 0;
    page.runs.push(...this.labels.map((label) => ({ label })));
    for (const panel of panels) for (const row of panel.rows) row.before = row.shown = this.isShown(panel, row);
    page.panels = panels;
    this.form = form;
    this.rebuild(end);
  }

  rebuild(end) {
    const span = this.span;
    this.clock.end = end;
    this.player.slider.max = end;
    this.clock.listeners = [...this.lasting];
    this.plots?.forget();
    this.box.replaceChildren();
    this.plots = new Plots(this.box, this.clock);
    this.plots.drawn = () => this.drawn();
    if (span && span[1] <= end) this.plots.zoom(...span);
    else this.plots.all();
    this.plots.zoomed = () => this.zoomed();
    this.clock.set(Math.min(this.clock.time, end));
  }
}
