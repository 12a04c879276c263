// Current time of the page; parts that display a moment subscribe to it.

class Clock {
  constructor(end) {
    this.end = end;
    this.time = 0;
    this.speed = 1;
    this.playing = false;
    this.listeners = [];
  }

  listen(listener) {
    this.listeners.push(listener);
  }

  /** Jump to a time, clamped to the run. */
  set(time) {
    this.time = Math.min(this.end, Math.max(0, time));
    this.tell();
  }

  tell() {
    for (const listener of this.listeners) listener(this);
  }

  play() {
    if (this.playing) return;
    if (this.time >= this.end) this.time = 0;
    this.playing = true;
    let before = performance.now();
    const advance = (now) => {
      if (!this.playing) return;
      const time = this.time + (this.speed * (now - before)) / 1000;
      before = now;
      if (time >= this.end) this.playing = false;
      this.set(time);
      if (this.playing) requestAnimationFrame(advance);
    };
    requestAnimationFrame(advance);
    this.tell();
  }

  pause() {
    this.playing = false;
    this.tell();
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }
}
