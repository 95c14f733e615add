// A camera in the place of another: search, place, and the confirmation of its calibration by the boards since.
import { make, setText, showLines } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { answerLine, button, table } from "../setup/fields.js";
import { rightsFor } from "../setup/rights.js";
import { number, texts } from "../texts/texts.js";

export class Exchange {
  #words = texts.cameras.exchange;
  #pending = "";
  #entered = false;

  constructor() {
    const words = this.#words;
    this.title = make("summary", { textContent: words.title, id: "exchange-title" });
    this.pending = make("div", { id: "exchange-pending" });
    this.answer = Object.assign(answerLine(), { id: "exchange-answer" });
    this.steps = make("ol", {}, ...words.steps.map((textContent) => make("li", { textContent })));
    this.search = button(words.search, () => this.#search(), this.answer, { id: "exchange-search" });
    this.gone = make("div", { id: "exchange-gone" });
    this.found = make("div", { id: "exchange-found" });
    this.orders = make("div", {}, this.pending, this.search, this.answer, this.gone, this.found);
    this.body = make("div", { className: "exchange-body" }, this.steps, this.orders);
    this.folded = make("details", {}, this.title, this.body);
    this.folded.addEventListener("toggle", () => this.folded.open && rest.unattended(this.#enter()));
    this.root = make("section", { id: "exchange" }, this.folded);
    this.root.setAttribute("aria-labelledby", "exchange-title");
  }

  // The section calls for itself when a camera is gone, or was exchanged and is to be confirmed. It does not open by itself: it may ask for a key.
  show(cameras, calibration) {
    const words = this.#words;
    const waiting = calibration.cameras.filter((camera) => camera.exchange);
    const gone = cameras.filter((camera) => camera.serial && !camera.connected).map((camera) => camera.name);
    this.root.classList.toggle("called", waiting.length + gone.length > 0);
    setText(this.title, gone.length ? words.titleGone(gone.join(", ")) : waiting.length ? words.titleWaiting : words.title);
    const shown = JSON.stringify(waiting.map(({ camera, exchange }) => [camera, exchange]));
    if (shown === this.#pending) return;
    this.#pending = shown;
    this.pending.replaceChildren(...waiting.map((camera) => this.#waiting(camera)));
  }

  // A caller without a key for it is asked for one in place of the orders.
  async #enter() {
    if (this.#entered) return;
    const place = make("div");
    this.body.replaceChildren(this.steps, place);
    if (!(await rightsFor("admin", place))) return;
    this.#entered = true;
    this.body.replaceChildren(this.steps, this.orders);
  }

  #waiting({ camera, name, exchange }) {
    const words = this.#words;
    const lines = make("ul", { className: "exchange-state" });
    const said = exchange.ready
      ? [words.measured(exchange.boards, number(exchange.x_px, 2), number(exchange.y_px, 2), number(exchange.turn_px, 2), number(exchange.sigma_px, 3))]
      : exchange.boards ? [words.notYet(exchange.boards), `${exchange.message} ${exchange.action}`.trim()] : [words.noBoard];
    showLines(lines, [words.uncalibrated(name), ...said]);
    if (exchange.ready) {
      const confirm = async () => {
        const made = await rest.confirmCamera(camera);
        return words.confirmed(name, number(made.sigma_px, 3));
      };
      return make("div", {}, lines, button(words.confirm(name), confirm, this.answer, { className: "exchange-confirm" }));
    }
    return lines;
  }

  async #search() {
    const words = this.#words;
    const { found, gone } = await rest.searchCameras();
    this.gone.replaceChildren(...gone.map((place) => this.#place(place, found)));
    const rows = found.map((camera) => {
      const state = camera.place ? words.states.place(camera.place) : !camera.reachable ? words.states.foreign : camera.in_use ? words.states.used : words.states.free;
      return [camera.serial, camera.model, camera.maker, camera.address, camera.interface, state];
    });
    this.found.replaceChildren(...(rows.length ? [table(words.heads, rows)] : []));
    return gone.length ? words.gone(gone.length) : words.none;
  }

  #place({ camera, name, serial, model, candidates }) {
    const words = this.#words;
    const text = candidates.length === 1 ? words.proposal(name, serial, model, candidates[0]) : candidates.length ? words.several(name, serial, model) : words.nothing(name, serial, model);
    const put = (other) => async () => {
      const made = await rest.exchangeCamera(camera, { serial: other });
      this.gone.replaceChildren();
      return words.done(made.name, made.serial);
    };
    const choices = candidates.map((other) => button(words.put(other), put(other), this.answer, { className: "exchange-put" }));
    return make("div", { className: "exchange-place" }, make("p", { textContent: text }), ...choices);
  }
}
