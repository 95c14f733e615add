// What the doctor finds, in the language of the page: by the code of a finding, with its values.
import { make, said } from "../parts/elements.js";
import { texts } from "../texts/texts.js";

// A code of another version of the station has no words of its own; those of a refusal or a reason may fit.
function wordsOf({ code, figures, names, subject }) {
  const { findings, refusals } = texts.translated;
  const known = findings[code] ?? [refusals[code] ?? texts.refusals[code] ?? texts.reasons[code] ?? ""];
  const [message, action = ""] = known.map((text) => (typeof text === "function" ? text({ ...names, ...figures, subject }) : text));
  return { message, action };
}

const sentence = ({ message, action }) => `${message} ${action}`.trim();

// One line about a camera: what is found and what is to be done.
export const remarkOf = (finding) => said(sentence(finding), sentence(wordsOf(finding)));

export function findingItem(finding) {
  const where = [texts.translated.checks[finding.check] ?? finding.check, finding.subject].filter(Boolean).join(", ");
  const words = wordsOf(finding);
  const title = make("strong", { textContent: `${texts.cameras.levels[finding.level]}: ${where}` });
  const lines = words.action
    ? [make("p", { textContent: words.message }), make("p", { className: "remedy" }, ...said(sentence(finding), words.action))]
    : [make("p", {}, ...said(finding.message, words.message)), make("p", { className: "remedy" }, ...said(finding.action))];
  return make("li", { className: finding.level }, title, ...lines);
}
