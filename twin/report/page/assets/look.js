// Colours (Okabe and Ito's, from the style sheet) and line patterns, which distinguish rows without colour.

const SERIES = ["--blue", "--vermilion", "--green", "--purple", "--orange", "--sky", "--ink"];
const ROLES = {
  truth: { color: "--ink", width: 1.4, dash: [] },
  belief: { color: "--orange", width: 2.6, dash: [] },
  reference: { color: "--blue", width: 1.6, dash: [7, 4] },
  shifted: { color: "--green", width: 1.6, dash: [7, 3, 2, 3] },
  display: { color: "--purple", width: 1.4, dash: [2, 3] },
};
const OF_SEVERAL = { truth: [], belief: [8, 3], reference: [2, 3], shifted: [7, 3, 2, 3], display: [1, 4] };
const MEMBER_DASHES = [[], [9, 3], [2, 2], [12, 3, 2, 3], [5, 2, 1, 2], [4, 4], [1, 3]];

function color(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

function runColor(run) {
  return SERIES[run % SERIES.length];
}

/** Underline an element in its run's colour; double underline when the colours repeat with thick lines. */
function mark(node, run) {
  node.style.setProperty("--mark", `var(${runColor(run)})`);
  node.style.setProperty("--edge-style", run < SERIES.length ? "solid" : "double");
}

/** Return the style {color, width, dash} of a row's curve in a run. */
function look(row, run) {
  if (page.runs.length > 1) {
    const dash = row.member >= 0 && row.role === "truth" ? MEMBER_DASHES[row.member] : OF_SEVERAL[row.role];
    return { color: runColor(run), width: run < SERIES.length ? 1.5 : 2.6, dash };
  }
  if (row.member >= 0) {
    const dash = row.role === "truth" ? [] : row.role === "belief" ? [8, 3] : [2, 3];
    return { color: SERIES[row.member], width: 1.5, dash };
  }
  return ROLES[row.role];
}

/** Return a canvas context in CSS pixels at the screen's resolution. */
function prepared(canvas, width, height) {
  const ratio = window.devicePixelRatio || 1;
  const size = [Math.round(width * ratio), Math.round(height * ratio)];
  const pen = canvas.getContext("2d");
  // setting a size triggers a layout
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  return pen;
}

function made(tag, settings = {}, ...children) {
  const node = Object.assign(document.createElement(tag), settings);
  node.append(...children);
  return node;
}
