// The last boards and the counts of the day: read once, then kept up to date by events.
import * as rest from "../parts/rest.js";

export const SHOWN = 20;
const READ_AGAIN_MS = 5 * 60 * 1000; // another day may have begun, events may have been lost
const OPEN_MS = 30 * 60 * 1000; // so long a board without pictures is shown; see parts/orders.js

export class RecentBoards {
  runs = []; // oldest first: the last ones, and older ones without pictures
  missed = []; // times at which boards passed without pictures
  counts = null;
  #readAt = -Infinity;
  #newestEvent = 0;

  readAgain() {
    this.#readAt = -Infinity;
  }

  // Read what is new.
  async refresh(now, now_ms) {
    if (performance.now() - this.#readAt > READ_AGAIN_MS) {
      this.#readAt = performance.now();
      const since = new Date(now_ms - OPEN_MS).toISOString();
      const pages = await Promise.all([{}, { verdict: "failed", since }, { verdict: "none", since }].map((filter) => rest.runs({ limit: SHOWN, ...filter })));
      this.counts = await rest.counts();
      this.runs = [];
      this.#add(pages.flatMap((page) => page.runs));
    } else if (now.last_run !== this.#lastFinished()) {
      const known = new Set(this.runs.map((run) => run.id));
      const found = (await rest.runs({ limit: 3 })).runs.filter((run) => run.finished && !known.has(run.id));
      if (found.length === 3 || !found.length) {
        this.readAgain(); // more boards came than were asked for
        await this.refresh(now, now_ms);
        return;
      }
      for (const run of found) this.#count(run.verdict ?? "failed");
      this.#add(found);
    }
  }

  #add(runs) {
    const all = new Map([...this.runs, ...runs.filter((run) => run.finished)].map((run) => [run.id, run]));
    const sorted = [...all.values()].sort((a, b) => (a.id < b.id ? -1 : 1)); // ids are in the order of the boards
    const old = sorted.slice(0, -SHOWN).filter((run) => run.verdict !== "ok" && run.verdict !== "degraded");
    this.runs = [...old.slice(-SHOWN), ...sorted.slice(-SHOWN)];
  }

  #lastFinished() {
    return this.runs.reduce((last, run) => (!last || run.finished > last.finished ? run : last), null)?.id ?? null;
  }

  #count(verdict) {
    if (this.counts) this.counts = { ...this.counts, [verdict]: this.counts[verdict] + 1 };
  }

  onEvent(event) {
    if (event.number <= this.#newestEvent) return;
    this.#newestEvent = event.number;
    if (event.kind === "board-missed") this.missed = [...this.missed, event.time].slice(-SHOWN);
    if (event.kind === "board-missed" || event.kind === "decision") this.readAgain();
  }

  // Runs and missed boards in the order of their times, oldest first.
  get strip() {
    const runs = this.runs.slice(-SHOWN).map((run) => ({ time: run.started, run }));
    const missed = this.missed.map((time) => ({ time, run: null }));
    return [...runs, ...missed].sort((a, b) => Date.parse(a.time) - Date.parse(b.time)).slice(-SHOWN);
  }
}
