// Scorecard of the paper's figure to which the experiment belongs; changed claims come first.

const QUIET = 120;
const JUDGED = {
  fig4: "All four runs of Fig. 4 with these settings: with and without force control, straight and askew.",
  fig5: "The tasks of this run, by Fig. 5, on the true force and position.",
};
const MARKS = { holds: "✓", fails: "✗", "not reproduced": "✗", "reproduced after all": "✓" };

export class Score {
  /** `ask` is called with the requested claims: the file's, or the current state's. */
  constructor(box, ask) {
    this.box = box;
    this.ask = ask;
    this.judged = "";
    this.note = made("p", { className: "hint", role: "status" });
    this.table = made("div", { className: "scroll", tabIndex: 0, role: "region", ariaLabel: "Claims" });
    box.append(this.note, this.table);
    box.addEventListener("toggle", () => this.changed());
  }

  changed() {
    clearTimeout(this.timer);
    if (!this.box.open) return;
    this.box.classList.add("old");
    this.box.ariaBusy = "true";
    this.wanted = Infinity;
    if (this.now) this.note.textContent = "old: the runs of this state are not there yet";
    this.timer = setTimeout(() => {
      if (!this.file) this.ask("file");
      this.wanted = this.ask("now");
    }, QUIET);
  }

  take(answer) {
    if (answer.slot === "file") this.file = answer.claims ?? [];
    else {
      this.now = answer.claims ?? [];
      this.scores = answer.scores ?? [];
      this.judged = JUDGED[answer.figure] ?? "";
      if (!answer.claims) this.note.textContent = answer.refused ?? answer.failed;
      // an answer requested before the last change is outdated
      this.box.classList.toggle("old", !answer.claims || answer.id < this.wanted);
      this.box.ariaBusy = String(answer.id < this.wanted);
    }
    if (this.now && this.file) this.show();
  }

  show() {
    const before = new Map(this.file.map((claim) => [claim.text, claim]));
    const turned = (claim) => before.has(claim.text) && before.get(claim.text).verdict !== claim.verdict;
    const order = [...this.now].sort((a, b) => turned(b) - turned(a));
    const rows = order.map((claim) => {
      const verdict = `${MARKS[claim.verdict] ?? ""} ${claim.verdict}`;
      const was = turned(claim) ? ` (was: ${before.get(claim.text).verdict})` : "";
      const name = made("th", { scope: "row", title: claim.quote }, claim.text);
      const mark = made("td", { className: ["holds", "reproduced after all"].includes(claim.verdict) ? "good" : "bad", title: claim.reason }, verdict + was);
      return made("tr", { className: turned(claim) ? "turned" : "" }, name, mark, made("td", {}, claim.measured), made("td", {}, claim.expected));
    });
    const scores = this.scores.map(({ held, judged, of }) => `${held} of ${judged} ${of}`);
    if (this.now.length && !this.box.classList.contains("old")) this.note.textContent = `${scores.join(", ")} hold; ${order.filter(turned).length} turned over. ${this.judged}`;
    const head = made("tr", {}, ...["claim", "verdict", "measured", "expected"].map((text) => made("th", {}, text)));
    this.table.replaceChildren(made("table", {}, made("thead", {}, head), made("tbody", {}, ...rows)));
  }
}
