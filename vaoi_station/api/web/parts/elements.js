// Small helpers to make and change elements.
import { fillIn, language, texts } from "../texts/texts.js";
import { Refusal } from "./rest.js";

export const $ = (id) => document.getElementById(id);

export function make(name, fields = {}, ...children) {
  const element = Object.assign(document.createElement(name), fields);
  element.append(...children);
  return element;
}

// A button that shows a sign, with its name in words.
export const signButton = (textContent, ariaLabel, onclick, fields = {}) =>
  make("button", { type: "button", textContent, ariaLabel, onclick, ...fields });

const scripts = new Map();

// Load a library once; after a failure it is tried again by the next who needs it.
export function loadScript(src) {
  const load = (done, failed) => {
    const onerror = () => {
      scripts.delete(src);
      failed(new TypeError(src));
    };
    document.head.append(make("script", { src, onload: done, onerror }));
  };
  if (!scripts.has(src)) scripts.set(src, new Promise(load));
  return scripts.get(src);
}

// Whether a field has what cannot be used.
export const markWrong = (field, wrong) => (field.ariaInvalid = wrong ? "true" : null);

// What has its elements from a piece of HTML, and finds them by their ids.
export class View {
  constructor(html, root = make("div")) {
    this.root = root;
    root.innerHTML = html;
    fillIn(root);
  }

  part(id) {
    return this.root.querySelector(`#${id}`);
  }
}

// Of these elements one is reached by the tabulator, the others from it by the arrow keys, as WAI-ARIA has it. A key also presses.
export function arrowKeys(root, elements) {
  root.addEventListener("keydown", (event) => {
    const by = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    const all = elements();
    if (!by || !all.includes(document.activeElement)) return;
    event.preventDefault();
    const next = all[(all.indexOf(document.activeElement) + by + all.length) % all.length];
    next.focus();
    next.click();
  });
}

// The choices of a select, from pairs of value and text.
export const options = (pairs) => pairs.map(([value, textContent]) => make("option", { value, textContent }));

// The lines of a dl, from pairs of name and value.
export const lines = (pairs) => pairs.flatMap(([name, value]) => [make("dt", { textContent: name }), make("dd", {}, ...[value].flat())]);

// Screen readers announce a live region whenever its text is set, so it is set only when it changes.
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export function showLines(list, lines) {
  const wanted = JSON.stringify(lines);
  if (wanted === list.dataset.shown) return;
  list.dataset.shown = wanted;
  list.replaceChildren(...lines.map((line) => make("li", { textContent: line })));
}

// What the station says, which is English. On a page in another language a translation stands first, and its own words behind
// "Details"; without a translation they are marked as English, so that screen readers pronounce them right.
export function said(sentence, translation = "") {
  if (language === "en") return [sentence];
  const original = make("span", { lang: "en", textContent: sentence });
  if (!translation) return [original];
  return [`${translation} `, make("details", { className: "original" }, make("summary", { textContent: texts.details }), original)];
}

// The same of a request that had no effect. A page that knows more of the cause gives the refusal a `translation`.
export function saidOf(error) {
  if (!(error instanceof Refusal)) return [texts.noAnswer];
  const { refusals, refused } = texts.translated;
  return said(error.message, error.translation ?? refusals[error.code] ?? texts.refusals[error.code] ?? refused);
}

// Why a press had no effect, in the operator's words. The station's own sentence is for programs and engineers: it is behind "Why?".
export function showRefusal(element, error) {
  if (!(error instanceof Refusal)) {
    element.replaceChildren(texts.noAnswer);
    return;
  }
  const why = make("details", { className: "refusal" }, make("summary", { textContent: texts.why }), make("p", { lang: "en", textContent: error.detail }));
  element.replaceChildren(`${texts.refusals[error.code] ?? texts.refusals.other} `, why);
}
