// Settings: station.toml as a form. Every change is checked by the station, which shows the lines that change; then the file is saved or taken.
import { make, said } from "../../parts/elements.js";
import { saveFile } from "../../parts/files.js";
import { texts } from "../../texts/texts.js";
import { attempt, button, copyOf, input, labelled, section, SetupPage, Wrong } from "../fields.js";
import * as requests from "../requests.js";
import { settingField } from "./setting_field.js";

const NAME = /^[A-Za-z0-9_-]+$/;
const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);
const byNumber = (a, b) => a.match(/\d+$/)[0] - b.match(/\d+$/)[0]; // keys of elements
const at = (values, key) => key.split(".").reduce((inside, part) => inside?.[part], values);

export class Page extends SetupPage {
  #state;
  #tag;
  #changes = new Map(); // by key: the new value, null to remove it
  #added = {}; // by table: indices or names of tables that the file does not have
  #fields = new Map();
  #tables = new Map(); // by prefix: the shown table
  #side = make("div", { className: "column settings-side" });
  #proposal = null;
  #turn = 0;

  // Read the file. Changes that were not saved stay.
  async show() {
    const t = texts.settings;
    const { content, tag } = await this.#read();
    [this.#state, this.#tag] = [content, tag];
    const { path, writable, pending, faults, hidden, restart, install } = content;
    const notes = [
      ...(writable ? [] : [[t.readOnly, make("code", { textContent: install })]]), ...(pending.length ? [[t.pending(pending, restart)]] : []),
      ...(hidden.length ? [[t.hidden(hidden)]] : []), ...(faults.length ? [[t.faulty, " ", ...said(faults.map((f) => `${f.key}: ${f.message}`).join("; "))]] : []),
    ];
    this.root.replaceChildren(make("h2", { textContent: texts.setup.pages.settings }), make("p", { className: "help", textContent: t.help(path) }),
      make("ul", { className: "warnings" }, ...notes.map((note) => make("li", {}, ...note))), this.answer, make("div", { className: "two even settings" }, this.#form(), this.#side));
    await this.#check();
  }

  // Until the file is read and checked anew, nothing can be saved: it would be refused as changed meanwhile.
  async #read() {
    const save = this.#side.querySelector("#save-settings");
    if (save) save.disabled = true;
    try {
      return await requests.settings();
    } catch (error) {
      if (save) save.disabled = false;
      throw error;
    }
  }

  #form() {
    this.#fields.clear();
    this.#tables.clear();
    const form = make("form", { className: "column settings-form" });
    form.addEventListener("submit", (event) => event.preventDefault());
    for (const table of new Set(this.#state.keys.map((setting) => setting.table))) form.append(this.#group(table));
    return form;
  }

  // All tables of one kind: one, those of an array, or those with names; and what adds another.
  #group(table) {
    const t = texts.settings;
    const group = make("div", { className: "group" });
    const base = table.replace(/\[\]$|\.NAME$/, "");
    const present = at(this.#state.values, base);
    const known = table.endsWith("[]") ? (present ?? []).map((_, n) => n) : table.endsWith(".NAME") ? Object.keys(present ?? {}).filter((name) => !name.includes(".")) : null;
    if (!known) {
      group.append(this.#table(table, table, table ? `[${table}]` : t.ownLevel, !table || present != null));
      return group;
    }
    const show = (step, there) => this.#table(table, `${base}.${step}`, table.endsWith("[]") ? t.element(base, step, present?.[step]?.name) : `[${base}.${step}]`, there);
    const all = () => [...known, ...(this.#added[table] ?? [])];
    group.append(...all().map((step) => show(step, known.includes(step))));
    const add = (step) => {
      (this.#added[table] ??= []).push(step);
      const made = show(step, false);
      (group.querySelector(":scope > .adding") ?? group).before(made);
      made.open = true;
      made.fill(); // the event of opening comes later
      made.querySelector("input, select").focus();
    };
    const adding = make("div", { className: "adding" });
    if (table.endsWith("[]")) adding.append(make("button", { type: "button", textContent: t.add(base), onclick: () => add(all().length) }));
    else {
      const name = input("name", "", { maxLength: 80 });
      adding.append(labelled(t.newName, name), button(t.addNamed(base), () => {
        if (!NAME.test(name.value) || all().includes(name.value)) throw new Wrong(t.badName(name.value));
        add(name.value);
        name.value = "";
      }, this.answer));
    }
    group.append(adding);
    return group;
  }

  // One table; its fields are made when it is opened.
  #table(table, prefix, title, there) {
    const mark = make("span", { className: "marks" });
    const box = make("details", { className: "panel table-of" }, make("summary", {}, make("strong", { textContent: title }), " ", mark));
    const settings = this.#state.keys.filter((setting) => setting.table === table);
    this.#tables.set(prefix, { box, mark, there });
    const fill = () => {
      if (box.querySelector(".fields")) return;
      const fields = settings.map((setting) => {
        const key = [prefix, setting.key.split(".").at(-1)].filter(Boolean).join(".");
        const value = this.#changes.has(key) ? this.#changes.get(key) : at(this.#state.values, key);
        const made = settingField(key, setting, value, (read) => this.#change(key, read));
        this.#fields.set(key, made);
        return made.field;
      });
      box.append(make("div", { className: "fields" }, ...fields));
      if (settings[0].optional_table && there) box.append(make("button", { type: "button", className: "plain", textContent: texts.settings.remove, onclick: () => this.#remove(prefix, box) }));
      this.#showFaults();
    };
    box.fill = fill;
    box.addEventListener("toggle", fill);
    if (!prefix) {
      box.open = true;
      fill();
    }
    return box;
  }

  #change(key, read) {
    attempt(null, async () => {
      const value = read();
      if (same(value ?? null, at(this.#state.values, key) ?? null)) this.#changes.delete(key);
      else this.#changes.set(key, value);
    }, this.answer).then((fine) => fine && this.#check());
  }

  #remove(prefix, box) {
    for (const key of this.#changes.keys()) if (key.startsWith(`${prefix}.`)) this.#changes.delete(key);
    this.#changes.set(prefix, null);
    box.remove();
    this.#tables.delete(prefix);
    this.#check();
  }

  #listed() {
    return [...this.#changes].map(([key, value]) => (value === null ? { key } : { key, value }));
  }

  // Let the station make the changes on paper: all faults at once, and the lines that change.
  async #check() {
    const turn = ++this.#turn;
    this.#proposal = null;
    await attempt(null, async () => {
      const proposal = this.#changes.size ? await requests.checkSettings(this.#listed()) : null;
      if (turn === this.#turn) this.#proposal = proposal;
    }, this.answer);
    if (turn !== this.#turn) return;
    this.#showFaults();
    this.#showSide();
  }

  // A fault names the place in the new file, in which removed elements are gone: the place of its field.
  #fieldOf(key) {
    for (const prefix of [...this.#changes.keys()].filter((k) => this.#changes.get(k) === null && /\.\d+$/.test(k)).sort(byNumber)) {
      const [, base, gone] = prefix.match(/^(.*)\.(\d+)$/);
      const found = key.match(new RegExp(`^${base.replaceAll(".", "\\.")}\\.(\\d+)(.*)$`));
      if (found && Number(found[1]) >= Number(gone)) key = `${base}.${Number(found[1]) + 1}${found[2]}`;
    }
    return key;
  }

  #faults() {
    return (this.#proposal ?? this.#state).faults.map((fault) => ({ ...fault, place: this.#proposal ? this.#fieldOf(fault.key) : fault.key }));
  }

  #tableOf(key) {
    return [...this.#tables.keys()].filter((prefix) => !prefix || key.startsWith(`${prefix}.`) || key === prefix).sort((a, b) => b.length - a.length)[0] ?? "";
  }

  #showFaults() {
    const t = texts.settings;
    const faults = this.#faults();
    for (const [key, { say: sayFault }] of this.#fields) sayFault(faults.filter((f) => f.place === key || f.place.startsWith(`${key}.`)).map((f) => f.message));
    for (const [prefix, { mark, box, there }] of this.#tables) {
      const own = (key) => this.#tableOf(key) === prefix;
      const [wrong, changed] = [faults.filter((f) => f.key && own(f.place)).length, [...this.#changes.keys()].filter(own).length];
      mark.textContent = [wrong && `✕ ${t.faultsHere(wrong)}`, changed && `△ ${t.changedHere(changed)}`, !there && !changed && t.absent].filter(Boolean).join(", ");
      box.classList.toggle("wrong", wrong > 0);
    }
  }

  #goTo(key) {
    const table = this.#tables.get(this.#tableOf(key))?.box;
    if (!table) return;
    table.open = true;
    table.fill();
    const field = [...this.#fields.keys()].find((name) => key === name || key.startsWith(`${name}.`));
    (this.#fields.get(field)?.control ?? table.querySelector("summary")).focus();
  }

  #showSide() {
    const t = texts.settings;
    const proposal = this.#proposal;
    if (!proposal) {
      this.#side.replaceChildren(section(t.changes, make("p", { textContent: t.noChanges })));
      return;
    }
    const lines = proposal.diff.split("\n").slice(2).map((line) => make("span", { className: line[0] === "+" ? "added" : line[0] === "-" ? "taken" : line[0] === "@" ? "place" : "", textContent: `${line}\n` }));
    const diff = make("pre", { className: "diff", tabIndex: 0, role: "group", ariaLabel: t.changes }, ...lines);
    const faults = this.#faults().map((fault) => make("li", {}, make("button", { type: "button", className: "plain", onclick: () => this.#goTo(fault.place) }, `${fault.key || t.between}: `, ...said(fault.message))));
    const notes = proposal.notes.map((note) => make("li", {}, `${note.key}: `, ...said(note.message)));
    const sound = !proposal.faults.length;
    const orders = make("div", { className: "buttons" });
    if (sound && this.#state.writable) orders.append(button(t.save, () => this.#save(), this.answer, { className: "primary", id: "save-settings" }));
    orders.append(make("button", { type: "button", className: "plain", textContent: t.discard, onclick: () => this.#discard() }), button(t.readAgain, () => this.show(), this.answer, { className: "plain" }));
    this.#side.replaceChildren(section(t.changes, make("ul", { className: "faults" }, ...faults), make("ul", { className: "warnings" }, ...notes), diff, sound && !this.#state.writable ? this.#toTake(proposal) : "", orders, make("p", { className: "help", textContent: t.restartHelp })));
  }

  // Where the service may not write, the administrator does.
  #toTake(proposal) {
    const t = texts.settings;
    const save = () => saveFile("station.toml", [proposal.text], "application/toml");
    const take = make("button", { type: "button", className: "primary", textContent: t.download, onclick: save });
    const command = input("command", `${this.#state.install} && ${this.#state.restart}`, { readOnly: true, ariaLabel: t.then });
    const copy = button(t.copyCommand, async () => {
      await copyOf(command);
      return t.copied;
    }, this.answer);
    return make("div", {}, make("p", { textContent: t.readOnly }), proposal.hidden ? make("ul", { className: "warnings" }, make("li", { textContent: t.hiddenInFile(proposal.hidden) })) : "", command, make("div", { className: "buttons" }, take, copy));
  }

  async #save() {
    const saved = await requests.saveSettings(this.#listed(), this.#tag);
    this.#forget();
    await this.show();
    return texts.settings.saved(saved.backup, saved.restart);
  }

  #discard() {
    this.#forget();
    attempt(null, () => this.show(), this.answer);
  }

  #forget() {
    this.#changes.clear();
    this.#added = {};
  }
}
