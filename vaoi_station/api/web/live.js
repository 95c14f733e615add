// The event stream and its heartbeat; says when nothing has come for too long.
import { eventsAddress } from "./rest.js";

const STALE_MS = 5000;
const CHECK_MS = 500;

export class Live {
  #source = null;
  #heardAt = performance.now();
  #newest = 0;

  // onNews(record or null): something happened, null after a reconnect; onBeat(heartbeat); onAge(stale, seconds)
  constructor({ onNews, onBeat, onAge }) {
    Object.assign(this, { onNews, onBeat, onAge });
    setInterval(() => this.#check(), CHECK_MS);
  }

  open(after) {
    this.#newest = Math.max(this.#newest, after);
    this.#source?.close();
    this.#source = new EventSource(eventsAddress(this.#newest));
    this.#source.onopen = () => this.onNews(null);
    this.#source.onmessage = (message) => {
      this.heard();
      this.#newest = Number(message.lastEventId);
      this.onNews(JSON.parse(message.data));
    };
    this.#source.addEventListener("heartbeat", (message) => {
      this.heard();
      this.onBeat(JSON.parse(message.data));
    });
  }

  heard() {
    this.#heardAt = performance.now();
  }

  #check() {
    const silent = performance.now() - this.#heardAt;
    this.onAge(silent > STALE_MS, Math.floor(silent / 1000));
    // a browser gives up after an answer that is no stream; ask again
    if (this.#source?.readyState === EventSource.CLOSED) this.open(this.#newest);
  }
}
