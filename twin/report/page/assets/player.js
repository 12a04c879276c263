// Player: robot scene, play and pause, speed, time line with events, camera.

const HOME = { yaw: -0.55, pitch: 0.32, zoom: 1 };
const TURN = 0.01;

class Player {
  constructor(box, clock) {
    this.clock = clock;
    this.view = { ...HOME };
    this.canvas = box.querySelector("canvas");
    this.button = document.getElementById("play");
    this.slider = document.getElementById("time");
    this.readout = document.getElementById("readout");
    this.chosen = document.getElementById("run");
    this.scenes = page.scenes.map((scene) => (scene ? new Scene(scene, this.canvas) : null));
    this.slider.max = clock.end;
    this.hear(box);
    this.markEvents();
    clock.listen(() => this.show());
    new ResizeObserver(() => this.draw()).observe(this.canvas);
  }

  get scene() {
    return this.scenes[this.chosen ? Number(this.chosen.value) : 0];
  }

  draw() {
    this.canvas.hidden = !this.scene;
    if (this.scene) this.scene.draw(this.clock.time, this.view);
    this.canvas.dataset.time = this.clock.time;
  }

  show() {
    const { time, end, playing } = this.clock;
    this.slider.value = time;
    this.slider.setAttribute("aria-valuetext", `${time.toFixed(2)} of ${end.toFixed(2)} seconds`);
    this.readout.textContent = `${time.toFixed(3)} s`;
    this.button.textContent = playing ? "Pause" : "Play";
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.draw();
    });
  }

  /** Add event marks under the time line; a click jumps to the event. */
  markEvents() {
    const marks = page.events.filter((event) => event.level !== "debug");
    document.getElementById("marks").replaceChildren(
      ...marks.map((event) => {
        const mark = made("button", { type: "button", className: event.level, title: `${event.t} s: ${event.text}` });
        mark.setAttribute("aria-label", mark.title);
        mark.style.left = `${(100 * event.t) / this.clock.end}%`;
        mark.addEventListener("click", () => this.clock.set(event.t));
        return mark;
      }),
    );
  }

  hear(box) {
    this.button.addEventListener("click", () => this.clock.toggle());
    this.slider.addEventListener("input", () => {
      this.clock.playing = false;
      this.clock.set(Number(this.slider.value));
    });
    document.getElementById("speed").addEventListener("change", (event) => {
      this.clock.speed = Number(event.target.value);
    });
    if (this.chosen) this.chosen.addEventListener("change", () => this.draw());
    document.getElementById("view").addEventListener("click", () => this.turn(() => Object.assign(this.view, HOME)));
    this.canvas.addEventListener("pointermove", (event) => {
      if (event.buttons !== 1) return;
      this.turn(() => {
        this.view.yaw -= TURN * event.movementX;
        this.view.pitch += TURN * event.movementY;
      });
    });
    this.canvas.addEventListener("keydown", (event) => {
      const acts = {
        ArrowLeft: () => (this.view.yaw += 0.1),
        ArrowRight: () => (this.view.yaw -= 0.1),
        ArrowUp: () => (this.view.pitch += 0.1),
        ArrowDown: () => (this.view.pitch -= 0.1),
        "+": () => (this.view.zoom *= 1.1),
        "-": () => (this.view.zoom /= 1.1),
      };
      if (!(event.key in acts)) return;
      event.preventDefault();
      this.turn(acts[event.key]);
    });
    box.parentElement.addEventListener("keydown", (event) => {
      if (event.key !== " " || ["BUTTON", "SELECT", "SUMMARY"].includes(event.target.tagName)) return;
      event.preventDefault();
      this.clock.toggle();
    });
  }

  /** Change the camera within its limits. */
  turn(change) {
    change();
    this.view.pitch = Math.min(1.5, Math.max(-0.3, this.view.pitch));
    this.view.zoom = Math.min(4, Math.max(0.5, this.view.zoom));
    this.draw();
  }
}
