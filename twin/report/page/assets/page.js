// Assemble the page after its samples are unpacked.

/** Add a switch for each run that hides its curves in all plots. */
function runSwitches(plots) {
  const box = document.getElementById("runs");
  if (page.runs.length < 2) return;
  page.runs.forEach((run, number) => {
    const tick = made("input", { type: "checkbox", checked: true });
    const name = made("span", {}, run.label);
    mark(name, number);
    tick.addEventListener("change", () => {
      run.hidden = !tick.checked;
      plots.redraw();
    });
    box.append(made("label", {}, tick, name));
  });
}

/** Print in light colours, with all sections open. */
function preparePrint(plots, player) {
  const opened = [];
  window.addEventListener("beforeprint", () => {
    document.documentElement.dataset.print = "";
    for (const details of document.querySelectorAll("details:not([open])")) {
      details.open = true;
      opened.push(details);
    }
    plots.drawAll();
    player.draw();
  });
  window.addEventListener("afterprint", () => {
    delete document.documentElement.dataset.print;
    while (opened.length) opened.pop().open = false;
    plots.drawAll();
    player.draw();
  });
}

async function begin() {
  await shown();
  const clock = new Clock(page.end);
  const plots = new Plots(document.getElementById("plots"), clock);
  const player = new Player(document.getElementById("robot"), clock);
  runSwitches(plots);
  preparePrint(plots, player);
  document.getElementById("closer").addEventListener("click", () => plots.zoomBy(0.5));
  document.getElementById("wider").addEventListener("click", () => plots.zoomBy(2));
  document.getElementById("all").addEventListener("click", () => plots.all());
  for (const button of document.querySelectorAll("button[data-t]"))
    button.addEventListener("click", () => {
      clock.set(Number(button.dataset.t));
      document.getElementById("replay").scrollIntoView();
    });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    plots.redraw();
    player.draw();
  });
  plots.all();
  clock.set(0);
  document.getElementById("replay").classList.add("ready");
  requestAnimationFrame(() => {
    performance.mark("twin-ready");
    setTimeout(() => plots.drawAll());
  });
}

if ("DecompressionStream" in window) begin();
else document.getElementById("old").hidden = false;
