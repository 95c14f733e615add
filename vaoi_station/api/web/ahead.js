// Asks at once for what the page will need by its language and address: otherwise each file is found when the one that names it has
// come, and data when the module that shows them has, one round of requests after the other. It is no fault if a file does not come: it is
// asked for again where it is needed.
import * as rest from "./parts/rest.js";
import { language } from "./texts/language.js";

const BOARD = [
  "board/board.js", "board/colours.js", "board/comparison.js", "board/deep_zoom.js", "board/drawings.js", "board/exports.js", "board/first_reason.js",
  "board/measures.js", "board/neighbour.js", "board/page_state.js", "board/pictures.js", "board/raw_frames.js", "board/report.js", "board/side_links.js", "board/timing.js", "board/zoom.js", "parts/files.js", "parts/identity.js",
  "vendor/openseadragon/openseadragon.min.js",
];

// A link for each file of a list that was not asked for before.
function ask(files) {
  const links = files.splice(0).map((file) => {
    const kind = file.startsWith("vendor/") ? { rel: "preload", as: "script" } : { rel: "modulepreload" };
    return Object.assign(document.createElement("link"), { href: new URL(file, import.meta.url).href, ...kind });
  });
  document.head.append(...links);
}

// Ask for the files of the view that is addressed, if it has many.
export function askAhead() {
  if (location.hash.startsWith("#/board/")) ask(BOARD);
}

// The login of this page.
export const session = rest.session();

// Ask for the run of the board that is addressed and for its mosaics, as soon as the caller may read.
async function askForBoard() {
  const addressed = /^#\/board\/([^/?]+)/.exec(location.hash);
  const may = await session.then(({ scopes }) => scopes.includes("read"), () => true); // a station without keys has no login
  if (!addressed || !may) return null;
  const id = boardId(addressed[1]);
  return { id, ...askBoard(id) };
}

export const boardId = (stated) => stated.replaceAll("%20", " ");

export function askBoard(id) {
  const [run, list] = [rest.run(id), rest.mosaicList(id)];
  // Who awaits them learns of a failure; perhaps another view is opened before.
  for (const asked of [run, list]) asked.catch(() => {});
  return { run, list };
}

let first = askForBoard();
ask([`texts/${language}.js`]);
askAhead();

// The run of a board and the list of its mosaics, both asked for: with the page, if it began with this board, else now.
export async function boardAsked(id) {
  const asked = await first;
  first = null; // later it would be out of date
  return asked?.id === id ? asked : askBoard(id);
}
