// Small helpers to make and change elements.
import { language, texts } from "../texts/texts.js";
import { Refusal } from "./rest.js";

export const $ = (id) => document.getElementById(id);

export function make(name, fields = {}, ...children) {
  const element = Object.assign(document.createElement(name), fields);
  element.append(...children);
  return element;
}

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
  return said(error.message, error.translation ?? refusals[error.code] ?? refused);
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
