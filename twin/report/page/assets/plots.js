// All plots; they share a time span, and a cursor with the player.

const CLOSEST = 0.01;

class Plots {
  constructor(box, clock) {
    this.clock = clock;
    // callbacks: after drawing, after a change of the time span
    this.drawn = this.zoomed = () => {};
    this.span = { from: 0, to: clock.end };
    this.plots = page.panels.map((panel) => new Plot(panel, this.span));
    this.stale = new Set(this.plots);
    this.seen = new Set();
    box.append(...this.plots.map((plot) => plot.figure));
    const watcher = new IntersectionObserver((entries) => {
      for (const entry of entries) {
        const plot = this.plots.find((candidate) => candidate.figure === entry.target);
        if (entry.isIntersecting) this.seen.add(plot);
        else this.seen.delete(plot);
      }
      this.refresh();
    }, { rootMargin: "50% 0px" });
    for (const plot of this.plots) {
      watcher.observe(plot.figure);
      this.hear(plot);
    }
    this.watchers = [watcher, new ResizeObserver(() => this.redraw())];
    this.watchers[1].observe(box);
    clock.listen(() => this.point());
  }

  /** Replace the plots. */
  forget() {
    for (const watcher of this.watchers) watcher.disconnect();
  }

  /** Draw outdated plots that are on the screen; others are drawn when scrolled into view. */
  refresh() {
    // read all widths before changing texts, so that the browser lays out only once
    for (const plot of this.seen) if (this.stale.delete(plot)) plot.draw();
    this.point();
    this.drawn();
  }

  redraw() {
    this.plots.forEach((plot) => this.stale.add(plot));
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.refresh();
    });
  }

  /** Draw plots off the screen, too: for printing and smooth scrolling. */
  drawAll() {
    this.stale.clear();
    for (const plot of this.plots) {
      plot.draw();
      plot.point(this.clock.time);
    }
  }

  point() {
    for (const plot of this.seen) plot.point(this.clock.time);
  }

  zoom(from, to) {
    const wide = Math.min(this.clock.end, Math.max(CLOSEST, to - from));
    this.span.from = Math.min(this.clock.end - wide, Math.max(0, from));
    this.span.to = this.span.from + wide;
    document.getElementById("span").textContent = `${this.span.from.toFixed(2)} to ${this.span.to.toFixed(2)} s`;
    this.redraw();
    this.zoomed();
  }

  /** Scale the time span by `factor`, about the cursor if it is visible. */
  zoomBy(factor) {
    const { from, to } = this.span;
    const time = this.clock.time;
    const centre = time >= from && time <= to ? time : (from + to) / 2;
    this.zoom(centre - (centre - from) * factor, centre + (to - centre) * factor);
  }

  all() {
    this.zoom(0, this.clock.end);
  }

  hear(plot) {
    const stage = plot.stage;
    const time = (event) => plot.t(event.clientX - stage.getBoundingClientRect().left);
    let began = null;
    let moved = null;
    stage.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      if (event.pointerType !== "touch") stage.setPointerCapture(event.pointerId);
      if (event.shiftKey) moved = { at: event.clientX, ...this.span };
      else began = event.clientX;
    });
    stage.addEventListener("pointermove", (event) => {
      if (moved) {
        const by = plot.t(moved.at) - plot.t(event.clientX);
        this.zoom(moved.from + by, moved.to + by);
        return;
      }
      const zooming = began !== null && event.pointerType !== "touch" && Math.abs(event.clientX - began) > 4;
      if (zooming) this.showBrush(plot, began, event.clientX);
      else if (!this.clock.playing) this.clock.set(time(event));
    });
    const end = (event) => {
      moved = null;
      if (began === null) return;
      const from = plot.t(began - stage.getBoundingClientRect().left);
      const zoomed = !plot.brush.hidden;
      plot.brush.hidden = true;
      began = null;
      if (zoomed) this.zoom(Math.min(from, time(event)), Math.max(from, time(event)));
      else if (event.type === "pointerup") this.clock.set(time(event));
    };
    stage.addEventListener("pointerup", end);
    stage.addEventListener("pointercancel", () => {
      moved = null;
      plot.brush.hidden = true;
      began = null;
    });
    stage.addEventListener("dblclick", () => this.all());
    stage.addEventListener("keydown", (event) => this.key(event));
  }

  showBrush(plot, from, to) {
    const left = plot.stage.getBoundingClientRect().left;
    plot.brush.hidden = false;
    plot.brush.style.left = `${Math.min(from, to) - left}px`;
    plot.brush.style.width = `${Math.abs(to - from)}px`;
  }

  key(event) {
    const step = (this.span.to - this.span.from) / (event.shiftKey ? 20 : 200);
    const acts = {
      ArrowLeft: () => this.clock.set(this.clock.time - step),
      ArrowRight: () => this.clock.set(this.clock.time + step),
      "+": () => this.zoomBy(0.5),
      "-": () => this.zoomBy(2),
      0: () => this.all(),
    };
    if (!(event.key in acts)) return;
    event.preventDefault();
    acts[event.key]();
  }
}
