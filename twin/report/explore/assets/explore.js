// Assemble the page: settings change the state, the state is requested, answers are drawn.

import { Faults } from "./faults.js";
import { Link } from "./link.js";
import { Log } from "./log.js";
import { Loops } from "./loops.js";
import { FaultMarks } from "./marks.js";
import { Picture } from "./picture.js";
import { Robot } from "./robot.js";
import { Score } from "./score.js";
import { Sliders } from "./sliders.js";
import { copied, fresh, History, MOST_PINS, plainView, read, written } from "./state.js";

const element = (id) => document.getElementById(id);
const KEPT = 500;
const DOUBLE = 600;
/** Position of the margin among the tiles. */
const MARGIN_AT = 6;

let begun = null;
let history = new History(fresh());
let pins = [];
let chosen = new Set();
let view = plainView();
let file = {};
let now = {};
let command = "";
const asked = new Map();
let shown = 0;
let waiting = null;
let listed = false;
let tab = null;
let recording = false;
let events = [];

const LOST = "The server does not answer: twin explore has ended, or was started anew. Trying again; your state is kept.";
const STRANGE = "twin explore was started anew with another token: open the address that it has printed in this browser, and this page goes on.";

const link = new Link(hear, (there, strange) => {
  const status = element("status");
  status.classList.toggle("lost", !there);
  status.textContent = there ? "" : strange ? STRANGE : LOST;
  for (const id of ["picture", "beside-robot"]) element(id).classList.toggle("old", !there);
  if (!there) {
    loops.lost();
    robot.waiting = false;
    if (recording) tellRecorded({ failed: "The server ended while the run was being recorded." });
  }
});
const picture = new Picture(() => askAll(), () => {
  measure();
  marks.place(picture.plots.plots);
});
const sliders = new Sliders(element("sliders"), element("search"), change);

const loops = new Loops(element("loops"), (point) => link.ask({ op: "loops", state: history.now, point }), () => showNumbers());
const score = new Score(element("score"), (slot) => link.ask({ op: "score", slot, state: slot === "file" ? fresh() : history.now }));
const askOnset = () => link.ask({ op: "onset", state: { ...history.now, faults: [] } });
const faults = new Faults(element("faults"), breakIt, askOnset, () => picture.clock.time);
const marks = new FaultMarks(faults);
const log = new Log((what) => link.ask({ ...what, ...look("try") }), say, addPin);

const robot = new Robot(element("beside-robot"), (what) => link.ask(what), say, () => history.now, go);

/** Record the latency from the input event to the frame that shows its answer. */
function measure() {
  if (!waiting) return;
  const id = waiting;
  waiting = null;
  const began = asked.get(id);
  for (const older of asked.keys()) if (older <= id) asked.delete(older);
  if (began === undefined) return;
  events.push(performance.measure("twin-follow", { start: began, end: performance.now(), detail: id }));
  if (events.length > KEPT) {
    performance.clearMeasures("twin-follow");
    events = [];
  }
}

const look = (slot) => ({ panels: [...chosen], layout: element("layout").value, span: picture.span, width: picture.width, robot: slot === 0 && element("player").open, list: slot === 0 && !listed });

/** Request the current state; `since`: time of the input event. */
function askNow(since = performance.now()) {
  const id = link.ask({ op: "show", slot: 0, state: history.now, ...look(0) });
  if (id) asked.set(id, since);
  loops.changed();
  score.changed();
}

function askPin(pin, number) {
  const what = pin.state ? { op: "show", state: pin.state } : { op: pin.log ? "log" : "recorded", ...pin };
  link.ask({ ...what, slot: number + 1, ...look(number + 1) });
}

function askAll() {
  askNow();
  pins.forEach(askPin);
}

function hear(answer) {
  if (answer.outdated) {
    if (answer.op === "loops") loops.lost();
    return;
  }
  if (answer.op === "begin") begin(answer);
  else if (answer.op === "describe") describe(answer);
  else if (answer.op === "runs") offerBeside(answer);
  else if (answer.slot === "try") log.tried(answer);
  else if (answer.op === "save") say(answer.saved ? `Saved: ${answer.saved}` : answer.refused ?? answer.failed, !answer.saved);
  else if (answer.op === "record") tellRecorded(answer);
  else if (answer.op === "onset") faults.begin(answer.onset);
  else if (["robot", "accept", "adopt"].includes(answer.op)) robot.take(answer);
  else if (answer.op === "score") score.take(answer);
  else if (answer.op === "loops") loops.take(answer);
  else if (answer.slot === "file") tellFile(answer);
  else if (answer.slot === 0) showNow(answer);
  else if (answer.slot > 0) showPin(answer);
}

function begin(answer) {
  const first = begun === null;
  begun = answer;
  if (first) {
    const given = read(location.hash.slice(1));
    if (given === null) say("What stands behind # in the address is no state of this page; the file is shown.", true);
    const [state, pinned, seen] = given && location.hash.length > 1 ? given : [answer.state, [], view];
    history = new History({ ...fresh(), ...state });
    pins = pinned;
    lookAs(seen);
  }
  element("title").textContent = answer.title;
  document.title = `${answer.name}: twin explore`;
  describe(answer);
  link.ask({ op: "show", slot: "file", state: fresh(), panels: [], span: null, width: 100 });
  link.ask({ op: "runs" });
  if (history.now.drive || history.now.body) link.ask({ op: "describe", state: history.now });
  namePins();
  refresh();
}

/** Restore the view of a link. */
function lookAs(seen) {
  view = seen;
  chosen = new Set(view.panels ?? begun.panels_at_first);
  element("panels").querySelector(".choices").dataset.titles = "";
  listed = false;
  offerLayout(begun.figure);
}

const FIGURES = { fig4: "Fig. 4", fig5: "Fig. 5" };

/** Offer the layout and the scorecard of Fig. 4 if the experiment belongs to it. */
function offerLayout(figure) {
  const own = figure === "fig4" ? [made("option", { value: figure }, `as ${FIGURES[figure]}`)] : [];
  element("layout").replaceChildren(made("option", { value: "" }, "plots"), ...own);
  element("layout").value = own.length ? view.layout : "";
  element("panels").hidden = element("layout").value !== "";
  element("score").hidden = !figure;
  element("score").querySelector("summary").textContent = `Scorecard of ${FIGURES[figure]}`;
}

function describe(answer) {
  if (answer.refused) return;
  offer(element("drive"), answer.drives, history.now.drive);
  offer(element("body"), answer.bodies, history.now.body);
  offerLayout(answer.figure);
  listed = false;
  sliders.describe(answer.sliders);
  sliders.show(history.now.set);
  faults.describe(answer.kinds, answer.duration);
  faults.show(history.now.faults);
}

function offer(select, names, value) {
  const options = names.map((name) => made("option", { value: name }, name));
  select.replaceChildren(made("option", { value: "" }, "as in the file"), ...options);
  select.value = value;
}

function offerBeside({ runs = [], logs = [] }) {
  const select = element("beside");
  const group = (label, kind, names) => made("optgroup", { label }, ...names.map((name) => made("option", { value: `${kind} ${name}` }, name)));
  const groups = [runs.length && group("Runs", "run", runs), logs.length && group("Logs of robots", "log", logs)];
  select.replaceChildren(select.firstElementChild, ...groups.filter(Boolean));
  select.disabled = runs.length + logs.length === 0;
}

/** Apply a change: update the settings, request the state, and add an undo step at the end of a movement. */
function change(key, value, over, again) {
  const since = window.event?.timeStamp;
  if (again) history.forget(DOUBLE);
  // a value equal to the file's is not a change
  if (value === undefined || value === sliders.base(key)) delete history.now.set[key];
  else history.now.set[key] = value;
  sliders.show(history.now.set);
  askNow(since);
  if (over) remember();
}

function breakIt(list, over) {
  history.now.faults = list;
  faults.show(list);
  marks.place(picture.plots?.plots ?? []);
  askNow(window.event?.timeStamp);
  if (over) remember();
}

function remember() {
  history.step();
  address();
}

function address() {
  const text = written(history.now, pins, view);
  window.history.replaceState(null, "", text ? `#${text}` : location.pathname);
  element("undo").disabled = history.before.length === 0;
  element("redo").disabled = history.after.length === 0;
  element("reset").disabled = written(history.now, []) === "";
}

/** Update the page after a jump to another state. */
function refresh() {
  element("drive").value = history.now.drive;
  element("body").value = history.now.body;
  sliders.show(history.now.set, {});
  faults.show(history.now.faults);
  address();
  askAll();
}

/** Switch to another state as an undo step. */
function go(state) {
  const before = history.now;
  history.now = copied(state);
  history.step();
  if (before.drive !== state.drive || before.body !== state.body) link.ask({ op: "describe", state: history.now });
  refresh();
}

function showNow(answer) {
  if (answer.id < shown) return;
  shown = answer.id;
  const problem = answer.refused ?? answer.failed ?? "";
  const sentence = problem || answer.trip || "";
  element("problem").textContent = sentence;
  element("problem").hidden = !sentence;
  element("picture").classList.toggle("old", Boolean(problem));
  sliders.refuse(problem);
  if (problem) return;
  waiting = answer.id;
  now = answer;
  command = answer.command;
  element("command").textContent = command;
  offerPanels(answer.all_panels);
  picture.take(0, answer);
  sliders.show(history.now.set, answer.values);
  showNumbers();
}

function tellFile(answer) {
  file = Object.fromEntries((answer.numbers ?? []).map(([name, , value]) => [name, value]));
  showNumbers();
}

// avoid "-0"
const rounded = (value, digits) => (value === null ? "none" : (Number(value.toFixed(digits)) + 0).toFixed(digits));

function showNumbers() {
  const numbers = [...(now.numbers ?? [])];
  if (numbers.length) numbers.splice(MARGIN_AT, 0, loops.tile);
  const boxes = numbers.map(([name, unit, value, reason, digits, meaning]) => {
    const before = name in file ? rounded(file[name], digits) : undefined;
    const text = rounded(value, digits);
    const old = before !== undefined && before !== text ? [made("span", { className: "before" }, `${before} → `)] : [];
    const number = made("strong", {}, ...old, value === null ? text : `${text} ${unit}`);
    const why = reason ? [made("span", { className: "why" }, reason)] : [];
    return made("div", { className: "box", title: meaning }, number, made("span", {}, name), ...why);
  });
  element("numbers").replaceChildren(...boxes);
}

function showPin(answer) {
  const number = answer.slot - 1;
  if (number >= pins.length) return;
  if (answer.refused ?? answer.failed) say(`${pins[number].name}: ${answer.refused ?? answer.failed}`, true);
  else picture.take(answer.slot, answer);
}

function namePins() {
  picture.name(["now", ...pins.map(({ name }) => name)]);
  const nodes = pins.map((pin, number) => {
    const name = made("input", { type: "text", value: pin.name, maxLength: 60 });
    name.setAttribute("aria-label", "Name of this state");
    name.addEventListener("change", () => {
      pin.name = name.value;
      namePins();
      address();
    });
    const to = made("button", { type: "button", hidden: !pin.state, title: "Return to this state" }, "Show");
    to.addEventListener("click", () => go(pin.state));
    const away = made("button", { type: "button", title: "Take it off the picture" }, "×");
    away.setAttribute("aria-label", `Remove ${pin.name}`);
    away.addEventListener("click", () => {
      pins = pins.filter((one) => one !== pin);
      repin();
    });
    const node = made("span", { className: "pinned" }, name, to, away);
    mark(node, number + 1);
    return node;
  });
  const present = made("span", { className: "pinned" }, "now");
  mark(present, 0);
  element("pins").replaceChildren(...(nodes.length ? [present, ...nodes] : []));
  element("pin").disabled = pins.length >= MOST_PINS;
}

function repin() {
  namePins();
  address();
  pins.forEach(askPin);
}

function addPin(pin) {
  if (pins.length >= MOST_PINS) return;
  pins.push(pin);
  repin();
}

function label(state) {
  const named = Object.entries(state.set).map(([key, value]) => `${key.split(".").at(-1)} ${value}`);
  return [state.drive, state.body, ...state.faults.map(({ kind }) => kind), ...named].filter(Boolean).slice(0, 2).join(", ") || "as in the file";
}

function offerPanels(titles) {
  if (!titles) return;
  listed = true;
  const box = element("panels").querySelector(".choices");
  if (box.dataset.titles === titles.join()) return;
  box.dataset.titles = titles.join();
  box.replaceChildren(
    ...titles.map((title) => {
      const tick = made("input", { type: "checkbox", checked: chosen.has(title) });
      tick.addEventListener("change", () => {
        if (tick.checked) chosen.add(title);
        else chosen.delete(title);
        view.panels = [...chosen];
        address();
        askAll();
      });
      return made("label", {}, tick, ` ${title}`);
    }),
  );
}

function say(sentence, bad = false) {
  element("out").textContent = sentence;
  element("out").classList.toggle("bad", bad);
}

function tellRecorded(answer) {
  element("record").disabled = recording = false;
  if (!answer.recorded) {
    tab?.close();
    say(answer.refused ?? answer.failed, true);
    return;
  }
  const report = made("a", { href: answer.report, target: "_blank", rel: "noopener" }, "report");
  element("out").replaceChildren(`Recorded: ${answer.recorded}  `, report);
  element("out").classList.remove("bad");
  link.ask({ op: "runs" });
  tab?.location.replace(answer.report);
}

function hearButtons() {
  const by = (id, act) => element(id).addEventListener("click", act);
  const back = () => history.undo() && settle();
  const forth = () => history.redo() && settle();
  by("undo", back);
  by("redo", forth);
  by("reset", () => go(fresh()));
  by("pin", () => addPin({ name: label(history.now), state: copied(history.now) }));
  by("copy", async () => {
    try {
      await navigator.clipboard.writeText(command);
      say("The command is in the clipboard.");
    } catch {
      element("command-shown").open = true;
      say("The browser gives no access to the clipboard; the command stands below the plots.", true);
    }
  });
  by("save", () => {
    const name = window.prompt("Name of the experiment's file, without .toml", "");
    if (name) link.ask({ op: "save", state: history.now, name });
  });
  by("record", () => {
    element("record").disabled = recording = true;
    say("Recording.");
    // open the window now: browsers block windows opened after the run
    tab = window.open("about:blank");
    if (tab) tab.document.title = "Recording";
    if (!link.ask({ op: "record", state: history.now })) tellRecorded({ failed: "The server does not answer." });
  });
  for (const id of ["drive", "body"])
    element(id).addEventListener("change", () => go({ ...copied(history.now), [id]: element(id).value }));
  element("beside").addEventListener("change", (event) => {
    const [kind, name] = event.target.value.split(/ (.*)/);
    if (kind === "run") addPin({ name, run: name });
    if (kind === "log") log.open(name);
    event.target.value = "";
  });
  element("layout").addEventListener("change", () => {
    view.layout = element("layout").value;
    element("panels").hidden = view.layout !== "";
    address();
    askAll();
  });
  element("player").addEventListener("toggle", () => askNow());
  window.addEventListener("hashchange", () => {
    const given = read(location.hash.slice(1));
    if (given === null) {
      say("What stands behind # in the address is no state of this page.", true);
      return;
    }
    pins = given[1];
    lookAs(given[2]);
    namePins();
    go(given[0]);
  });
  window.addEventListener("keydown", (event) => {
    const inField = event.target instanceof HTMLInputElement && event.target.type !== "range";
    if (!(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== "z" || inField) return;
    event.preventDefault();
    if (event.shiftKey) forth();
    else back();
  });
}

/** Update the page after undo and redo. */
function settle() {
  link.ask({ op: "describe", state: history.now });
  refresh();
}

hearButtons();
// open the robot where there is room next to the curves
element("player").open = window.matchMedia("(min-width: 1100px)").matches;
