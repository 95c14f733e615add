// The marks that a camera sees while the calibration board is being laid: one pulse after the other, with the settings of the station.
import { make, setText } from "../../parts/elements.js";
import { Pulses } from "../../parts/pulses.js";
import * as rest from "../../parts/rest.js";
import { svg } from "../../parts/svg.js";
import { texts } from "../../texts/texts.js";
import { answerLine, choice, labelled } from "../fields.js";
import * as requests from "../requests.js";

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

export class LiveMarks extends Pulses {
  #wanted;

  // `cameras`: names; `wanted()`: the layout that is searched, with the nominal values that were entered.
  constructor(cameras, wanted) {
    super();
    const t = texts.setup;
    this.words = { byTime: t.liveEnded };
    this.#wanted = wanted;
    this.choice = choice("live-camera", Object.fromEntries(cameras.map((name, n) => [n, name])), "0");
    this.choice.addEventListener("change", () => {
      this.camera = Number(this.choice.value);
      if (this.running) this.begin();
    });
    this.press = make("button", { type: "button", id: "watch-marks", textContent: t.watchMarks });
    this.press.addEventListener("click", () => (this.running ? this.stop() : this.begin()));
    this.answer = answerLine();
    this.count = make("strong");
    this.marked = make("div", { className: "marked" });
    this.figure = make("figure", { hidden: true }, this.marked, make("figcaption", {}, this.count));
    const orders = make("div", { className: "fields" }, labelled(t.liveCamera, this.choice), make("div", { className: "buttons" }, this.press));
    this.root = make("div", { className: "live-marks" }, make("p", { className: "help", textContent: t.liveHelp }), orders, this.answer, this.figure);
  }

  began() {
    setText(this.press, texts.setup.stopMarks);
    setText(this.answer, "");
  }

  ended() {
    setText(this.press, texts.setup.watchMarks);
    this.figure.hidden = true;
  }

  // A pulse, the search of its frame, its picture.
  async look(isLatest) {
    const { camera } = this;
    const frame = await rest.tryCamera(camera, {});
    const image = make("img", { src: rest.trialPicture(frame), alt: texts.setup.liveAlt });
    const marks = await requests.findMarks({ ...(await this.#wanted()), camera, trial: frame.number });
    await image.decode().catch(() => {});
    if (!isLatest()) return;
    setText(this.answer, "");
    this.figure.hidden = false;
    showCount(this.count, marks);
    this.marked.replaceChildren(image, svgOfMarks(marks));
  }
}
