// The event stream and its heartbeat; reports when no message has come for too long.
import { eventsAddress } from "./rest.js";

const STALE_MS = 5000;
const CHECK_MS = 500;

export class Live {
  #source = null;
  #receivedAt = performance.now();
  #newest = 0;
  #paused = false;

  // onEvent(record, or null after a reconnect), onHeartbeat(heartbeat), onAge(stale, seconds)
  constructor({ onEvent, onHeartbeat, onAge }) {
    Object.assign(this, { onEvent, onHeartbeat, onAge });
    setInterval(() => this.#check(), CHECK_MS);
  }

  open(after) {
    this.#newest = Math.max(this.#newest, after);
    this.#source?.close();
    this.#source = new EventSource(eventsAddress(this.#newest));
    this.#source.onopen = () => this.onEvent(null);
    this.#source.onmessage = (message) => {
      this.noteMessage();
      this.#newest = Number(message.lastEventId);
      this.onEvent(JSON.parse(message.data));
    };
    this.#source.addEventListener("heartbeat", (message) => {
      this.noteMessage();
      this.onHeartbeat(JSON.parse(message.data));
    });
  }

  // While a person logs in, no message is expected.
  pause() {
    this.#paused = true;
  }

  resume() {
    this.#paused = false;
    this.noteMessage();
  }

  noteMessage() {
    this.#receivedAt = performance.now();
  }

  #check() {
    if (this.#paused) return;
    const silent = performance.now() - this.#receivedAt;
    this.onAge(silent > STALE_MS, Math.floor(silent / 1000));
    // A browser does not reconnect after a reply that is not an event stream.
    if (this.#source?.readyState === EventSource.CLOSED) {
      this.open(this.#newest);
      this.onEvent(null); // the page asks for the state, and learns whether it must log in again
    }
  }
}
