// A log of a robot laid beside: which of its columns is what, and when it begins.

const element = (id) => document.getElementById(id);

export class Log {
  /** `ask` sends, `say` shows a sentence, `pin` is called with what shall be laid beside. */
  constructor(ask, say, pin) {
    this.ask = ask;
    this.say = say;
    this.pin = pin;
    this.dialog = element("log");
    element("lay").addEventListener("click", () => {
      this.wanted = { log: this.path, map: element("log-map").value, shift_s: Number(element("log-shift").value) || 0 };
      element("log-problem").textContent = "Reading.";
      this.ask({ op: "log", slot: "try", ...this.wanted });
    });
  }

  open(path) {
    this.ask({ op: "columns", log: path });
  }

  proposed(answer) {
    if (answer.map === undefined) {
      this.say(answer.refused ?? answer.failed, true);
      return;
    }
    this.path = answer.log;
    element("log-title").textContent = answer.log;
    element("log-map").value = answer.map;
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
