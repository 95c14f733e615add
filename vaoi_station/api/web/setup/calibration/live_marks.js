// The marks that a camera sees while the calibration board is being laid: one pulse after the other, with the settings of the station.
import { make, saidOf, setText } from "../../parts/elements.js";
import * as rest from "../../parts/rest.js";
import { svg } from "../../parts/svg.js";
import { texts } from "../../texts/texts.js";
import { choice, labelled } from "../fields.js";
import * as requests from "../requests.js";

const REST_MS = 250; // between two pulses
const AGAIN_MS = 1500; // after a refusal that may pass
const LONGEST_MS = 10 * 60_000; // a page that was left open must not flash for ever
const PASSING = ["trial-running", "busy", "ring-full", "no-trial-frame"]; // refusals after which the next pulse may succeed

// Rings over a frame, where it shows marks.
export function svgOfMarks({ width, height, found }) {
  const picture = svg("svg", { class: "found-marks", viewBox: `0 0 ${width} ${height}`, "aria-hidden": "true" });
  picture.append(...found.map(([cx, cy]) => svg("circle", { cx: cx + 0.5, cy: cy + 0.5, r: Math.min(width, height) / 30 })));
  return picture;
}

// How many marks are found, and whether these are few.
export function showCount(element, { found, expected }) {
  setText(element, texts.setup.marksFound(found.length, expected));
  element.className = found.length < expected ? "few" : "";
}

export class LiveMarks {
  #wanted;
  #turn = 0; // counts what ends a series of pulses
  #timer = 0;
  #since = 0;
  #running = false;

  // `cameras`: names; `wanted()`: the layout that is searched, with the nominal values that were entered.
  constructor(cameras, wanted) {
    const t = texts.setup;
    this.#wanted = wanted;
    this.choice = choice("live-camera", Object.fromEntries(cameras.map((name, n) => [n, name])), "0");
    this.choice.addEventListener("change", () => this.#running && this.begin());
    this.press = make("button", { type: "button", id: "watch-marks", textContent: t.watchMarks });
    this.press.addEventListener("click", () => (this.#running ? this.stop() : this.begin()));
    this.answer = make("p", { className: "answer" });
    this.answer.setAttribute("role", "status");
    this.count = make("strong");
    this.marked = make("div", { className: "marked" });
    this.figure = make("figure", { hidden: true }, this.marked, make("figcaption", {}, this.count));
    const orders = make("div", { className: "fields" }, labelled(t.liveCamera, this.choice), make("div", { className: "buttons" }, this.press));
    this.root = make("div", { className: "live-marks" }, make("p", { className: "help", textContent: t.liveHelp }), orders, this.answer, this.figure);
  }

  begin() {
    this.#running = true;
    this.#since = Date.now();
    clearTimeout(this.#timer);
    setText(this.press, texts.setup.stopMarks);
    setText(this.answer, "");
    rest.unattended(this.#follow(++this.#turn, Number(this.choice.value)));
  }

  // What the person ends, or the page that is left: the station sets its own exposures again at once.
  stop() {
    if (!this.#running) return;
    this.#end();
    rest.unattended(rest.endTrial(Number(this.choice.value)));
  }

  #end(...words) {
    this.#running = false;
    this.#turn += 1;
    clearTimeout(this.#timer);
    setText(this.press, texts.setup.watchMarks);
    this.answer.replaceChildren(...words);
    this.figure.hidden = true;
  }

  // One request at a time: a pulse, the search of its frame, its picture.
  async #follow(turn, camera) {
    if (Date.now() - this.#since > LONGEST_MS) {
      this.stop();
      setText(this.answer, texts.setup.liveEnded);
      return;
    }
    let pause = REST_MS;
    try {
      if (!document.hidden) await this.#look(turn, camera);
    } catch (error) {
      if (!(error instanceof rest.Refusal) && !(error instanceof TypeError)) throw error;
      if (turn !== this.#turn) return;
      if (error.code === "line-armed") {
        this.#end(...saidOf(error));
        return;
      }
      // What is entered can be corrected meanwhile; the next pulse is searched for it.
      if (!PASSING.includes(error.code)) this.answer.replaceChildren(...saidOf(error));
      pause = AGAIN_MS;
    }
    if (turn === this.#turn) this.#timer = setTimeout(() => rest.unattended(this.#follow(turn, camera)), pause);
  }

  async #look(turn, camera) {
    const frame = await rest.tryCamera(camera, {});
    const image = make("img", { src: rest.trialPicture(frame), alt: texts.setup.liveAlt });
    const marks = await requests.findMarks({ ...(await this.#wanted()), camera, trial: frame.number });
    await image.decode().catch(() => {});
    if (turn !== this.#turn) return;
    setText(this.answer, "");
    this.figure.hidden = false;
    showCount(this.count, marks);
    this.marked.replaceChildren(image, svgOfMarks(marks));
  }
}
