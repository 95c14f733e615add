// Pulses of one camera while the line is disarmed, one after the other, until a person ends them, the line is armed, or 10 minutes have passed.
import { saidOf } from "./elements.js";
import * as rest from "./rest.js";

const REST_MS = 250; // between two pulses
const AGAIN_MS = 1500; // after a refusal that may pass
const LONGEST_MS = 10 * 60_000; // a page that was left open must not flash for ever
const PASSING = ["trial-running", "busy", "ring-full", "no-trial-frame"]; // refusals after which the next pulse may succeed

// A class that extends it has `answer`, an element for words; `words`, texts `byTime` and, in place of the station's, `byArming`; and the methods
// `began`, `look(isLatest)`, which fires a pulse and shows what is seen, and `ended`.
export class Pulses {
  camera = 0;
  running = false;
  since = 0; // of the beginning, or of the last change
  #turn = 0; // counts what ends a series of pulses
  #timer = 0;

  begin() {
    clearTimeout(this.#timer);
    [this.running, this.since] = [true, Date.now()];
    this.began();
    rest.unattended(this.#follow(++this.#turn));
  }

  // What the person ends, or the page that is left: the station sets its own values again at once.
  stop(...said) {
    if (!this.running) return;
    this.#end(...said);
    rest.unattended(rest.endTrial(this.camera));
  }

  // The line was armed, which has ended the trial.
  endByArming(error) {
    this.#end(...(this.words.byArming ? [this.words.byArming] : saidOf(error)));
  }

  #end(...said) {
    this.running = false;
    this.#turn += 1;
    clearTimeout(this.#timer);
    this.ended();
    this.answer.replaceChildren(...said);
  }

  async #follow(turn) {
    if (Date.now() - this.since > LONGEST_MS) {
      this.stop(this.words.byTime);
      return;
    }
    let pause = REST_MS;
    try {
      if (!document.hidden) await this.look(() => turn === this.#turn);
    } catch (error) {
      if (!(error instanceof rest.Refusal) && !(error instanceof TypeError)) throw error;
      if (turn !== this.#turn) return;
      if (error.code === "line-armed") {
        this.endByArming(error);
        return;
      }
      // What is entered can be corrected meanwhile: the next pulse tries it.
      if (!PASSING.includes(error.code)) this.answer.replaceChildren(...saidOf(error));
      pause = AGAIN_MS;
    }
    if (turn === this.#turn) this.#timer = setTimeout(() => rest.unattended(this.#follow(turn)), pause);
  }
}
