// Comparison with a robot's log, read with the column map in its folder; sets the log's start time.

const element = (id) => document.getElementById(id);

export class Log {
  /** `ask` sends a request, `say` shows a message, `pin` is called with the log to compare with. */
  constructor(ask, say, pin) {
    Object.assign(this, { say, pin, dialog: element("log") });
    element("lay").addEventListener("click", () => {
      this.wanted = { log: this.path, shift_s: Number(element("log-shift").value) || 0 };
      element("log-problem").textContent = "Reading.";
      ask({ op: "log", slot: "try", ...this.wanted });
    });
  }

  open(path) {
    this.path = element("log-title").textContent = path;
    element("log-problem").textContent = "";
    if (!this.dialog.open) this.dialog.showModal();
  }

  tried(answer) {
    if (!this.dialog.open) return;
    const problem = answer.refused ?? answer.failed ?? "";
    element("log-problem").textContent = problem;
    if (problem) return;
    this.dialog.close();
    if (answer.note) this.say(`${this.path}: ${answer.note}`);
    this.pin({ name: this.path.split("/").at(-1), ...this.wanted });
  }
}
