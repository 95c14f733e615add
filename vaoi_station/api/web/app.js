// The frame of all pages: which view is shown, the station's state, and whether it is out of date.
import { BoardView } from "./boards/board.js";
import { BoardsView } from "./boards/boards.js";
import { LineView } from "./line/line.js";
import { RecentBoards } from "./line/recent_boards.js";
import { $, setText } from "./parts/elements.js";
import { Live } from "./parts/live.js";
import { loggedIn } from "./parts/login.js";
import * as rest from "./parts/rest.js";
import * as sound from "./parts/sound.js";
import { changeLanguage, fillIn, language, texts } from "./texts/texts.js";

const EARLIER_EVENTS = 200; // so that boards that were missed before the page was opened are shown

document.documentElement.lang = language;
fillIn(document);
$("language").addEventListener("click", changeLanguage);
$("sound").addEventListener("click", () => {
  sound.switchTo(!sound.isOn());
  showSound();
});

function showSound() {
  setText($("sound"), sound.isOn() ? texts.soundOn : texts.soundOff);
  $("sound").setAttribute("aria-pressed", sound.isOn());
}

// What every view may use: the newest state, the station's clock, and whether both are out of date.
export const station = {
  now: null,
  stale: false,
  offset_ms: 0,
  time_ms: () => Date.now() + station.offset_ms,
  boards: new RecentBoards(),
};

const VIEWS = [
  [/^#?\/?$/, () => new LineView(station, refresh)],
  [/^#\/boards(?:\?(.*))?$/, (query) => new BoardsView(station, query ?? "")],
  [/^#\/board\/([^/?]+)(?:\?(.*))?$/, (run, query) => new BoardView(station, run, query ?? "")],
];
let view = null;
let asking = false;
let again = false;

const live = new Live({
  onEvent: (record) => {
    if (record) {
      station.boards.onEvent(record);
      view?.onEvent?.(record);
    }
    refresh();
  },
  onHeartbeat: (heartbeat) => {
    station.offset_ms = Date.parse(heartbeat.time) - Date.now();
    if (heartbeat.state !== station.now?.state || heartbeat.last_event !== station.now?.last_event) refresh();
  },
  onAge: showAge,
});

function route() {
  view?.close?.();
  const [pattern, open] = VIEWS.find(([form]) => form.test(location.hash)) ?? VIEWS[0];
  view = open(...(pattern.exec(location.hash) ?? []).slice(1));
  for (const link of document.querySelectorAll("nav a[href^='#']")) {
    const here = link.getAttribute("href") === "#/" ? view instanceof LineView : !(view instanceof LineView);
    if (here) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  document.body.className = document.body.classList.contains("waiting") ? "waiting" : "";
  document.body.classList.toggle("stale", station.stale);
  $("view").replaceChildren(view.root);
  $("view").className = view.name;
  fillIn(view.root);
  view.open?.();
  view.onAge?.(station.stale);
  if (station.now) rest.unattended(view.show(station.now));
}

// One request at a time, and one more if an event came meanwhile.
async function refresh() {
  if (asking) {
    again = true;
    return;
  }
  asking = true;
  try {
    do {
      again = false;
      station.now = await rest.station();
      setText($("name"), station.now.name);
      document.body.classList.remove("waiting");
      await view.show(station.now);
    } while (again);
  } catch (error) {
    if (!(error instanceof rest.Refusal) && !(error instanceof TypeError)) throw error;
    // The station is unreachable or refuses: the heartbeat stops too, and the page shows that its data are old.
  } finally {
    asking = false;
  }
}

function showAge(old, seconds) {
  const was = station.stale;
  station.stale = old;
  document.body.classList.toggle("stale", old);
  $("stale").hidden = !old;
  setText($("stale-age"), old ? texts.noData(seconds) : "");
  setText($("stale-text"), old ? texts.old : "");
  if (was && !old) refresh();
  if (was !== old) view?.onAge?.(old);
  view?.tick?.();
}

async function start() {
  showSound();
  await loggedIn(live);
  window.addEventListener("hashchange", route);
  route();
  try {
    station.now = await rest.station();
    live.open(Math.max(station.now.last_event - EARLIER_EVENTS, 0));
  } catch {
    live.open(0); // the stream reconnects after any failure, and the page then requests the state again
  }
  await refresh();
}

start();
