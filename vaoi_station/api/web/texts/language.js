// The language of this browser. The choice is kept; the page is loaded anew when it changes.
import { kept, keep } from "../parts/settings.js";

const LANGUAGES = ["en", "de"];
const wanted = kept("language", navigator.language.slice(0, 2));
export const language = LANGUAGES.includes(wanted) ? wanted : "en";
export const otherLanguage = language === "en" ? "de" : "en";

export function changeLanguage() {
  keep("language", otherLanguage);
  location.reload();
}
