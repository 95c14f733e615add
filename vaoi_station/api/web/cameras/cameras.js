// A card for each camera: its newest frame, sharpness, histogram, state of the device, drift, and what the doctor finds.
import { BLUR_LIMIT_PX, DARK_LIMIT, percent, px, SATURATED_LIMIT, showFrame } from "../parts/camera_card.js";
import { lines, make, said, saidOf, setText, View } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { Exchange } from "./exchange.js";
import { findingItem, remarkOf } from "./findings.js";
import { moment, number, texts } from "../texts/texts.js";
import { Trial } from "./trial.js";

const AGAIN_MS = 2000;
const LOST = /lost|missing|resent|resend|underrun|fail|error|discard|drop/i; // names of drivers' counters of trouble
const PART = `
<div id="camera-tools">
  <p id="camera-answer" role="status"></p>
  <button type="button" id="examine" data-text="cameras.examine"></button>
</div>
<div id="exchange-place"></div>
<div id="trial-place"></div>
<div id="camera-cards"></div>
<section id="doctor" aria-labelledby="doctor-title">
  <h2 id="doctor-title" data-text="cameras.doctor"></h2>
  <p id="doctor-answer" role="status" data-text="cameras.notExamined"></p>
  <ul id="doctor-findings"></ul>
</section>`;

function ptpWords({ state, synchronised, offset_ns, apart_us }) {
  const words = texts.cameras.ptp;
  return [
    synchronised ? state : words.noMaster(state),
    ...(offset_ns == null ? [] : [words.offset(number(offset_ns / 1000, 1))]),
    ...(apart_us ? [words.apart(number(apart_us / 1000, 1))] : []),
  ].join(", ");
}

class Card {
  #shown = "";

  constructor(camera) {
    this.index = camera.camera;
    this.title = make("h2", { textContent: camera.name });
    this.state = make("span", { className: "camera-state" });
    this.picture = make("div", { className: "camera-picture" });
    this.blur = make("p", { className: "camera-focus" });
    this.levels = make("div", { className: "camera-levels" });
    this.facts = make("dl", {});
    this.remarks = make("ul", { className: "camera-remarks" });
    this.root = make("section", { className: "camera-card" }, make("div", { className: "camera-head" }, this.title, this.state),
      this.picture, this.blur, this.levels, this.remarks, this.facts);
  }

  // `frame`: the newest frame with its figures, or null; `findings`: what the doctor says about this camera.
  async show(camera, drift, frame, findings) {
    const words = texts.cameras;
    const hangs = camera.recovery?.why === "silent";
    setText(this.state, camera.connected ? (hangs ? words.hangs : words.connected) : words.lost);
    this.root.classList.toggle("lost", !camera.connected);
    this.#showFacts(camera, drift, frame);
    this.#showRemarks(camera, drift, frame, findings);
    if (frame) await this.#showFrame(frame);
    else if (!this.#shown) this.picture.replaceChildren(make("p", { textContent: words.noFrame }));
  }

  async #showFrame(frame) {
    const shown = `${frame.run}/${frame.row}`;
    if (shown === this.#shown) return;
    if (await showFrame(this, frame, rest.cameraPicture(frame), texts.cameras.alt(frame.row))) this.#shown = shown;
  }

  #showFacts(camera, drift, frame) {
    const words = texts.cameras.facts;
    const counters = Object.entries(camera.counters).filter(([name, value]) => LOST.test(name) && value);
    const facts = [
      ...(camera.serial ? [[words.serial, `${camera.serial} ${camera.model}`.trim()]] : []),
      ...(camera.temperature_c == null ? [] : [[words.temperature, `${number(camera.temperature_c, 1)} °C`]]),
      ...(camera.ptp ? [[words.ptp, ptpWords(camera.ptp)]] : []),
      [words.delivered, number(camera.delivered)],
      [words.incomplete, number(camera.incomplete)],
      ...counters.map(([name, value]) => [name, number(value)]),
      ...(frame?.link_mbit_s == null ? [] : [[words.link, `${number(frame.link_mbit_s, 1)} Mbit/s`]]),
      ...(drift ? [[words.drift, drift]] : []),
      ...(frame?.exposure_us == null ? [] : [[words.exposure, `${number(frame.exposure_us)} µs`]]),
      ...(frame?.gain == null ? [] : [[words.gain, `× ${number(frame.gain, 2)}`]]),
      ...(frame?.light ? [[words.light, frame.light]] : []),
    ];
    this.facts.replaceChildren(...lines(facts));
  }

  #showRemarks(camera, drift, frame, findings) {
    const words = texts.cameras;
    const tiles = frame?.tiles.filter((tile) => tile.blur_px != null && tile.blur_px > BLUR_LIMIT_PX).length ?? 0;
    const remarks = [
      ...(camera.recovery ? [words.recovery(camera.recovery.why, camera.recovery.step, moment(camera.recovery.at))] : []),
      ...(camera.message && !(camera.recovery && camera.connected) ? [{ english: camera.message }] : []),
      ...(frame && frame.saturated > SATURATED_LIMIT ? [words.tooBright(percent(frame.saturated, 1))] : []),
      ...(frame && frame.high < DARK_LIMIT ? [words.tooDark(percent(frame.high))] : []),
      ...(tiles ? [words.soft(tiles)] : []),
    ];
    const wanted = JSON.stringify([remarks, findings]);
    if (this.remarks.dataset.shown === wanted) return;
    this.remarks.dataset.shown = wanted;
    this.remarks.replaceChildren(...remarks.map((line) => make("li", {}, ...(line.english ? said(line.english) : [line]))), ...findings.map((finding) => make("li", {}, ...remarkOf(finding))));
  }
}

export class CamerasView extends View {
  name = "cameras-view";
  #station;
  #cards = [];
  #findings = [];
  #due = 0;
  #closed = false;
  #trial = null;
  #exchange = null;

  constructor(station) {
    super(PART, make("div", { className: "cameras" }));
    this.#station = station;
    this.part("examine").addEventListener("click", () => rest.unattended(this.#examine()));
  }

  open() {
    rest.unattended(this.#follow());
  }

  close() {
    this.#closed = true;
    clearTimeout(this.#due);
    this.#trial?.stop();
  }

  async show({ state }) {
    this.#trial?.show(state);
  }

  // The cards follow the frames while the view is open and visible.
  async #follow() {
    if (!document.hidden && this.#station.now && !this.#station.stale) await rest.unattended(this.#load());
    if (!this.#closed) this.#due = setTimeout(() => this.#follow(), this.#station.now ? AGAIN_MS : 200);
  }

  async #load() {
    const { cameras } = this.#station.now;
    const calibration = await rest.calibration();
    if (this.#closed) return;
    if (this.#cards.length !== cameras.length) {
      this.#cards = cameras.map((camera) => new Card(camera));
      this.part("camera-cards").replaceChildren(...this.#cards.map((card) => card.root));
      this.#trial = new Trial(cameras);
      this.#exchange = new Exchange();
      this.part("exchange-place").replaceChildren(this.#exchange.root);
      this.part("trial-place").replaceChildren(this.#trial.root);
      this.#trial.show(this.#station.now.state);
    }
    this.#exchange.show(cameras, calibration);
    const ready = cameras.filter((camera) => camera.connected).length;
    setText(this.part("camera-answer"), texts.cameras.ready(ready, cameras.length));
    // One after the other: the station measures each frame, and boards come first.
    for (const [n, card] of this.#cards.entries()) {
      const frame = await rest.cameraFrame(n).catch((error) => {
        if (error instanceof rest.Refusal) return null;
        throw error;
      });
      if (this.#closed) return;
      const named = this.#findings.filter((finding) => finding.subject === cameras[n].name && finding.action);
      await card.show(cameras[n], this.#drift(calibration.cameras[n]), frame, named);
    }
    this.root.dataset.shown = "cards";
  }

  #drift(camera) {
    const words = texts.cameras;
    if (!camera) return "";
    if (camera.drift) return words.drifted(px(camera.drift.size_px), moment(camera.drift.since));
    return words.states[camera.state];
  }

  async #examine() {
    const words = texts.cameras;
    const [button, answer] = [this.part("examine"), this.part("doctor-answer")];
    button.disabled = true;
    setText(answer, words.examining);
    try {
      const found = await rest.examination();
      this.#findings = found.findings;
      const wrong = found.findings.filter((finding) => finding.level === "warning" || finding.level === "fault");
      setText(answer, `${words.found(wrong.length, found.findings.length)} (${moment(found.created)})`);
      this.part("doctor-findings").replaceChildren(...wrong.map((finding) => findingItem(finding)));
    } catch (error) {
      answer.replaceChildren(...saidOf(error));
    }
    button.disabled = false;
  }
}
