// Parts of a diagram: frame with a scale, lines, curves.

export const EDGE = { left: 52, right: 10, top: 8, bottom: 22 };

/** Set the canvas height (px), draw grid lines at round values from `bottom` to `top`, return the drawing context. */
export function framed(canvas, height, bottom, top) {
  const width = canvas.parentElement.clientWidth || 300;
  canvas.style.height = `${height}px`;
  const pen = prepared(canvas, width, height);
  const floor = height - EDGE.bottom;
  const y = (value) => floor - ((value - bottom) / (top - bottom)) * (floor - EDGE.top);
  pen.font = "11px system-ui, sans-serif";
  pen.fillStyle = color("--muted");
  pen.strokeStyle = color("--grid");
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  for (const [value, text] of ticks(bottom, top, 4)) {
    line(pen, [[EDGE.left, y(value)], [width - EDGE.right, y(value)]]);
    pen.fillText(text, EDGE.left - 6, y(value));
  }
  pen.textAlign = "center";
  pen.textBaseline = "top";
  return { pen, width, floor, y };
}

/** Draw a line through `points` with gaps at NaN. */
export function line(pen, points) {
  pen.beginPath();
  let down = false;
  for (const [x, y] of points) {
    if (down) pen.lineTo(x, y);
    else pen.moveTo(x, y);
    down = Number.isFinite(y);
  }
  pen.stroke();
}

/** Draw a curve in the colour of run `number`. */
export function curve(number, points, { pen, width, floor }) {
  pen.save();
  pen.beginPath();
  pen.rect(EDGE.left, EDGE.top, width - EDGE.left - EDGE.right, floor - EDGE.top);
  pen.clip();
  pen.strokeStyle = color(runColor(number));
  pen.lineWidth = 1.5;
  line(pen, points);
  pen.restore();
}
