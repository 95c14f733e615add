// Light programs: what the rows of a board type are filmed with, as a table and to scale, checked by the station with every change.
import { make, said, saidOf, setText } from "../../parts/elements.js";
import * as rest from "../../parts/rest.js";
import { entered, number, texts } from "../../texts/texts.js";
import { button, choice, labelled, section, SetupPage, table, Wrong } from "../fields.js";
import * as requests from "../requests.js";
import { StepTable } from "./steps.js";
import { timeline } from "./timeline.js";

const REST_MS = 300; // after the last key, before the station checks

const programAddress = (name) => `#/setup/programs/${encodeURIComponent(name)}`;

export class Page extends SetupPage {
  #finding = make("div", { className: "finding", role: "status" });
  #origin = make("p");
  #none = make("div", { id: "no-program" });
  #editor = make("div");
  #drawing = make("div");
  #limits = make("div");
  #type = null;
  #tag = "";
  #steps = null;
  #timer = 0;
  #turn = 0;
  #closed = false;

  async show() {
    const [t, { name }] = [texts.lights, this];
    const names = (await requests.typeList()).board_types.filter((type) => !type.fault).map((type) => type.name);
    const title = make("h2", { textContent: t.title });
    if (!names.length) {
      this.root.replaceChildren(title, make("p", { textContent: t.noTypes }));
      return;
    }
    const chosen = choice("type", names, names.includes(name) ? name : names[0]);
    chosen.addEventListener("change", () => {
      location.hash = programAddress(chosen.value);
    });
    await this.#load(name ?? names[0]);
    const store = button(t.store, () => this.#store(), this.answer, { className: "primary", id: "store-program" });
    const discard = button(t.discard, async () => this.#shown(this.#type.program), this.answer);
    const without = button(t.without, () => this.#remove(), this.answer, { className: "plain", id: "remove-program" });
    this.#editor.append(this.#steps.root, this.#finding, make("div", { className: "buttons" }, store, discard, without));
    const program = section(t.program, this.#origin, this.#none, this.#editor, this.answer);
    this.root.replaceChildren(title, make("p", { className: "help", textContent: t.help }), labelled(t.boardType, chosen), program, section(t.timeline, this.#drawing), section(t.limits, this.#limits));
    await this.#shown(this.#type.program);
    this.#takeTrial();
  }

  close() {
    this.#closed = true;
    clearTimeout(this.#timer);
  }

  async #load(name) {
    const { content, tag } = await requests.boardType(name);
    [this.#type, this.#tag] = [content, tag];
    if (this.#steps) return;
    const check = await requests.checkProgram(name);
    this.#steps = new StepTable(check.cameras, () => this.#changed());
    this.#steps.check = check;
  }

  // Show a program, or that there is none.
  async #shown(program) {
    const check = await requests.checkProgram(this.#type.name, program ?? []);
    if (this.#closed) return;
    this.#steps.check = check;
    this.#steps.show(program ?? []);
    this.#show(check, program?.length ? "board-type" : check.origin);
  }

  // A new program begins as what the rows are filmed with without one.
  #begin() {
    const { check } = this.#steps;
    this.#editor.hidden = false;
    this.#steps.show(check.steps.length ? check.steps.map((step) => fewest(step, check)) : [{ light: check.lights[0]?.name ?? "" }]);
    this.#steps.root.querySelector("tbody select, tbody input").focus();
    rest.unattended(this.#check());
  }

  // The settings of the page "Cameras", which led here, become one more row.
  #takeTrial() {
    const given = Object.fromEntries(this.query);
    if (!given.light) return;
    const step = { light: given.light };
    if (given.on_us) step.on_us = Number(given.on_us);
    for (const key of ["exposure_us", "gain_db"]) {
      // The other cameras keep their values; with all alike, one value is enough.
      const values = this.#steps.cameras.map((camera) => (camera.camera === Number(given.camera ?? 0) ? Number(given[key]) : camera[key]));
      if (given[key] && values.some((value, n) => value !== this.#steps.cameras[n][key])) step[key] = values;
    }
    const before = this.#type.program ?? [];
    this.#steps.show([...before, step]);
    setText(this.answer, texts.lights.fromTrial);
    this.#changed();
  }

  #changed() {
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => rest.unattended(this.#check()), REST_MS);
  }

  // The newest check counts: a slower answer to an earlier one is dropped.
  async #check() {
    const turn = ++this.#turn;
    let program;
    try {
      program = this.#steps.read();
    } catch (error) {
      if (!(error instanceof Wrong)) throw error;
      this.#refuse(error.message);
      return null;
    }
    try {
      const check = await requests.checkProgram(this.#type.name, program);
      if (turn !== this.#turn || this.#closed) return null;
      this.#steps.mark(check);
      this.#show(check, check.origin);
      return check;
    } catch (error) {
      if (!(error instanceof rest.Refusal)) throw error;
      this.#refuse(...saidOf(error)); // a value that no station takes, such as a negative time
      return null;
    }
  }

  #refuse(...words) {
    this.#finding.replaceChildren(make("p", { className: "answer refused" }, ...words));
  }

  #show(check, origin) {
    const t = texts.lights;
    setText(this.#origin, t.origins[origin]);
    const own = origin === "request" || origin === "board-type";
    const left = !own && this.#editor.contains(document.activeElement);
    this.#editor.hidden = !own;
    this.#none.replaceChildren(...(own ? [] : this.#offer(check)));
    if (left) this.#none.querySelector("button").focus();
    this.#drawing.replaceChildren(check.steps.length ? timeline(check) : "");
    const found = check.faults.map((fault) => {
      const where = t.where(fault.step ?? null, fault.camera === undefined ? undefined : check.cameras[fault.camera].name);
      return make("li", {}, where ? make("strong", { textContent: `${where}: ` }) : "", ...translated(fault));
    });
    const head = check.usable ? make("p", check.unchecked.length ? { className: "answer", textContent: t.usableSoFar } : { className: "answer done", textContent: t.usable }) : make("p", { className: "answer refused", textContent: t.faults(found.length) });
    const unchecked = check.unchecked.length ? [make("p", { textContent: t.unchecked }), make("ul", { className: "warnings" }, ...check.unchecked.map((note) => make("li", {}, ...translated(note))))] : [];
    this.#finding.replaceChildren(head, found.length ? make("ul", { className: "warnings" }, ...found) : "", ...unchecked);
    this.#finding.dataset.usable = check.usable;
    this.#showLimits(check);
  }

  // In place of the editor: what rows are filmed with instead, and a beginning.
  #offer(check) {
    const t = texts.lights;
    const [first] = check.cameras;
    const each = (values, key) => (values.every((value) => value === values[0]) ? entered(values[0] ?? first[key]) : values.map(entered).join(" / "));
    const rows = check.steps.map((step, n) => [String(n), step.light, step.on_us === undefined ? "" : entered(step.on_us), each(step.exposures_us, "exposure_us"), each(step.gains_db, "gain_db")]);
    const begin = make("button", { type: "button", id: "begin-program", className: "primary", textContent: t.begin });
    begin.addEventListener("click", () => this.#begin());
    return [rows.length ? table(t.columns.slice(0, -1), rows) : make("p", { textContent: t.noLights }), make("div", { className: "buttons" }, begin)];
  }

  #showLimits(check) {
    const t = texts.lights;
    const us = (value) => (value === undefined ? t.unknown : number(value, value % 1 ? 1 : 0));
    const range = (limits) => (limits ? `${us(limits[0])} … ${us(limits[1])}` : t.unknown);
    const cameras = check.cameras.map((c) => [c.name, us(c.longest_lit_us), us(c.readout_us), range(c.exposure_limits_us), range(c.gain_limits_db), t.ways[c.way]]);
    const lights = check.lights.map((l) => [l.name, l.channels?.join(", ") ?? "", us(l.on_us), range(l.on_limits_us)]);
    this.#limits.replaceChildren(table(t.limitColumns, cameras), lights.length ? table(t.lightColumns, lights) : "");
  }

  async #store() {
    const t = texts.lights;
    const program = this.#steps.read();
    const check = await this.#check();
    // What the station refuses is shown beside the rows, and is not stored: arming would refuse it with the next board.
    if (!check?.usable) return "";
    await requests.storeType({ ...this.#type, program }, requests.ifStill(this.#tag));
    await this.#load(this.#type.name);
    await this.#shown(this.#type.program);
    return t.stored;
  }

  async #remove() {
    const { program: _, ...rest } = this.#type;
    await requests.storeType(rest, requests.ifStill(this.#tag));
    await this.#load(this.#type.name);
    await this.#shown(undefined);
    return texts.lights.removed;
  }
}

const translated = ({ code, message, action, values }) => said(`${message} ${action ?? ""}`.trim(), texts.translated.program[code]?.(values));

// A step with those values only that are not the station's, as a person would write it.
function fewest(step, check) {
  const light = check.lights.find((one) => one.name === step.light);
  const differs = (values, key) => values.some((value, n) => value !== check.cameras[n][key]);
  return {
    light: step.light,
    ...(step.on_us !== undefined && step.on_us !== light?.on_us ? { on_us: step.on_us } : {}),
    ...(differs(step.exposures_us, "exposure_us") ? { exposure_us: step.exposures_us } : {}),
    ...(differs(step.gains_db, "gain_db") ? { gain_db: step.gains_db } : {}),
  };
}
