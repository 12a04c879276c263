// What is dropped onto the page. A supplier's FMU: asked about, its mapping shown with what is in doubt as choices, then
// swapped in. A log of a robot: kept with the others.

const element = (id) => document.getElementById(id);

export class Brought {
  /** `ask` sends, `say` shows a sentence, `use` is called with the name of a drive that shall be used, `log` with the
   * path of a log that was brought in. */
  constructor(ask, say, use, log) {
    this.ask = ask;
    this.say = say;
    this.log = log;
    this.dialog = element("brought");
    this.file = element("fmu");
    this.file.addEventListener("change", () => this.file.files.length && this.send(this.file.files[0]));
    const over = (event) => {
      event.preventDefault();
      document.body.classList.toggle("dropping", event.type === "dragover");
    };
    window.addEventListener("dragover", over);
    window.addEventListener("dragleave", over);
    window.addEventListener("drop", (event) => {
      over(event);
      if (event.dataTransfer.files.length) this.send(event.dataTransfer.files[0]);
    });
    element("agree").addEventListener("click", () => this.agree());
    element("swap").addEventListener("click", () => {
      this.dialog.close();
      use(this.name);
    });
  }

  async send(file) {
    this.say(`Bringing in ${file.name}.`);
    this.file.value = "";
    let answer;
    try {
      answer = await fetch(`file?name=${encodeURIComponent(file.name)}`, { method: "POST", body: file });
    } catch {
      this.say(`${file.name}: the server did not take it; it may be too large.`, true);
      return;
    }
    const text = await answer.text();
    if (!answer.ok) {
      this.say(text, true);
      return;
    }
    if (!/\.fmu$/.test(file.name)) {
      this.say("");
      this.log(text);
      return;
    }
    this.number = Number(text);
    this.ask({ op: "inspect", number: this.number });
  }

  inspected(answer) {
    if (!answer.commands) {
      this.say(answer.refused ?? answer.failed, true);
      return;
    }
    this.say("");
    this.found = answer;
    element("brought-title").textContent = `${answer.file}, FMI ${answer.fmi}${answer.tool ? `, ${answer.tool}` : ""}`;
    element("verdict").hidden = element("swap").hidden = true;
    element("agree").disabled = false;
    this.show(answer.command);
    this.dialog.showModal();
  }

  /** The roles of a drive with this command. */
  show(command) {
    const options = Object.keys(this.found.commands).map((name) => made("option", { value: name }, name));
    this.command = made("select", { id: "brought-command" }, ...options);
    this.command.value = command;
    this.command.addEventListener("change", () => this.show(this.command.value));
    const doubt = made("span", { className: this.found.sure ? "" : "doubt" }, this.found.sure ? "it takes" : "it takes, in doubt");
    const rows = [made("label", { htmlFor: "brought-command" }, doubt), this.command];
    this.roles = new Map();
    for (const role of this.found.commands[command]) {
      if (!role.required && !role.choices.length) continue;
      const offered = role.choices.map(([name, unit]) => made("option", { value: name }, `${name} [${unit || "no unit"}]`));
      const select = made("select", { id: `brought-${role.role}` }, made("option", { value: "" }, role.required ? "choose" : "none"), ...offered);
      select.value = role.chosen;
      this.roles.set(role.role, select);
      const name = made("label", { htmlFor: select.id, title: role.meaning, className: role.unsure ? "doubt" : "" });
      name.append(`${role.role} (${role.unit})${role.unsure ? ", in doubt" : ""}`);
      rows.push(name, select);
    }
    this.loop = new Map();
    if (this.found.looped.includes(command)) {
      rows.push(made("p", {}, "Our velocity loop stands in front of it; its gains are to be tuned:"));
      for (const [key, example] of Object.entries(this.found.loop)) {
        const field = made("input", { type: "number", step: "any", value: example, id: `brought-${key}` });
        this.loop.set(key, field);
        rows.push(made("label", { htmlFor: field.id }, key), field);
      }
    }
    element("brought-roles").replaceChildren(...rows);
  }

  agree() {
    const chosen = [...this.roles].filter(([, select]) => select.value).map(([role, select]) => [role, select.value]);
    const loop = [...this.loop].map(([key, field]) => [key, Number(field.value)]);
    const how = { command: this.command.value, roles: Object.fromEntries(chosen), loop: Object.fromEntries(loop) };
    element("agree").disabled = true;
    element("verdict").hidden = false;
    element("verdict").textContent = "On the bench.";
    this.ask({ op: "qualify", number: this.number, how });
  }

  qualified(answer) {
    element("agree").disabled = false;
    element("verdict").textContent = answer.verdict ?? answer.refused ?? answer.failed;
    element("swap").hidden = !answer.name;
    element("swap").textContent = answer.qualified ? "Use it" : "Use it all the same";
    this.name = answer.name;
  }
}
