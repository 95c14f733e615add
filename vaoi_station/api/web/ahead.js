// Asks at once for the files that the page will need by its language and address: otherwise each is found when the one that names it has
// come, one round of requests after the other. It is no fault if one does not come: it is asked for again where it is needed.
import { language } from "./texts/language.js";

const TEXTS = {
  en: [
    "texts/board_en.js", "texts/cameras_en.js", "texts/en.js", "texts/lights_en.js", "texts/setup/optics_en.js",
    "texts/setup/settings_en.js", "texts/setup_en.js", "texts/station/reasons_en.js", "texts/trends_en.js",
  ],
  de: [
    "texts/board_de.js", "texts/cameras_de.js", "texts/de.js", "texts/lights_de.js", "texts/setup/optics_de.js",
    "texts/setup/settings_de.js", "texts/setup_de.js", "texts/station/findings_de.js", "texts/station/notes_de.js",
    "texts/station/program_de.js", "texts/station/reasons_de.js", "texts/station/remarks_de.js", "texts/station/warnings_de.js",
    "texts/translated_de.js", "texts/trends_de.js",
  ],
};
const BOARD = [
  "board/board.js", "board/colours.js", "board/comparison.js", "board/deep_zoom.js", "board/drawings.js", "board/exports.js",
  "board/page_state.js", "board/pictures.js", "board/report.js", "board/timing.js", "board/zoom.js", "parts/csv.js", "parts/identity.js",
  "parts/svg.js", "vendor/openseadragon/openseadragon.min.js",
];

// A link for each file of a list that was not asked for before.
function ask(files) {
  const links = files.splice(0).map((file) => {
    const kind = file.startsWith("vendor/") ? { rel: "preload", as: "script" } : { rel: "modulepreload" };
    return Object.assign(document.createElement("link"), { href: `/web/${file}`, ...kind });
  });
  document.head.append(...links);
}

// Ask for the files of the view that is addressed, if it has many.
export function askAhead() {
  if (location.hash.startsWith("#/board/")) ask(BOARD);
}

ask(TEXTS[language]);
askAhead();
