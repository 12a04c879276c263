// The page's data and its packed samples; decodes what twin/report/page/block.py encodes.

const page = JSON.parse(document.getElementById("data").textContent);

/** Decode a run's samples to a Float32Array from base64, deflated, with bytes of equal significance grouped. */
async function unpacked(text) {
  const raw = atob(text);
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  const inflating = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(inflating).arrayBuffer());
  const n = planes.length / 4;
  const patterns = new Int32Array(n);
  let pattern = 0;
  for (let i = 0; i < n; i++) {
    const step = planes[i] | (planes[n + i] << 8) | (planes[2 * n + i] << 16) | (planes[3 * n + i] << 24);
    pattern = (pattern + step) | 0;
    patterns[i] = pattern;
  }
  return new Float32Array(patterns.buffer);
}

/** A curve: samples y from time `start`, `step` seconds apart. */
class Curve {
  constructor(samples, [at, count, start, step]) {
    this.y = samples.subarray(at, at + count);
    this.start = start;
    this.step = step || 1;
  }

  /** Return the index of the last sample at or before time t. */
  index(t) {
    return Math.min(this.y.length - 1, Math.max(0, Math.floor((t - this.start) / this.step + 1e-6)));
  }

  at(t) {
    return this.y[this.index(t)];
  }
}

/** Return the data of panels and players: `panels` with Curves in place of indices, `scenes` with samples. */
async function shown() {
  const samples = await Promise.all(page.runs.map((run) => unpacked(run.block)));
  for (const panel of page.panels)
    for (const row of panel.rows)
      row.curves = row.curves.map((place, run) => (place ? new Curve(samples[run], place) : null));
  page.scenes.forEach((scene, run) => {
    if (scene) scene.samples = samples[run];
  });
  return page;
}
