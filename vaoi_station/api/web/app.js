// The frame of all pages: which view is shown, the station's state, and whether it is out of date.
import { askAhead } from "./ahead.js";
import { LineView } from "./line/line.js";
import { RecentBoards } from "./line/recent_boards.js";
import { $, make, setText } from "./parts/elements.js";
import { Live } from "./parts/live.js";
import { loggedIn } from "./parts/login.js";
import { situation } from "./parts/orders.js";
import * as rest from "./parts/rest.js";
import * as sound from "./parts/sound.js";
import { changeLanguage, fillIn, language, texts } from "./texts/texts.js";

const EARLIER_EVENTS = 200; // so that boards that were missed before the page was opened are shown

document.documentElement.lang = language;
$("language").addEventListener("click", changeLanguage);
$("sound").addEventListener("click", () => {
  sound.switchTo(!sound.isOn());
  showSound();
});

function showSound() {
  setText($("sound"), sound.isOn() ? texts.soundOn : texts.soundOff);
  $("sound").setAttribute("aria-pressed", sound.isOn());
}

// What every view may use: the newest state, what it means, the station's clock, and whether all are out of date.
export const station = {
  now: null,
  situation: null,
  stale: false,
  offset_ms: 0,
  time_ms: () => Date.now() + station.offset_ms,
  boards: new RecentBoards(),
};

// The entries of the navigation: the text of each, and its first address.
const ENTRIES = [
  ["line", "#/"],
  ["boards", "#/boards"],
  ["trends.entry", "#/trends"],
  ["cameras.entry", "#/cameras"],
  ["setUp", "#/setup"],
];
// The views: the entry each belongs to, the form of its address, and how it is opened. The first is shown for other addresses.
// It is there at once; the others are loaded when they are opened.
const VIEWS = [
  ["line", /^#?\/?$/, () => new LineView(station, refresh)],
  ["boards", /^#\/boards(?:\?(.*))?$/, async (query) => new (await import("./boards/boards.js")).BoardsView(station, query ?? "")],
  ["boards", /^#\/board\/([^/?]+)(?:\?(.*))?$/, async (run, query) => new (await import("./board/board.js")).BoardView(station, run, query ?? "")],
  ["boards", /^#\/sides\/([^/?]+)$/, async (board) => new (await import("./board/sides.js")).SidesView(station, board)],
  ["trends.entry", /^#\/trends(?:\?(.*))?$/, async (query) => new (await import("./trends/trends.js")).TrendsView(station, query ?? "")],
  ["cameras.entry", /^#\/cameras$/, async () => new (await import("./cameras/cameras.js")).CamerasView(station)],
  ["setUp", /^#\/setup(?:\/(.*))?$/, async (path) => new (await import("./setup/setup.js")).SetupView(path ?? "")],
];
const links = ENTRIES.map(([name, href]) => {
  const link = make("a", { href });
  link.dataset.text = name;
  return link;
});
document.querySelector("nav").prepend(...links);
fillIn(document);
let view = null;
let routed = 0;
let unloaded = false; // the view of the address could not be loaded
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
    if (unloaded) rest.unattended(route());
    if (heartbeat.state !== station.now?.state || heartbeat.last_event !== station.now?.last_event) refresh();
  },
  onAge: showAge,
});

async function route() {
  const turn = ++routed;
  const [entry, pattern, open] = VIEWS.find(([, form]) => form.test(location.hash)) ?? VIEWS[0];
  askAhead();
  const loading = open(...(pattern.exec(location.hash) ?? []).slice(1));
  // Closed before the next one has come: what it still does must not reach the address of that one.
  view?.close?.();
  view = null;
  // Nor must a verdict stay in sight that nothing renews any more.
  if (!unloaded) $("view").replaceChildren(make("p", { className: "view-loading", textContent: texts.loading }));
  let made;
  try {
    made = await loading;
  } catch (error) {
    if (turn === routed) showUnloaded();
    throw error;
  }
  if (turn !== routed) return; // overtaken by a later address
  view = made;
  unloaded = false;
  for (const link of links) link.ariaCurrent = link.dataset.text === entry ? "page" : null;
  document.body.className = document.body.classList.contains("waiting") ? "waiting" : "";
  document.body.classList.toggle("stale", station.stale);
  $("view").replaceChildren(view.root);
  $("view").className = view.name;
  view.open?.();
  view.onAge?.(station.stale);
  showSituation();
  if (station.now) rest.unattended(showNow(view));
}

async function showNow(shown) {
  await shown.show?.(station.now);
  await shown.showBoards?.();
}

// Title and tone are those of the station in every view: the operator may have left the line's.
function showSituation() {
  const shown = situation(station.now, station.boards, station.time_ms(), station.stale);
  station.situation = shown;
  document.title = station.now ? `${shown.word} – ${station.now.name}` : shown.word;
  for (const tone of ["caution", "fault"]) document.body.classList.toggle(tone, shown.tone === tone);
  sound.announce(shown);
  view?.onSituation?.(shown);
}

// Said in place of a view whose files have not come. It is tried again by each heartbeat; the button loads the whole page.
function showUnloaded() {
  if (unloaded) return;
  unloaded = true;
  const again = make("button", { type: "button", textContent: texts.loadAgain, onclick: () => location.reload() });
  $("view").className = "";
  $("view").replaceChildren(make("p", { role: "alert", textContent: texts.unloaded }), again);
}

// One request at a time, and one more if an event came meanwhile.
async function refresh() {
  await renew(rest.station);
}

// Show the state that `ask` returns, and if an event came meanwhile the one after it.
async function renew(ask) {
  if (asking) {
    again = true;
    return;
  }
  asking = true;
  try {
    do {
      again = false;
      station.now = await ask();
      ask = rest.station;
      setText($("name"), station.now.name);
      document.body.classList.remove("waiting");
      showSituation();
      const shown = rest.unattended(Promise.resolve(view?.show?.(station.now)));
      await rest.unattended(station.boards.refresh(station.now, station.time_ms()));
      showSituation();
      await shown;
      await view?.showBoards?.();
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
  showSituation(); // a failed board is shown for a limited time
  view?.tick?.();
}

async function start() {
  showSound();
  await loggedIn(live);
  window.addEventListener("hashchange", () => rest.unattended(route()));
  const state = rest.station();
  state.then(
    (now) => live.open(Math.max(now.last_event - EARLIER_EVENTS, 0)),
    () => live.open(0), // the stream reconnects after any failure, and the page then requests the state again
  );
  await rest.unattended(route());
  await renew(() => state);
}

start();
