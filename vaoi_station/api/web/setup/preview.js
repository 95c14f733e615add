// A file that was uploaded: what it would make, drawn to scale; its options are corrected, and it is confirmed.
import { make, said } from "../parts/elements.js";
import { number, texts } from "../texts/texts.js";
import { boardDrawing } from "./drawing.js";
import { attempt, button, choice, facts, input, labelled, section, SetupPage, Wrong } from "./fields.js";
import { markChoice } from "./marks.js";
import * as requests from "./requests.js";
import { typeAddress } from "./types.js";

const COLUMNS = ["ref", "x", "y", "rotation", "side", "package", "value", "fitted"];
// What a panel's fields must be, so that a refusal names the field and not the option of the command.
const LENGTH = "-?\\d*\\.?\\d+";
const PANEL = { repeat: /^[1-9]\d*x[1-9]\d*$/, pitch: new RegExp(`^${LENGTH}x${LENGTH}$`), rotate: /^-?\d+(\.\d+)?(,-?\d+(\.\d+)?)*$/, border: new RegExp(`^${LENGTH}x${LENGTH}$`) };

export class Page extends SetupPage {
  #preview = null; // as the station has it
  #chosen = null; // marks chosen by hand; null: as the import has found them
  #changes = Promise.resolve(); // the last change that was asked for: a change begins when the one before it has ended

  // `changed` are the options that were changed since the page was drawn.
  async show(changed = {}) {
    this.#preview ??= await requests.preview(this.name);
    const { filename, found, refusal, id } = this.#preview;
    const type = found ? await requests.previewed(id) : null;
    this.#chosen = null;
    const parts = [make("a", { href: "#/setup/types", className: "up", textContent: texts.setup.toTypes }), make("h2", { textContent: filename })];
    if (refusal) parts.push(make("p", { className: "answer refused" }, ...said(refusal, texts.translated.refusals["unreadable-board-data"])));
    const side = make("div", { className: "column" }, this.#options(found), this.#joined());
    if (found) side.append(this.#foundOf(found), this.#marks(type), this.#confirm(type));
    else side.append(this.#discard());
    parts.push(this.answer, make("div", { className: "two" }, type ? boardDrawing(type) : make("div"), side));
    const entered = new Entered(this.root, changed);
    this.root.replaceChildren(...parts);
    entered.restore(this.root);
  }

  #foundOf(found) {
    const t = texts.setup;
    const missing = found.missing.map((m) => make("li", {}, ...(m.what in t.missing ? [t.missing[m.what](m.count, found.boards)] : said(m.message))));
    return section(t.found, facts([
      [t.format, found.format], [t.size, t.millimetres(found.size_mm.map((v) => number(v, 2)).join(" × "))],
      [t.componentsOf, t.partsOf(found.components, found.parts_top, found.parts_bottom)], [t.fiducialCount, String(found.fiducials)],
      [t.boards, found.boards ? String(found.boards) : ""],
      [t.heights, t.ofAll(found.heights, found.components)], [t.cutOuts, found.cut_outs ? String(found.cut_outs) : ""],
      [t.notFitted, found.not_fitted ? String(found.not_fitted) : ""],
      [t.unit, found.table ? `${found.table.unit} (${found.table.unit_from})` : ""],
    ]), missing.length ? make("h4", { textContent: t.missingTitle }) : "", make("ul", { className: "warnings" }, ...missing),
    found.check.length ? make("details", {}, make("summary", { textContent: t.toCheck(found.check.length) }), make("ul", {}, ...found.check.map(({ code, message, values }) => make("li", {}, ...said(message, texts.translated.remarks[code]?.(values)))))) : "");
  }

  // Side, name, for a centroid file its unit and columns, and which panel the board is of. Every change is imported anew
  // by the station. Of a file that was refused nothing is known: a person states unit and columns in the words of the refusal.
  #options(found) {
    const [t, options] = [texts.setup, this.#preview.options];
    const side = choice("side", t.sides, options.side);
    const name = input("name", options.name ?? found?.name ?? "", { maxLength: 80 });
    const fields = [labelled(t.sideUp, side), labelled(t.typeName, name)];
    const centroid = found?.table;
    const unit = choice("units", { "": t.recognised, mm: "mm", inch: "inch", mil: "mil" }, options.units ?? "");
    const columns = new Map();
    const refused = !found && /--(columns|units)/.test(this.#preview.refusal);
    if (centroid || refused) {
      fields.push(labelled(t.unit, unit));
      if (refused) fields.push(labelled(t.columns, input("columns", options.columns ?? "", { maxLength: 400, placeholder: "ref=1,x=3,y=4,rotation=5,side=Layer" })));
      const headers = centroid?.headers ?? [];
      for (const column of centroid ? COLUMNS : []) {
        const now = centroid.columns.find((c) => c.name === column)?.number ?? "";
        const last = Math.max(headers.length, ...centroid.columns.map((c) => c.number));
        // A rotation that no column states is stated as absent: else a column that may be one would refuse the file.
        const none = column === "rotation" ? "none" : "";
        const list = { [none]: t.noColumn, ...Object.fromEntries(Array.from({ length: last }, (_, n) => [n + 1, `${n + 1}: ${headers[n] ?? ""}`])) };
        if (column === "side") Object.assign(list, t.allOn);
        columns.set(column, choice(`column-${column}`, list, String((column === "side" && centroid.all_on) || now || none)));
        fields.push(labelled(t.columnNames[column], columns.get(column)));
      }
    }
    const steps = found?.steps ?? [options.step].filter(Boolean);
    const step = choice("step", { "": t.recognised, ...Object.fromEntries(steps.map((name) => [name, name])) }, options.step ?? "");
    if (steps.length) fields.push(labelled(t.step, step));
    const panel = Object.keys(PANEL).map((key) => input(key, options[key] ?? "", { maxLength: 40, placeholder: t.panelExamples[key] }));
    const form = make("form", { className: "fields", id: "options" }, ...fields);
    // A panel that the file itself describes is not repeated.
    if (!found?.boards || options.repeat) {
      const rest = Object.keys(PANEL).map((key, n) => labelled(t.panelFields[key], panel[n]));
      form.append(make("details", { id: "panel", open: Boolean(options.repeat) }, make("summary", { textContent: t.panel }), make("div", { className: "fields" }, ...rest)));
    }
    form.addEventListener("change", ({ target }) => attempt(null, async () => {
      if (!panel.includes(target)) return this.#again(optionOf(target, columns));
      const [repeat, pitch] = panel.map(panelValue);
      if (repeat && !pitch) return panel[1].focus();
      const wrong = repeat && panel.find((field) => panelValue(field) && !PANEL[field.name].test(panelValue(field)));
      if (wrong) throw new Wrong(t.panelWrong(t.panelFields[wrong.name], wrong.value, t.panelExamples[wrong.name]));
      return this.#again(Object.fromEntries(panel.map((field) => [field.name, repeat && panelValue(field)])));
    }, this.answer));
    form.addEventListener("submit", (event) => event.preventDefault());
    return section(t.options, form);
  }

  // Change options. A person may change the next one before the page is drawn with the former: each is merged with the options that hold when it is sent.
  #again(changed) {
    const change = async () => {
      this.#preview = await requests.change(this.#preview.id, { ...this.#preview.options, ...changed });
      await this.show(changed);
    };
    const now = (this.#changes = this.#changes.then(change, change));
    // What is stored is what is shown: until it is drawn anew, that is the board type before the change.
    const store = () => this.root.querySelector("#confirm");
    if (store()) store().disabled = true;
    return now.finally(() => {
      if (store()) store().disabled = this.#changes !== now;
    });
  }

  #joined() {
    const [t, { options }] = [texts.setup, this.#preview];
    const file = make("input", { type: "file", id: "join-file", className: "file" });
    file.addEventListener("change", () => attempt(file, async () => {
      const other = await requests.upload(file.files[0], { side: options.side });
      await this.#again({ join: other.id });
    }, this.answer));
    const drop = options.join ? button(t.unjoin, () => this.#again({ join: null }), this.answer) : "";
    return section(t.join, make("p", { className: "help", textContent: options.join ? t.joined : t.joinHelp }),
      make("div", { className: "buttons" }, file, make("label", { htmlFor: file.id, className: "button", textContent: t.chooseFile }), drop));
  }

  #marks(type) {
    return section(texts.setup.marksTitle, markChoice(type, (chosen) => {
      this.#chosen = chosen;
      this.root.querySelector(".drawing").replaceWith(boardDrawing({ ...type, ...chosen }));
    }));
  }

  #discard() {
    return button(texts.setup.discard, async () => {
      await requests.discard(this.#preview.id);
      location.hash = "#/setup/types";
    }, this.answer, { className: "plain" });
  }

  // A board type of the same name is replaced by a second press: it may be one that boards are filmed with.
  #confirm(type) {
    const t = texts.setup;
    const store = button(t.confirm(type.name), async () => {
      const sure = store.classList.contains("sure");
      try {
        await requests.storeType(this.#chosen ? { ...type, ...this.#chosen } : type, sure ? {} : requests.ifNew);
      } catch (error) {
        if (sure || error.code !== "changed") throw error;
        store.classList.add("sure");
        store.textContent = t.replaceSure(type.name);
        throw new Wrong(t.exists(type.name));
      }
      // It may be gone already: deleted by another person, or because others are newer.
      await requests.discard(this.#preview.id).catch((error) => {
        if (error.status !== 404) throw error;
      });
      location.hash = typeAddress(type.name);
    }, this.answer, { className: "primary", id: "confirm" });
    return make("div", { className: "buttons" }, store, this.#discard());
  }
}

// Two numbers with any cross between them and any decimal sign; the comma of the rotations divides them.
function panelValue(field) {
  const value = field.value.replace(/\s/g, "").replace(/[×X*]/g, "x");
  return field.name === "rotate" ? value : value.replaceAll(",", ".");
}

// What a field of the options says, as the station takes it. A column is stated with all others.
function optionOf(field, columns) {
  if (!field.name.startsWith("column-")) return { [field.name]: field.value.trim() };
  const given = [...columns].filter(([, select]) => select.value).map(([column, select]) => `${column}=${select.value}`);
  return given.length ? { columns: given.join(",") } : {};
}

// What a person has entered but not yet changed, the field in which the person is, and what is unfolded: they are there again when the page is
// drawn anew.
class Entered {
  #values;
  #field;
  #open;

  constructor(root, changed) {
    const fields = [...root.querySelectorAll("input[name]:not([type=file])")];
    const entered = fields.filter((field) => field.value !== field.defaultValue && field.value.trim() !== changed[field.name]);
    this.#values = new Map(entered.map(({ name, value }) => [name, value]));
    this.#field = root.contains(document.activeElement) ? document.activeElement.name : "";
    this.#open = [...root.querySelectorAll("details[id][open]")].map(({ id }) => id);
  }

  restore(root) {
    for (const id of this.#open) root.querySelector(`#${CSS.escape(id)}`)?.setAttribute("open", "");
    const named = (name) => root.querySelector(`[name="${CSS.escape(name)}"]`);
    for (const [name, value] of this.#values) if (named(name)) named(name).value = value;
    const now = this.#field && named(this.#field);
    if (!now) return;
    now.focus();
    if (!this.#values.has(this.#field)) return;
    // The browser sees no change if the person goes on to the next field without typing more.
    const untilChanged = new AbortController();
    now.addEventListener("change", () => untilChanged.abort(), untilChanged);
    now.addEventListener("blur", () => now.dispatchEvent(new Event("change", { bubbles: true })), untilChanged);
  }
}
