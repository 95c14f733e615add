// Settings of one camera on trial while the line is disarmed: pulses one after the other, a focus figure that is legible from the lens.
import { histogram, sharpnessMap } from "../parts/camera_card.js";
import { make, saidOf, setText } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { number, texts } from "../texts/texts.js";

const REST_MS = 250; // between two pulses
const AGAIN_MS = 1500; // after a refusal that may pass
const LONGEST_MS = 10 * 60_000; // a page that was left open must not flash for ever
const IDLE = "idle";
const PASSING = ["trial-running", "busy", "ring-full"]; // refusals after which the next pulse may succeed
const FIELDS = ["on_us", "exposure_us", "gain_db"];

const px = (value) => number(value, 2);
const percent = (share, digits = 0) => `${number(100 * share, digits)} %`;

export class Trial {
  #camera = 0;
  #running = false;
  #best = 0;
  #since = 0;
  #turn = 0;
  #timer = 0;
  #newest = null;

  // `cameras`: those of the station, with their names.
  constructor(cameras) {
    const words = texts.cameras.trial;
    this.title = make("summary", { textContent: words.title, id: "trial-title" });
    this.choice = make("select", { id: "trial-camera" }, ...cameras.map((camera) => make("option", { value: camera.camera, textContent: camera.name })));
    this.choice.addEventListener("change", () => this.#choose(Number(this.choice.value)));
    this.start = make("button", { type: "button", id: "trial-start", textContent: words.start });
    this.start.addEventListener("click", () => (this.#running ? this.stop() : this.begin()));
    this.fields = { light: make("input", { id: "trial-light", autocomplete: "off", maxLength: 100 }) };
    for (const key of FIELDS) this.fields[key] = make("input", { id: `trial-${key}`, inputMode: "decimal", autocomplete: "off" });
    for (const field of Object.values(this.fields)) field.addEventListener("input", () => (this.#since = Date.now()));
    const labelled = (field, text) => make("div", { className: "trial-field" }, make("label", { htmlFor: field.id, textContent: text }), field);
    this.best = make("button", { type: "button", textContent: words.forgetBest });
    this.best.addEventListener("click", () => (this.#best = 0));
    this.copy = make("a", { className: "button", id: "trial-copy", textContent: words.copy, hidden: true });
    this.answer = make("p", { id: "trial-answer" });
    this.answer.setAttribute("role", "status");
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
    if (!disarmed && this.#running) this.#end(texts.cameras.trial.endedByArming);
    // Why a trial has ended stays to be read.
    else if (!disarmed && this.answer.textContent !== texts.cameras.trial.endedByArming) setText(this.answer, texts.cameras.trial.onlyDisarmed);
    else if (!this.#running && this.answer.textContent === texts.cameras.trial.onlyDisarmed) setText(this.answer, "");
  }

  begin() {
    this.#running = true;
    [this.#best, this.#since] = [0, Date.now()];
    setText(this.start, texts.cameras.trial.stop);
    this.live.hidden = false;
    rest.unattended(this.#follow(++this.#turn));
  }

  // What the person ends, or the page that is left: the station sets its own values again at once.
  stop() {
    if (!this.#running) return;
    this.#end("");
    rest.unattended(rest.endTrial(this.#camera));
  }

  #end(said) {
    this.#running = false;
    this.#turn += 1;
    clearTimeout(this.#timer);
    setText(this.start, texts.cameras.trial.start);
    setText(this.answer, said);
    this.live.hidden = true;
  }

  #choose(camera) {
    this.#camera = camera;
    [this.#best, this.#newest] = [0, null];
  }

  // One pulse after the other, each with what the fields say now.
  async #follow(turn) {
    if (turn !== this.#turn) return;
    let pause = REST_MS;
    if (Date.now() - this.#since > LONGEST_MS) {
      this.stop();
      setText(this.answer, texts.cameras.trial.endedByTime);
      return;
    }
    try {
      if (!document.hidden) {
        const frame = await rest.tryCamera(this.#camera, this.#settings());
        if (turn === this.#turn && frame.camera === this.#camera) await this.#show(frame);
      }
    } catch (error) {
      if (!(error instanceof rest.Refusal) && !(error instanceof TypeError)) throw error;
      if (turn !== this.#turn) return;
      if (error.code === "line-armed") {
        this.#end(texts.cameras.trial.endedByArming);
        return;
      }
      // A setting that is refused can be corrected in the form; the next pulse tries it.
      if (!PASSING.includes(error.code)) this.answer.replaceChildren(...saidOf(error));
      pause = AGAIN_MS;
    }
    if (turn === this.#turn) this.#timer = setTimeout(() => rest.unattended(this.#follow(turn)), pause);
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

  async #show(frame) {
    const words = texts.cameras;
    const image = make("img", { src: rest.trialPicture(frame), alt: words.trial.alt });
    await image.decode().catch(() => {});
    this.#newest = frame;
    this.#best = Math.max(this.#best, frame.focus);
    setText(this.answer, words.trial.taken(frame.light, frame.on_us === undefined ? "" : number(frame.on_us), number(frame.exposure_us), number(frame.gain_db, 1)));
    this.focus.replaceChildren(make("b", { textContent: number(this.#best ? (100 * frame.focus) / this.#best : 0) }), ` ${words.trial.ofBest}`);
    this.blur.replaceChildren(...(frame.blur_px == null ? [words.noEdges] : [make("b", { textContent: px(frame.blur_px) }), ` ${words.blur}`]));
    const label = words.histogram(percent(frame.low), percent(frame.high), percent(frame.saturated, 2));
    this.levels.replaceChildren(histogram(frame.histogram, frame.saturated, label), make("p", { textContent: label }));
    if (image.naturalWidth) {
      this.picture.style.aspectRatio = `${frame.width} / ${frame.height}`;
      this.picture.replaceChildren(image, ...sharpnessMap(frame.tiles, px));
    }
    this.copy.href = `#/setup/programs?${new URLSearchParams(this.#step(frame))}`;
    this.copy.hidden = false;
  }

  // The settings as a row of a light program: a list for all cameras, of which the others keep their values.
  #step(frame) {
    const step = { light: frame.light, camera: frame.camera, exposure_us: frame.exposure_us, gain_db: frame.gain_db };
    return frame.on_us === undefined ? step : { ...step, on_us: frame.on_us };
  }
}
