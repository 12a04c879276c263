// 3-D drawing of the robot, back to front. Lengths in mm, frame B: z up.

const CENTRE = [0, 0, -62];
const ROOM = 118;
const ROD = 7;
const MM_PER_N = 6;
const TRACE_STEP = 3;

const plus = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];

class Scene {
  constructor(scene, canvas) {
    Object.assign(this, scene);
    this.canvas = canvas;
  }

  /** Return `size` pose columns from `column` on at time t, linearly interpolated between frames. */
  read(t, column, size) {
    const { at, count, start, step } = this.frames;
    const place = Math.min(count - 1, Math.max(0, (t - start) / step));
    const frame = Math.min(Math.max(0, count - 2), Math.floor(place));
    const share = count > 1 ? place - frame : 0;
    return Array.from({ length: size }, (_, i) => {
      const begin = at + (column + i) * count + frame;
      return this.samples[begin] * (1 - share) + (count > 1 ? this.samples[begin + 1] * share : 0);
    });
  }

  /** Return the polygons, lines and texts to draw at time t, with points in B. */
  parts(t) {
    const ends = this.read(t, 0, 9);
    const p = this.read(t, 9, 3);
    const s = this.read(t, 12, 3);
    const parts = [...this.surfaceParts(s), ...this.traceParts(t)];
    const ring = Array.from({ length: 36 }, (_, i) => [
      56 * Math.cos((i * Math.PI) / 18), 56 * Math.sin((i * Math.PI) / 18), 0,
    ]);
    parts.push({ points: ring, fill: "--base", line: "--ink", width: 0.6, bias: -30, alpha: 0.75 });
    const hexagon = this.platform.flatMap((P, i) => [plus(P, this.axis[i], -9), plus(P, this.axis[i], 9)]);
    parts.push({ points: hexagon.map((corner) => plus(p, corner)), fill: "--platform", line: "--ink", width: 0.6 });
    this.B.forEach((B, i) => {
      const A = ends.slice(3 * i, 3 * i + 3);
      const P = plus(p, this.platform[i]);
      const axis = this.axis[i];
      const hue = SERIES[i];
      parts.push({ points: [plus(B, axis, -11), plus(B, axis, 11)], line: "--muted", width: 9 });
      parts.push({ points: [B, A], line: hue, width: 6 });
      parts.push({ text: String(i + 1), points: [plus(B, [0, 0, 1], 9)] });
      for (const end of [A, P]) parts.push({ points: [plus(end, axis, -ROD), plus(end, axis, ROD)], line: hue, width: 3.5 });
      for (const side of [-ROD, ROD])
        parts.push({ points: [plus(A, axis, side), plus(P, axis, side)], line: "--rod", width: 2.2 });
    });
    if (this.frames.second) parts.push(...this.secondParts(t, this.frames.second));
    if (this.frames.estimated) parts.push(...this.arrowParts(p, this.read(t, 18, 3), "--orange", 5, 60));
    return [...parts, ...this.arrowParts(p, this.read(t, 15, 3), "--ink", 2.2, 90)];
  }

  /** Add the twin's model as lines over the robot; its columns begin at `column`. */
  secondParts(t, column) {
    const ends = this.read(t, column, 9);
    const p = this.read(t, column + 9, 3);
    const style = { line: "--ink", width: 1.6, bias: 20 };
    const corners = this.platform.map((P) => plus(p, P));
    const legs = this.B.map((B, i) => ({ points: [B, ends.slice(3 * i, 3 * i + 3), corners[i]], ...style }));
    return [...legs, { points: [...corners, corners[0]], ...style }];
  }

  /** Add the surface's grid cells at displacement s. */
  surfaceParts(s) {
    const parts = [];
    for (let i = 0; this.surface && i + 1 < this.surface.length; i++)
      for (let k = 0; k + 1 < this.surface[i].length; k++) {
        const corners = [this.surface[i][k], this.surface[i + 1][k], this.surface[i + 1][k + 1], this.surface[i][k + 1]];
        const points = corners.map((corner) => plus(corner, s));
        parts.push({ points, fill: "--surface", line: "--surface-line", width: 0.4, surface: true });
      }
    return parts;
  }

  /** Add the platform's path up to time t. */
  traceParts(t) {
    const { at, count, start, step } = this.frames;
    const last = Math.min(count - 1, Math.floor((t - start) / step));
    const points = [];
    for (let i = 0; i <= last; i += TRACE_STEP)
      points.push([9, 10, 11].map((column) => this.samples[at + column * count + i]));
    return points.length > 1 ? [{ points, line: "--purple", width: 1.4, bias: 40 }] : [];
  }

  /** Add the force of the robot on the surface, as an arrow from its point of action. */
  arrowParts(p, F, line, width, bias) {
    const size = Math.hypot(...F);
    if (size < 0.05) return [];
    const tip = plus(p, F, MM_PER_N);
    const along = F.map((component) => component / size);
    const across = Math.hypot(along[0], along[1]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
    const back = plus(tip, along, -Math.min(7, 0.5 * MM_PER_N * size));
    const head = [plus(back, across, -3), tip, plus(back, across, 3)];
    return [{ points: [p, tip], line, width, bias }, { points: head, line, width, bias }];
  }

  /** Draw the pose at time t with the camera at `yaw` and `pitch` (rad), magnified by `zoom`. */
  draw(t, { yaw, pitch, zoom }) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const pen = prepared(this.canvas, width || 400, height || 400);
    const scale = (zoom * Math.min(width || 400, height || 400)) / (2 * ROOM);
    const [sin, cos, up, away] = [Math.sin(yaw), Math.cos(yaw), Math.sin(pitch), Math.cos(pitch)];
    const seen = (point) => {
      const [x, y, z] = plus(point, CENTRE, -1);
      const right = x * cos + y * sin;
      const depth = y * cos - x * sin;
      return [width / 2 + scale * right, height / 2 - scale * (z * away + depth * up), depth * away - z * up];
    };
    const parts = this.parts(t).map((part) => ({ ...part, points: part.points.map(seen) }));
    for (const part of parts) {
      part.far = part.points.reduce((sum, point) => sum + point[2], 0) / part.points.length - (part.bias || 0);
      // seen from above, the robot hides the surface; seen from below, the surface is transparent
      if (part.surface) part.far += up > 0 ? 1000 : -1000;
      if (part.surface && up <= 0) part.alpha = 0.6;
    }
    parts.sort((a, b) => b.far - a.far);
    pen.lineCap = pen.lineJoin = "round";
    for (const part of parts) this.drawPart(pen, part, scale);
    this.drawAxes(pen, height, sin, cos, up, away);
  }

  drawPart(pen, { points, fill, line, width, text, alpha }, scale) {
    if (text) {
      pen.fillStyle = color("--muted");
      pen.font = "12px system-ui, sans-serif";
      pen.fillText(text, points[0][0] - 3, points[0][1]);
      return;
    }
    pen.beginPath();
    points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    if (fill) {
      pen.closePath();
      pen.fillStyle = color(fill);
      pen.globalAlpha = alpha || 1;
      pen.fill();
      pen.globalAlpha = 1;
    }
    pen.strokeStyle = color(line);
    pen.lineWidth = Math.max(0.6, 0.5 * width * scale);
    pen.stroke();
  }

  drawAxes(pen, height, sin, cos, up, away) {
    const [x, y, size] = [34, height - 34, 22];
    const ends = { x: [cos, sin * up], y: [sin, -cos * up], z: [0, -away] };
    pen.strokeStyle = pen.fillStyle = color("--muted");
    pen.lineWidth = 1.2;
    pen.font = "11px system-ui, sans-serif";
    for (const [name, [right, down]] of Object.entries(ends)) {
      pen.beginPath();
      pen.moveTo(x, y);
      pen.lineTo(x + size * right, y + size * down);
      pen.stroke();
      pen.fillText(name, x + (size + 6) * right - 3, y + (size + 6) * down + 3);
    }
  }
}
