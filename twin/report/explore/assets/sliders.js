// Settings as sliders, fields, choices or switches: the first dozen, the changed ones, or the search results.

const FINE = 1000;
const DIGITS = 4;
const MOST_FOUND = 60;

/** Convert between a value and the slider's scale from 0 to FINE. */
function place(slider, value) {
  const { low, high, log } = slider;
  const share = log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
  return Math.round(FINE * Math.min(1, Math.max(0, share)));
}

export function valueAt(slider, position) {
  const { low, high, log, kind } = slider;
  const share = position / FINE;
  const value = log ? low * (high / low) ** share : low + share * (high - low);
  return kind === "whole" ? Math.round(value) : Number(value.toPrecision(DIGITS));
}

/** Call `moved` on each movement of a slider, with whether it ended. Held keys count as one movement. */
export function hearSlider(range, moved) {
  let held = false;
  let going = false;
  range.addEventListener("keydown", () => (held = true));
  range.addEventListener("input", () => {
    going = held;
    moved(false);
  });
  range.addEventListener("change", () => held || moved(true));
  const release = () => {
    held = false;
    if (going) moved(true);
    going = false;
  };
  for (const end of ["keyup", "blur"]) range.addEventListener(end, release);
}

const shown = (value) => (typeof value === "number" ? String(Number(value.toPrecision(10))) : String(value ?? ""));

export class Sliders {
  /** `changed` is called with a key, its value (undefined: as in the file), whether the movement is over, and whether
   * it was the second click of a double click, which replaces the first one. */
  constructor(box, search, changed) {
    this.box = box;
    this.search = search;
    this.changed = changed;
    this.rows = new Map();
    this.moved = {};
    search.addEventListener("input", () => this.arrange());
  }

  describe(sliders) {
    this.sliders = new Map(sliders.map((slider) => [slider.key, slider]));
    this.rows.clear();
    this.box.replaceChildren();
    this.arranged = "";
  }

  /** Set the values of the file. */
  base(key) {
    const { value, default: usual } = this.sliders.get(key);
    return this.moved[key] ?? value ?? usual;
  }

  /** Show the values of `set`; `moved`: values derived from them. */
  show(set, moved) {
    this.set = set;
    if (moved) this.moved = moved;
    this.arrange();
    for (const [key, row] of this.rows) if (!row.node.hidden) row.put(set[key] ?? this.base(key), key in set);
  }

  /** Show the matching rows. */
  arrange() {
    if (!this.sliders) return;
    const words = this.search.value.toLowerCase().split(/\s+/).filter(Boolean);
    const all = [...this.sliders.values()];
    const fits = ({ key, help }) => words.every((word) => `${key} ${help}`.toLowerCase().includes(word));
    const first = all.filter((s) => s.first !== null).sort((a, b) => a.first - b.first);
    const others = all.filter((s) => s.first === null && s.key in (this.set ?? {}));
    const wanted = (words.length ? all.filter(fits).slice(0, MOST_FOUND) : [...first, ...others]).map((s) => s.key);
    const keys = wanted.join(" ");
    if (keys === this.arranged) return;
    this.arranged = keys;
    for (const key of wanted) if (!this.rows.has(key)) this.rows.set(key, this.row(this.sliders.get(key)));
    for (const [key, row] of this.rows) row.node.hidden = !wanted.includes(key);
    const none = made("p", { className: "hint" }, "No key has these words.");
    this.box.replaceChildren(...wanted.map((key) => this.rows.get(key).node), ...(wanted.length ? [] : [none]));
    for (const key of wanted) this.rows.get(key).put((this.set ?? {})[key] ?? this.base(key), key in (this.set ?? {}));
  }

  refuse(sentence) {
    for (const [key, row] of this.rows) {
      const name = key.split(".").at(-1);
      row.node.classList.toggle("refused", Boolean(sentence) && key in this.set && sentence.includes(name));
    }
  }

  row(slider) {
    const { key, kind, help } = slider;
    const name = made("label", { htmlFor: `value-${key}` }, help);
    const back = made("button", { type: "button", className: "back", hidden: true, title: "As in the file" }, "back");
    const change = (value, over, again = false) => this.changed(key, value, over, again);
    back.addEventListener("click", () => change(undefined, true));
    const node = made("div", { className: "setting" }, made("div", { className: "head" }, name, back));
    node.dataset.key = key;
    const put = this[kind === "choice" || kind === "switch" ? "choice" : "number"](slider, node, change);
    node.append(made("small", { className: "key" }, key));
    return {
      node,
      put: (value, isChanged) => {
        node.classList.toggle("changed", isChanged);
        back.hidden = !isChanged;
        put(value);
      },
    };
  }

  number(slider, node, change) {
    const range = made("input", { type: "range", min: 0, max: FINE, step: 1 });
    range.setAttribute("aria-label", slider.help);
    const field = made("input", { type: "text", inputMode: "decimal", id: `value-${slider.key}`, autocomplete: "off" });
    node.append(range, made("span", { className: "entry" }, field, made("span", { className: "unit" }, slider.unit)));
    hearSlider(range, (over) => change(valueAt(slider, Number(range.value)), over));
    range.title = `Double click: ${shown(slider.default ?? slider.value)}`;
    range.addEventListener("dblclick", () => {
      const usual = slider.default ?? undefined;
      change(usual === this.base(slider.key) ? undefined : usual, true, true);
    });
    field.addEventListener("change", () => {
      const text = field.value.trim();
      const bare = slider.unit && text.endsWith(slider.unit) ? text.slice(0, -slider.unit.length).trim() : text;
      const value = Number(bare);
      // the server refuses text that is not a number, with the error message of a file
      if (text === "") change(undefined, true);
      else change(Number.isFinite(value) ? value : text, true);
    });
    return (value) => {
      if (document.activeElement !== field || Number(field.value) !== value) field.value = shown(value);
      if (document.activeElement !== range || place(slider, value) !== Number(range.value))
        range.value = typeof value === "number" ? place(slider, value) : 0;
      range.setAttribute("aria-valuetext", `${shown(value)} ${slider.unit}`);
    };
  }

  choice(slider, node, change) {
    const choices = slider.kind === "switch" ? [true, false] : slider.choices;
    const texts = slider.kind === "switch" ? ["yes", "no"] : choices.map(String);
    const options = choices.map((_, i) => made("option", { value: i }, texts[i]));
    const select = made("select", { id: `value-${slider.key}` }, ...options);
    node.append(made("span", { className: "entry" }, select));
    select.addEventListener("change", () => change(choices[Number(select.value)], true));
    return (value) => (select.selectedIndex = choices.indexOf(value));
  }
}
