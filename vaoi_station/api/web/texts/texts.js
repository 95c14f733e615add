// The texts in the language of this browser; those of the other one are not loaded.
import { language } from "./language.js";

export { changeLanguage, language, otherLanguage } from "./language.js";
export const { texts } = await (language === "de" ? import("./de.js") : import("./en.js"));

// A text by its name; those of a view are in an object of their own: "trends.title".
const named = (name) => name.split(".").reduce((group, key) => group[key], texts);

// Fill in every element that names a text.
export function fillIn(root) {
  for (const element of root.querySelectorAll("[data-text]")) element.textContent = named(element.dataset.text);
  for (const element of root.querySelectorAll("[data-label]")) element.setAttribute("aria-label", named(element.dataset.label));
}

// English stands for every country: British dates name the month, and hours run to 24, as on the axes.
const locale = { en: "en-GB", de: "de-DE" }[language];

export const number = (value, digits = 0) => value.toLocaleString(locale, { minimumFractionDigits: digits, maximumFractionDigits: digits });
// A value in a field, as a person would enter it in this language.
export const entered = (value) => value.toLocaleString(locale, { maximumSignificantDigits: 9, useGrouping: false });
export const clock = (time) => new Date(time).toLocaleTimeString(locale, { hour: "2-digit", minute: "2-digit", second: "2-digit" });
export const moment = (time) => new Date(time).toLocaleString(locale, { dateStyle: "medium", timeStyle: "medium" });

// A span of time in its largest whole unit.
export function duration(seconds) {
  const [unit, length_s] = [["day", 86400], ["hour", 3600], ["minute", 60]].find(([, length]) => seconds >= length) ?? ["second", 1];
  return (seconds / length_s).toLocaleString(locale, { style: "unit", unit, unitDisplay: "long" });
}

// The label of a time on an axis whose labels lie `step_s` apart.
export function tick(time, step_s) {
  const form = step_s >= 86400 ? { day: "2-digit", month: "2-digit" } : { hour: "2-digit", minute: "2-digit", hourCycle: "h23" };
  return new Date(time).toLocaleString(locale, form);
}
