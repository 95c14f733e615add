// The operator's page: state, instruction, last board and its pictures, updated by events.
import * as rest from "./rest.js";
import { Board } from "./board.js";
import { Controls } from "./controls.js";
import { Live } from "./live.js";
import { loggedIn } from "./login.js";
import { draw } from "./marks.js";
import { texts } from "./texts.en.js";

const $ = (id) => document.getElementById(id);
const SOON_MS = 5000; // attempts that are due sooner are not shown
const TONES = { blocked: "caution", lacking: "caution", held: "caution", faulted: "fault" };
const OWN_ORDER = { blocked: 1, lacking: 1, held: 1, filming: 1 }; // whatever the reason, first of all hold the board or let it pass

for (const element of document.querySelectorAll("[data-text]")) element.textContent = texts[element.dataset.text];

const board = new Board();
const controls = new Controls(refresh);
let shown = null;
let asking = false;
let again = false;
let stale = false;
let asked = 0;

const live = new Live({
  onEvent: (record) => {
    if (record?.kind === "board-type") controls.reload();
    refresh();
  },
  onHeartbeat: (heartbeat) => {
    board.setClock(heartbeat.time);
    if (heartbeat.state !== shown?.state || heartbeat.last_event !== shown?.last_event) refresh();
  },
  onAge: showAge,
});

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
      const now = await rest.station();
      showStation(now);
      if (now.last_run) await board.show(now.last_run);
      else board.showNone();
    } while (again);
  } catch (error) {
    if (!(error instanceof rest.Refusal) && !(error instanceof TypeError)) throw error;
    // The station is unreachable or refuses: the heartbeat stops too, and the page shows that its data are old.
  } finally {
    asking = false;
  }
}

function showStation(now) {
  shown = now;
  const held = now.all_cameras_ready ? "held" : "lacking";
  const state = now.state === "armed" && !now.line_ready ? held : now.state;
  const known = state in texts.states ? state : "unknown";
  const [word, sentence] = texts.states[known];
  const [first] = now.reasons;
  document.title = `${word} – ${now.name}`;
  document.body.classList.remove("waiting", "caution", "fault");
  if (TONES[known]) document.body.classList.add(TONES[known]);
  draw($("state-shape"), known);
  setText($("state-word"), word);
  setText($("what-to-do"), (!(known in OWN_ORDER) && first?.action) || sentence);
  setText($("armed-with"), now.armed_with ? texts.armedWith(now.armed_with) : "");
  const causes = known === "held" ? now.line_held : now.reasons;
  const reasons = causes.map((r) => (known in OWN_ORDER ? `${r.message} ${r.action}` : r.message));
  showLines($("reasons"), [...reasons, ...nextTries(now)]);
  showLines($("warnings"), now.warnings.map((w) => `${w.message} ${w.action}`));
  $("warnings").hidden = now.warnings.length === 0;
  controls.showSetAside(now.set_aside ?? []);
  setText($("name"), now.name);
  setText($("version"), `VAOI station ${now.versions.station}`);
  controls.show(now);
}

// Pending retries. No event may come before a retry, so the page requests the state again after it.
function nextTries(now) {
  const cameras = now.cameras.map((c) => ({ name: texts.camera(c.name), next_try: c.next_try }));
  const far = [...now.processes, ...cameras].filter((p) => p.next_try && board.until(p.next_try) > SOON_MS);
  clearTimeout(asked);
  if (far.length) asked = setTimeout(refresh, Math.min(...far.map((p) => board.until(p.next_try))) + SOON_MS);
  return far.map((p) => texts.nextTry(p.name, new Date(p.next_try).toLocaleTimeString()));
}

function showLines(list, lines) {
  if (lines.join("\n") === list.dataset.shown) return;
  list.dataset.shown = lines.join("\n");
  list.replaceChildren(...lines.map((line) => Object.assign(document.createElement("li"), { textContent: line })));
}

function showAge(old, seconds) {
  const banner = $("stale");
  document.body.classList.toggle("stale", old);
  banner.hidden = !old;
  if (old) {
    setText($("stale-age"), texts.noData(seconds));
    setText($("stale-text"), shown ? texts.old : texts.connecting);
    if (!stale) draw($("state-shape"), "unknown");
    setText($("state-word"), texts.states.unknown[0]);
    setText($("what-to-do"), "");
  } else {
    setText($("stale-text"), "");
  }
  if (stale && !old) refresh();
  stale = old;
  controls.enable(!old);
  board.tick();
}

// Screen readers announce a live region whenever its text is set, so it is set only when it changes.
function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

async function start() {
  await loggedIn(live);
  try {
    const now = await rest.station();
    showStation(now);
    live.open(now.last_event);
  } catch {
    live.open(0); // the stream reconnects after any failure, and the page then requests the state again
  }
  await controls.reload();
  await refresh();
}

start();
