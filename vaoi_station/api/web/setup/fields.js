// Pieces of forms that the pages under "Set up" share.
import { lines, make, options, saidOf, setText } from "../parts/elements.js";
import { Refusal } from "../parts/rest.js";
import { moment, texts } from "../texts/texts.js";

let count = 0;

// What a person has entered cannot be used: shown as a refusal, without asking the station.
export class Wrong extends Error {}

// A field under its label; `unit` stands behind the label, `help`, a text or elements, below the field.
export function labelled(text, field, { unit = "", help = "" } = {}) {
  field.id ||= `field-${++count}`;
  const label = make("label", { htmlFor: field.id, textContent: unit ? `${text}, ${unit}` : text });
  const box = make("div", { className: "field" }, label, field);
  if (help) {
    const said = make("p", { className: "help", id: `${field.id}-help` }, ...[help].flat());
    field.setAttribute("aria-describedby", said.id);
    box.append(said);
  }
  return box;
}

// The value is also the one that a changed field is compared with.
export const input = (name, value = "", fields = {}) => make("input", { name, defaultValue: value, autocomplete: "off", spellcheck: false, ...fields });

export function choice(name, choices, value = "") {
  const list = Array.isArray(choices) ? choices.map((one) => [one, one]) : Object.entries(choices);
  const select = make("select", { name }, ...options(list));
  select.value = value;
  return select;
}

// A choice among runs; the first, unless `id` is one of them.
export function runChoice(runs, id) {
  const named = runs.map((run) => [run.id, texts.setup.runOf(run.board_id ?? run.id, moment(run.started))]);
  return choice("run", Object.fromEntries(named), runs.some((run) => run.id === id) ? id : (runs[0]?.id ?? ""));
}

export function tick(name, text, checked = false) {
  const box = make("input", { type: "checkbox", name, checked });
  return make("label", { className: "tick" }, box, make("span", { textContent: text }));
}

// Copies what a field has; it is selected, so that it can be copied by hand too.
export async function copyOf(field) {
  field.select();
  await navigator.clipboard?.writeText(field.value).catch(() => {});
}

// A button that is disabled while its work goes on; what the station refuses is shown in `answer`.
export function button(text, work, answer, fields = {}) {
  const made = make("button", { type: "button", textContent: text, ...fields });
  made.addEventListener("click", () => attempt(made, work, answer));
  return made;
}

let orders = 0; // orders that have begun
const saidBy = new WeakMap(); // of each line, the number of the order that wrote it

export async function attempt(control, work, answer) {
  const before = control?.disabled;
  if (control) control.disabled = true;
  const order = ++orders;
  const write = (text, kind) => {
    say(answer, text, kind);
    saidBy.set(answer, order);
  };
  write(texts.setup.working, "working");
  try {
    const said = await work();
    // An order that ends with nothing to say does not take away what a later one has said meanwhile.
    if (said || saidBy.get(answer) <= order) write(said || "", said ? "done" : "");
    if (said) reveal(answer);
    return true;
  } catch (error) {
    if (!(error instanceof Refusal) && !(error instanceof TypeError) && !(error instanceof Wrong)) throw error;
    write(error instanceof Wrong ? error.message : "", "refused");
    if (!(error instanceof Wrong)) answer.replaceChildren(...saidOf(error));
    reveal(answer);
    return false;
  } finally {
    if (control) control.disabled = before;
  }
}

// A button may be far below the place that says what came of it.
const reveal = (answer) => answer.scrollIntoView({ block: "nearest" });

export function say(answer, text, kind = "") {
  setText(answer, text);
  answer.className = `answer ${kind}`;
}

// The place where a page says what came of the last order.
export const answerLine = () => make("p", { className: "answer", role: "status" });

// A page under "Set up", of what its address names; `query`: what a reload must find again. `show` draws it.
export class SetupPage {
  answer = answerLine();

  constructor(root, name, query) {
    Object.assign(this, { root, name, query });
  }
}

export function facts(pairs) {
  return make("dl", { className: "facts" }, ...lines(pairs.filter(([, value]) => value !== "" && value != null)));
}

export function section(title, ...content) {
  const head = make("h3", { textContent: title, id: `head-${++count}` });
  const made = make("section", { className: "panel" }, head, ...content);
  made.setAttribute("aria-labelledby", head.id);
  return made;
}

export function table(heads, rows) {
  const head = make("tr", {}, ...heads.map((textContent) => make("th", { scope: "col", textContent })));
  const body = rows.map((cells) => make("tr", {}, ...cells.map((cell) => make("td", {}, cell ?? ""))));
  return make("div", { className: "table", tabIndex: 0, role: "group" }, make("table", {}, make("thead", {}, head), make("tbody", {}, ...body)));
}
