// The rows of a light program as a table that can be edited. An empty field takes the value of the station.
import { make, markWrong, signButton } from "../../parts/elements.js";
import { entered, number, texts } from "../../texts/texts.js";
import { choice, input, tick, Wrong } from "../fields.js";

const PER_CAMERA = ["exposure_us", "gain_db"];
const NAMES = { on_us: "on", exposure_us: "exposure", gain_db: "gain" };

// A number as a person writes it, with a point or a comma; undefined for an empty field.
function parsed(text) {
  if (!text.trim()) return undefined;
  const value = Number(text.trim().replace(",", "."));
  if (!Number.isFinite(value)) throw new Wrong(texts.lights.notNumber(text.trim()));
  return value;
}

const alike = (values) => values.every((value) => value === values[0]);

export class StepTable {
  // `onChange` is called with every change, and at once when rows come or go.
  constructor(cameras, onChange) {
    const t = texts.lights;
    [this.cameras, this.onChange] = [cameras, onChange];
    this.steps = []; // in the form of a board type, with lists for all cameras
    this.check = null;
    this.each = tick("each", t.everyCamera);
    this.each.querySelector("input").addEventListener("change", () => {
      this.#spread(this.#single);
      this.draw();
      this.onChange();
    });
    this.body = make("tbody");
    const head = make("tr", {}, ...t.columns.map((textContent) => make("th", { scope: "col", textContent })));
    const steps = make("table", { id: "steps" }, make("thead", {}, head), this.body);
    const box = make("div", { className: "table", tabIndex: 0, role: "group", ariaLabel: t.program }, steps);
    const append = () => this.#insert(this.steps.length, this.steps.at(-1) ?? { light: this.check?.lights[0]?.name ?? "" });
    this.add = make("button", { type: "button", textContent: t.add, id: "add-step", onclick: append });
    this.root = make("div", {}, cameras.length > 1 ? this.each : "", box, make("div", { className: "buttons" }, this.add));
  }

  get #single() {
    return !this.each.querySelector("input").checked;
  }

  // Show these steps, which have the form of a board type.
  show(steps) {
    this.steps = steps.map((step) => ({ ...step }));
    const differ = this.steps.some((step) => PER_CAMERA.some((key) => step[key] && !alike(step[key])));
    if (differ) this.each.querySelector("input").checked = true;
    this.#spread(this.#single);
    this.draw();
  }

  // One field for all cameras keeps the value of the first one.
  #spread(single) {
    for (const step of this.steps) {
      for (const key of PER_CAMERA) {
        if (step[key] && single) step[key] = step[key].slice(0, 1);
        else if (step[key]?.length === 1) step[key] = this.cameras.map(() => step[key][0]);
      }
    }
  }

  // The steps as they are entered. Fields that are no numbers raise Wrong; nothing is rounded.
  read() {
    return [...this.body.rows].map((row) => {
      const field = (key) => [...row.querySelectorAll(`[data-key="${key}"]`)];
      const step = { light: row.querySelector('[data-key="light"]').value };
      const on = parsed(field("on_us")[0].value);
      if (on !== undefined) step.on_us = on;
      for (const key of PER_CAMERA) {
        const values = field(key).map((one) => parsed(one.value));
        if (values.every((value) => value === undefined)) continue;
        // A camera whose field is empty has the value of the station, which a list must state.
        step[key] = values.map((value, camera) => value ?? this.cameras[camera][key]);
      }
      return step;
    });
  }

  #keep() {
    try {
      this.steps = this.read();
    } catch (error) {
      if (!(error instanceof Wrong)) throw error; // the fields stay as they are; the page shows what is wrong
    }
  }

  #insert(at, step) {
    this.#keep();
    this.steps.splice(at, 0, { ...step });
    this.#changed(at);
  }

  #changed(row) {
    this.draw();
    // The pressed button is gone: the keyboard goes on at the row.
    (this.body.rows[Math.min(row, this.steps.length - 1)]?.querySelector("select, input") ?? this.add).focus();
    this.onChange();
  }

  #move(row, to) {
    this.#keep();
    const [step] = this.steps.splice(row, 1);
    if (to !== null) this.steps.splice(to, 0, step);
    this.#changed(to ?? row);
  }

  draw() {
    this.body.replaceChildren(...this.steps.map((step, n) => this.#row(step, n)));
    this.mark(this.check);
  }

  #row(step, n) {
    const t = texts.lights;
    const button = (sign, label, work, disabled = false) => signButton(sign, label, work, { title: label, disabled });
    const orders = make("div", { className: "step-orders" }, button("↑", t.up(n), () => this.#move(n, n - 1), n === 0),
      button("↓", t.down(n), () => this.#move(n, n + 1), n === this.steps.length - 1),
      button("+", t.copy(n), () => this.#insert(n + 1, this.steps[n])), button("✕", t.remove(n), () => this.#move(n, null)));
    return make("tr", {}, make("th", { scope: "row", textContent: String(n) }), make("td", {}, this.#light(step, n)), make("td", {}, this.#number("on_us", n, step.on_us)),
      ...PER_CAMERA.map((key) => make("td", {}, this.#cameraFields(key, n, step[key]))), make("td", {}, orders));
  }

  #light(step, n) {
    const known = (this.check?.lights ?? []).map((light) => light.name);
    const names = step.light && !known.includes(step.light) ? [...known, step.light] : known;
    const field = known.length ? choice("light", names, step.light) : input("light", step.light);
    return this.#labelled(field, "light", texts.lights.ofRow(texts.lights.light, n));
  }

  #number(key, n, value, camera = null) {
    const t = texts.lights;
    const name = t[NAMES[key]];
    const field = input(key, value === undefined ? "" : entered(value), { inputMode: "decimal" });
    if (camera !== null) field.dataset.camera = camera;
    return this.#labelled(field, key, camera === null ? t.ofRow(name, n) : t.ofCamera(name, n, this.cameras[camera].name));
  }

  #cameraFields(key, n, values) {
    if (this.#single) return this.#number(key, n, values?.[0]);
    return make("div", { className: "each-camera" }, ...this.cameras.flatMap((camera, k) => {
      return [make("span", { textContent: camera.name, ariaHidden: "true" }), this.#number(key, n, values?.[k], k)];
    }));
  }

  #labelled(field, key, label) {
    field.dataset.key = key;
    field.ariaLabel = label;
    field.addEventListener(field.tagName === "SELECT" ? "change" : "input", () => this.onChange());
    return field;
  }

  // Show what a check has found: the values behind empty fields, and which fields are wrong.
  mark(check) {
    this.check = check;
    if (!check) return;
    for (const [n, row] of [...this.body.rows].entries()) {
      const values = check.steps[n];
      for (const field of row.querySelectorAll("[data-key]")) {
        const { key, camera } = field.dataset;
        const wrong = check.faults.some((fault) => fault.step === n && fault.field === key && (camera === undefined || fault.camera === undefined || fault.camera === Number(camera)));
        markWrong(field, wrong);
        const listed = { exposure_us: values?.exposures_us, gain_db: values?.gains_db }[key];
        const shown = key === "on_us" ? values?.on_us : listed?.[Number(camera ?? 0)];
        if (key !== "light") field.placeholder = shown === undefined ? "" : number(shown, shown % 1 ? 1 : 0);
      }
    }
  }
}
