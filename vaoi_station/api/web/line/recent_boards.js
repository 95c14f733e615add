// The last boards and the counts of the day: read once, then kept up to date by events.
import * as rest from "../parts/rest.js";

export const SHOWN = 20;
const READ_AGAIN_MS = 5 * 60 * 1000; // the counts are read again: another day may have begun, events may have been lost

export class RecentBoards {
  runs = []; // oldest first
  missed = []; // times at which boards passed without pictures
  counts = null;
  #readAt = -Infinity;
  #newestEvent = 0;

  // Read what is new; true if anything changed.
  async refresh(now) {
    const due = performance.now() - this.#readAt > READ_AGAIN_MS;
    const newest = this.runs.at(-1);
    const pending = this.runs.filter((run) => !run.finished).map((run) => run.id);
    if (!due && now.last_run === this.#lastFinished() && !pending.length) return false;
    if (due || !newest) {
      this.runs = (await rest.runs({ limit: SHOWN })).runs.reverse().filter((run) => run.finished);
      this.counts = await rest.counts();
      this.#readAt = performance.now();
      return true;
    }
    const { runs } = await rest.runs({ limit: 3 });
    const known = new Set(this.runs.map((run) => run.id));
    const found = runs.reverse().filter((run) => run.finished && !known.has(run.id));
    if (found.length === 3 || !found.length) {
      this.#readAt = -Infinity; // more boards came than were asked for
      return this.refresh(now);
    }
    for (const run of found) this.#count(run.verdict ?? "failed");
    this.runs = [...this.runs, ...found].slice(-SHOWN);
    return true;
  }

  #lastFinished() {
    return [...this.runs].sort((a, b) => (a.finished < b.finished ? -1 : 1)).at(-1)?.id ?? null;
  }

  #count(verdict) {
    if (this.counts) this.counts = { ...this.counts, [verdict]: this.counts[verdict] + 1 };
  }

  // True if the event concerns the strip.
  onEvent(event) {
    if (event.number <= this.#newestEvent) return false;
    this.#newestEvent = event.number;
    if (event.kind === "board-missed") {
      this.missed = [...this.missed, event.time].slice(-SHOWN);
      if (this.counts && Date.parse(event.time) > Date.parse(this.counts.read ?? this.counts.since)) this.#readAt = -Infinity;
      return true;
    }
    if (event.kind === "decision") this.#readAt = -Infinity;
    return false;
  }

  // Runs and missed boards in the order of their times, oldest first.
  get strip() {
    const runs = this.runs.map((run) => ({ time: run.started, run }));
    const missed = this.missed.map((time) => ({ time, run: null }));
    return [...runs, ...missed].sort((a, b) => Date.parse(a.time) - Date.parse(b.time)).slice(-SHOWN);
  }
}
