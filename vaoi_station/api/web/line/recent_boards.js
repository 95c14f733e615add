// The last boards and the counts of the day: read once, then kept up to date by events.
import * as rest from "../parts/rest.js";

const SHOWN = 20;
const READ_AGAIN_MS = 5 * 60 * 1000; // another day may have begun, events may have been lost
const OPEN_MS = 30 * 60 * 1000; // so long a board without pictures is shown; see parts/orders.js
const MOST_PAGES = 5; // pages of runs that are looked through for those of this line, among imported ones

// Imported runs are of another line: they need no decision here.
const isOwn = (run) => !run.origin;

async function ownRuns(filter) {
  const found = [];
  let before = null;
  for (let n = 0; n < MOST_PAGES && found.length < SHOWN && (n === 0 || before); n++) {
    const page = await rest.runs({ limit: SHOWN, ...filter, ...(before ? { before } : {}) });
    found.push(...page.runs.filter(isOwn));
    before = page.next;
  }
  return found;
}

export class RecentBoards {
  runs = []; // oldest first: the last ones, and older ones without pictures
  missed = []; // times at which boards passed without pictures
  counts = null;
  #readAt = -Infinity;
  #lastRun = null; // the station's `last_run` when the runs were read
  #changed = false; // the verdict of a run that was read may have changed
  #newestEvent = 0;

  readAgain() {
    this.#readAt = -Infinity;
  }

  // Read what is new.
  async refresh(now, now_ms) {
    const last = now.last_run ?? null;
    if (performance.now() - this.#readAt > READ_AGAIN_MS) await this.#readAll(now_ms);
    else if (this.#changed || last !== this.#lastRun) await this.#readLast(last, now_ms);
    this.#lastRun = last;
  }

  async #readAll(now_ms) {
    this.#readAt = performance.now(); // before the replies: what happens meanwhile asks for another reading
    try {
      const since = new Date(now_ms - OPEN_MS).toISOString();
      const found = await Promise.all([{}, { verdict: "failed", since }, { verdict: "none", since }].map(ownRuns));
      this.counts = await rest.counts();
      this.runs = [];
      this.#add(found.flat());
    } catch (error) {
      this.readAgain();
      throw error;
    }
  }

  // The last boards: one has finished, or its verdict may have changed.
  async #readLast(last, now_ms) {
    this.#changed = false;
    this.#add((await rest.runs({ limit: SHOWN })).runs);
    if (last && !this.runs.some((run) => run.id === last)) {
      await this.#readAll(now_ms); // imported runs may stand before it
      return;
    }
    // Not counted here: a run that ended between the replies of an earlier reading may be in the counts already.
    this.counts = await rest.counts();
  }

  #add(runs) {
    const all = new Map([...this.runs, ...runs.filter((run) => run.finished && isOwn(run))].map((run) => [run.id, run]));
    const sorted = [...all.values()].sort((a, b) => (a.id < b.id ? -1 : 1)); // ids are in the order of the boards
    const old = sorted.slice(0, -SHOWN).filter((run) => run.verdict !== "ok" && run.verdict !== "degraded");
    this.runs = [...old.slice(-SHOWN), ...sorted.slice(-SHOWN)];
  }

  onEvent(event) {
    if (event.number <= this.#newestEvent) return;
    this.#newestEvent = event.number;
    if (event.kind === "board-missed") this.missed = [...this.missed, event.time].slice(-SHOWN);
    if (event.kind === "identity") this.#changed = true;
    if (event.kind === "board-missed" || event.kind === "decision") this.readAgain();
  }

  // Runs and missed boards in the order of their times, oldest first.
  get strip() {
    const runs = this.runs.slice(-SHOWN).map((run) => ({ time: run.started, run }));
    const missed = this.missed.map((time) => ({ time, run: null }));
    return [...runs, ...missed].sort((a, b) => Date.parse(a.time) - Date.parse(b.time)).slice(-SHOWN);
  }
}
