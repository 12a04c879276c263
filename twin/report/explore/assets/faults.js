// Faults on the time axis: kind, target, onset, magnitude.

import { hearSlider } from "./sliders.js";
import { MOST_FAULTS } from "./state.js";

const FINE = 1000;
const DIGITS = 4;
const BEYOND = 4;

export class Faults {
  /** `changed` is called with the list and whether the movement is over; `ask` requests the onset of a fault in
   * contact, `time` returns the player's time. */
  constructor(box, changed, ask, time) {
    Object.assign(this, { box, changed, time });
    this.list = [];
    this.kind = made("select", {});
    this.kind.setAttribute("aria-label", "Kind of fault");
    this.add = made("button", { type: "button" }, "Add fault");
    this.meaning = made("small", {});
    this.rows = made("div", {});
    box.append(made("div", { className: "bar" }, this.kind, this.add), this.meaning, this.rows);
    this.kind.addEventListener("change", () => this.explain());
    this.add.addEventListener("click", () => ask());
  }

  /** Add a fault of the chosen kind at `onset` (s) in contact; undefined without contact: the player's time is used. */
  begin(onset) {
    const { kind, targets, magnitudes } = this.kinds.get(this.kind.value);
    const fault = { kind, target: targets[0], onset_s: Number((onset ?? this.time()).toFixed(3)) };
    if (magnitudes) fault.magnitude = magnitudes[1];
    this.changed([...this.list, fault], true);
  }

  describe(kinds, duration) {
    this.kinds = new Map(kinds.map((kind) => [kind.kind, kind]));
    this.duration = duration;
    this.kind.replaceChildren(...kinds.map(({ kind, meaning }) => made("option", { value: kind, title: meaning }, kind)));
    this.form = null;
    this.explain();
  }

  /** Show the description of the chosen kind. */
  explain() {
    this.meaning.textContent = this.kinds.get(this.kind.value)?.meaning ?? "";
  }

  show(list) {
    this.list = list;
    if (!this.kinds) return;
    this.add.disabled = list.length >= MOST_FAULTS;
    const form = JSON.stringify(list.map(({ kind, target }) => [kind, target]));
    if (form !== this.form) {
      this.puts = list.map((_, number) => this.row(number));
      this.rows.replaceChildren(...this.puts.map(({ node }) => node));
      this.form = form;
      if (list.length) this.box.open = true;
    }
    list.forEach((fault, number) => this.puts[number].put(fault));
  }

  change(number, more, over) {
    this.changed(this.list.map((fault, i) => (i === number ? { ...fault, ...more } : fault)), over);
  }

  /** Return the range of a kind's magnitude; null if it has none. */
  range(kind) {
    const { magnitudes, unit } = this.kinds?.get(kind) ?? {};
    if (!magnitudes) return null;
    const [small, , large] = magnitudes;
    return { low: Math.min(small, large) / BEYOND, high: BEYOND * Math.max(small, large), unit };
  }

  row(number) {
    const known = this.kinds.get(this.list[number].kind);
    const change = (more, over) => this.change(number, more, over);
    const away = made("button", { type: "button", className: "back" }, "Remove");
    away.addEventListener("click", () => this.changed(this.list.filter((_, i) => i !== number), true));
    const targets = (known?.targets ?? []).map((target) => made("option", { value: target }, target));
    const target = made("select", {}, ...targets);
    target.setAttribute("aria-label", "What breaks");
    target.value = this.list[number].target;
    target.addEventListener("change", () => change({ target: target.value }, true));
    const head = made("div", { className: "head" }, made("label", {}, this.list[number].kind), away);
    const node = made("div", { className: "setting changed fault" }, head, made("small", {}, known?.meaning ?? ""), target);
    const onset = this.number(node, "at (s)", 0, this.duration, (value, over) => change({ onset_s: value }, over));
    const reach = this.range(this.list[number].kind);
    const label = reach?.unit ? `how much (${reach.unit})` : "how much";
    const size = reach && this.number(node, label, reach.low, reach.high, (value, over) => change({ magnitude: value }, over));
    return {
      node,
      put: (fault) => {
        onset(fault.onset_s);
        if (size) size(fault.magnitude);
      },
    };
  }

  number(node, label, low, high, change) {
    const range = made("input", { type: "range", min: 0, max: FINE });
    const field = made("input", { type: "text", inputMode: "decimal" });
    for (const one of [range, field]) one.setAttribute("aria-label", label);
    const value = () => Number((low + ((high - low) * Number(range.value)) / FINE).toPrecision(DIGITS));
    const typed = () => (Number.isFinite(Number(field.value)) ? Number(field.value) : field.value);
    hearSlider(range, (over) => change(value(), over));
    field.addEventListener("change", () => change(typed(), true));
    node.append(range, made("span", { className: "entry" }, field, made("span", { className: "unit" }, label)));
    return (now) => {
      if (document.activeElement !== range) range.value = Math.round((FINE * (now - low)) / (high - low)) || 0;
      if (document.activeElement !== field) field.value = now;
    };
  }
}
