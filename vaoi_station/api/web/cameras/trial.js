// Settings of one camera on trial while the line is disarmed: pulses one after the other, a focus figure that is legible from the lens.
import { showFrame } from "../parts/camera_card.js";
import { make, setText } from "../parts/elements.js";
import { Pulses } from "../parts/pulses.js";
import * as rest from "../parts/rest.js";
import { number, texts } from "../texts/texts.js";

const IDLE = "idle";
const FIELDS = ["on_us", "exposure_us", "gain_db"];

export class Trial extends Pulses {
  #best = 0;

  // `cameras`: those of the station, with their names.
  constructor(cameras) {
    super();
    const words = texts.cameras.trial;
    this.words = { byArming: words.endedByArming, byTime: words.endedByTime };
    this.title = make("summary", { textContent: words.title, id: "trial-title" });
    this.choice = make("select", { id: "trial-camera" }, ...cameras.map((camera) => make("option", { value: camera.camera, textContent: camera.name })));
    this.choice.addEventListener("change", () => {
      this.camera = Number(this.choice.value);
      if (this.running) this.begin();
    });
    this.start = make("button", { type: "button", id: "trial-start", textContent: words.start });
    this.start.addEventListener("click", () => (this.running ? this.stop() : this.begin()));
    this.fields = { light: make("input", { id: "trial-light", autocomplete: "off", maxLength: 100 }) };
    for (const key of FIELDS) this.fields[key] = make("input", { id: `trial-${key}`, inputMode: "decimal", autocomplete: "off" });
    for (const field of Object.values(this.fields)) field.addEventListener("input", () => (this.since = Date.now()));
    const labelled = (field, text) => make("div", { className: "trial-field" }, make("label", { htmlFor: field.id, textContent: text }), field);
    this.best = make("button", { type: "button", textContent: words.forgetBest });
    this.best.addEventListener("click", () => (this.#best = 0));
    this.copy = make("a", { className: "button", id: "trial-copy", textContent: words.copy, hidden: true });
    this.answer = make("p", { id: "trial-answer", role: "status" });
    this.focus = make("p", { id: "trial-focus" });
    this.blur = make("p", { id: "trial-blur" });
    this.picture = make("div", { className: "camera-picture" });
    this.levels = make("div", { className: "camera-levels" });
    const form = make("div", { className: "trial-form" }, labelled(this.choice, words.camera), ...["light", ...FIELDS].map((key) => labelled(this.fields[key], words.fields[key])));
    this.live = make("div", { className: "trial-live", hidden: true }, make("div", { className: "trial-figures" }, this.focus, this.blur, this.levels), this.picture);
    const folded = make("details", {}, this.title, make("div", { className: "trial-body" }, make("p", { textContent: words.help }), form,
      make("div", { className: "trial-orders" }, this.start, this.best, this.copy), this.answer, this.live));
    folded.addEventListener("toggle", () => folded.open || this.stop());
    this.root = make("section", { id: "trial" }, folded);
    this.root.setAttribute("aria-labelledby", "trial-title");
  }

  // The section is there while the line is disarmed; arming ends the trial.
  show(state) {
    const disarmed = state === IDLE;
    this.start.disabled = !disarmed;
    if (!disarmed && this.running) this.endByArming();
    // Why a trial has ended stays to be read.
    else if (!disarmed && this.answer.textContent !== texts.cameras.trial.endedByArming) setText(this.answer, texts.cameras.trial.onlyDisarmed);
    else if (!this.running && this.answer.textContent === texts.cameras.trial.onlyDisarmed) setText(this.answer, "");
  }

  began() {
    this.#best = 0;
    setText(this.start, texts.cameras.trial.stop);
    this.live.hidden = false;
  }

  ended() {
    setText(this.start, texts.cameras.trial.start);
    this.live.hidden = true;
  }

  #settings() {
    const settings = {};
    if (this.fields.light.value.trim()) settings.light = this.fields.light.value.trim();
    for (const key of FIELDS) {
      const value = Number(this.fields[key].value.trim().replace(",", "."));
      if (this.fields[key].value.trim() && Number.isFinite(value)) settings[key] = value;
    }
    return settings;
  }

  // Each pulse has what the fields say now.
  async look(isLatest) {
    const words = texts.cameras.trial;
    const frame = await rest.tryCamera(this.camera, this.#settings());
    if (!isLatest()) return;
    this.#best = Math.max(this.#best, frame.focus);
    setText(this.answer, words.taken(frame.light, frame.on_us === undefined ? "" : number(frame.on_us), number(frame.exposure_us), number(frame.gain_db, 1)));
    this.focus.replaceChildren(make("b", { textContent: number(this.#best ? (100 * frame.focus) / this.#best : 0) }), ` ${words.ofBest}`);
    await showFrame(this, frame, rest.trialPicture(frame), words.alt);
    this.copy.href = `#/setup/programs?${new URLSearchParams(this.#step(frame))}`;
    this.copy.hidden = false;
  }

  // The settings as a row of a light program: a list for all cameras, of which the others keep their values.
  #step(frame) {
    const step = { light: frame.light, camera: frame.camera, exposure_us: frame.exposure_us, gain_db: frame.gain_db };
    return frame.on_us === undefined ? step : { ...step, on_us: frame.on_us };
  }
}
