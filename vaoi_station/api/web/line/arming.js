// Arm and disarm, with the board type and the board's id (typed, or scanned: a scanner ends with Enter).
import { make, setText, showRefusal, View } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { stateOf } from "../parts/orders.js";
import { kept, keep } from "../parts/settings.js";
import { texts } from "../texts/texts.js";

const HOLD_MS = 1000; // so that a touch in passing does not stop the line
const SAID_MS = 15_000;
const PART = `
<label for="board-type" data-text="boardType"></label>
<select id="board-type" required></select>
<label for="board-id" data-text="boardId"></label>
<input id="board-id" maxlength="200" autocomplete="off" spellcheck="false">
<button type="submit" id="arm"></button>
<div id="answer" role="alert"></div>`;

export class Arming extends View {
  #type = this.part("board-type");
  #id = this.part("board-id");
  #answer = this.part("answer");
  #button = this.part("arm");
  #setAside;
  #onDone;
  #armed = null; // the board type that is armed
  #state = "";
  #lost = false; // the last refusal was for a lost camera: the next press arms without it
  #holding = 0;
  #pressed = false; // the button went down as Disarm: what its release submits is no order to arm
  #said = 0;

  constructor(form, setAside, onDone) {
    super(PART, form);
    [this.#setAside, this.#onDone] = [setAside, onDone];
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      if (!this.#offersDisarm() && !this.#pressed) this.#arm();
    });
    for (const field of [this.#type, this.#id]) {
      field.addEventListener("input", () => this.#showButton());
      field.addEventListener("focus", () => (this.#pressed = false));
    }
    this.#type.addEventListener("change", () => keep("board-type", this.#type.value));
    for (const begin of ["pointerdown", "keydown"]) this.#button.addEventListener(begin, (event) => this.#begin(event));
    for (const end of ["pointerup", "pointerleave", "pointercancel", "keyup", "blur"]) this.#button.addEventListener(end, () => this.#stop());
  }

  #offersDisarm() {
    return this.#armed !== null && this.#type.value === this.#armed && !this.#id.value.trim() && !this.#lost;
  }

  #showButton() {
    const disarm = this.#offersDisarm();
    setText(this.#button, disarm ? texts.disarm : this.#lost ? texts.armAnyway : texts.arm);
    this.#button.classList.toggle("disarm", disarm);
  }

  #begin(event) {
    if (event.repeat || (event.type === "keydown" && !["Enter", " "].includes(event.key))) return;
    this.#stop();
    this.#pressed = this.#offersDisarm();
    if (!this.#pressed) return;
    this.#button.classList.add("holding");
    this.#holding = setTimeout(() => {
      this.#stop();
      this.#command(() => rest.disarm(), texts.disarmed);
    }, HOLD_MS);
  }

  // The click, and with it the submission, comes after the release: `#pressed` lasts until the next press or another field.
  #stop() {
    clearTimeout(this.#holding);
    this.#button.classList.remove("holding");
  }

  #arm() {
    const request = { board_type: this.#type.value };
    if (this.#id.value.trim()) request.board_id = this.#id.value.trim();
    if (this.#lost) request.allow_lost_cameras = true;
    this.#command(() => rest.arm(request), texts.armedFor(request.board_type));
  }

  // The list of board types, keeping the choice.
  async reload() {
    try {
      const types = await rest.boardTypes();
      const chosen = this.#type.value || this.#armed || kept("board-type", "");
      this.#type.replaceChildren(
        ...types.map((type) => {
          const text = type.fault ? `${type.name} (${texts.unusable})` : type.name;
          return make("option", { value: type.name, textContent: text, disabled: !!type.fault });
        }),
      );
      if (types.some((type) => type.name === chosen)) this.#type.value = chosen;
      this.#showButton();
    } catch (error) {
      this.#refuse(error);
    }
  }

  show(now) {
    const type = now.armed_with?.board_type ?? null;
    if (type && type !== this.#armed) this.#type.value = type;
    this.#armed = type;
    if (now.all_cameras_ready) this.#lost = false;
    const refused = this.#answer.classList.contains("refused");
    // It spoke of the state before, unless it says that a command has brought this one.
    const state = stateOf(now); // a line that is held is not called armed
    if (state !== this.#state && (refused || performance.now() - this.#said > 1000)) this.#say("");
    this.#state = state;
    this.#showButton();
  }

  // A button for each database that was set aside, until an administrator has acknowledged it.
  showSetAside(files) {
    const open = files.filter((f) => !f.acknowledged).map((f) => f.file);
    const list = this.#setAside;
    if (open.join("\n") === (list.dataset.shown ?? "")) return;
    list.dataset.shown = open.join("\n");
    list.hidden = open.length === 0;
    list.replaceChildren(
      ...open.map((file) => {
        const button = make("button", { type: "button", textContent: texts.acknowledge(file) });
        button.addEventListener("click", () => this.#command(() => rest.acknowledge(file), texts.acknowledged(file)));
        return button;
      }),
    );
  }

  enable(on) {
    for (const field of [this.#type, this.#id, this.#button]) field.disabled = !on;
  }

  async #command(call, done) {
    this.#say("");
    try {
      await call();
      this.#say(done);
      this.#lost = false;
      this.#id.value = "";
    } catch (error) {
      this.#refuse(error);
      this.#lost = error instanceof rest.Refusal && error.code === "camera-lost";
    }
    this.#showButton();
    await this.#onDone();
  }

  #say(text) {
    setText(this.#answer, text);
    this.#answer.classList.remove("refused");
    this.#endLater();
  }

  #refuse(error) {
    showRefusal(this.#answer, error);
    this.#answer.classList.add("refused");
    this.#endLater();
  }

  // A message ends by itself, unless a person reads the station's sentence.
  #endLater() {
    this.#said = performance.now();
    if (!this.#answer.textContent) return;
    setTimeout(() => {
      if (performance.now() - this.#said >= SAID_MS - 50 && !this.#answer.querySelector("[open]")) this.#say("");
    }, SAID_MS);
  }
}
