// One key of station.toml as a field: how its value is shown, and how what is entered is read.
import { make, markWrong } from "../../parts/elements.js";
import { language, texts } from "../../texts/texts.js";
import { choice, input, labelled, Wrong } from "../fields.js";

const shown = (value) => (value == null ? "" : typeof value === "object" ? JSON.stringify(value) : String(value));

// `key` is the place of the value (`cameras.0.width`), `setting` what the station says about it, `onChange(value)` gets null for an empty field.
export function settingField(key, setting, value, onChange) {
  const t = texts.settings;
  const byDefault = setting.required ? t.required : t.byDefault(setting.default);
  const options = setting.kind === "truth" ? { true: texts.setup.yes, false: texts.setup.no } : Object.fromEntries(setting.choices.map((name) => [name, name]));
  const control = ["choice", "truth"].includes(setting.kind)
    ? choice(key, { "": byDefault, ...options }, shown(value))
    : input(key, shown(value), { placeholder: byDefault, inputMode: ["number", "integer"].includes(setting.kind) ? "decimal" : "text" });
  // A value that is no choice stays visible, with the fault that it is.
  if (control.value !== shown(value) && control.matches("select")) control.append(make("option", { value: shown(value), textContent: shown(value), selected: true }));
  const name = key.split(".").at(-1);
  const form = setting.kind === "list" ? t.asList : setting.kind === "map" ? t.asMap : "";
  const meant = t.meanings?.[setting.key];
  const meaning = make("span", { lang: meant ? language : "en", textContent: meant ?? setting.description });
  control.id = `setting-${key.replaceAll(/[^A-Za-z0-9_.-]/g, "_")}`;
  const field = labelled(name, control, { unit: setting.unit ?? "", help: [meaning, ...[t.limits(setting), form].filter(Boolean).map((text) => ` – ${text}`)] });
  const fault = make("p", { className: "fault", lang: "en", id: `${control.id}-fault`, hidden: true });
  control.setAttribute("aria-describedby", `${control.id}-help ${fault.id}`);
  field.append(fault);
  control.addEventListener("change", () => onChange(() => read(setting, name, control.value.trim())));
  return { field, control, say: (messages) => {
    fault.textContent = messages.join(" ");
    fault.hidden = !messages.length;
    markWrong(control, messages.length);
  } };
}

// The value of JSON that was entered; null if the field is empty.
function read(setting, name, text) {
  if (text === "") return null;
  switch (setting.kind) {
    case "truth":
      return text === "true";
    case "choice":
      return /^\d+$/.test(text) ? Number(text) : text;
    case "number":
    case "integer": {
      const value = Number(text.replace(",", "."));
      if (!Number.isFinite(value)) throw new Wrong(texts.setup.notNumber(name, text));
      return value;
    }
    case "list":
    case "map":
      try {
        return JSON.parse(text);
      } catch {
        throw new Wrong(texts.settings.notJson(name, text));
      }
    default:
      return text;
  }
}
