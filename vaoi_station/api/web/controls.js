// Arm and disarm, with the board type and the board's id (typed, or scanned: a scanner ends with Enter).
import * as rest from "./rest.js";
import { texts } from "./texts.en.js";

const $ = (id) => document.getElementById(id);

export class Controls {
  #onDone;
  #armedType = null;
  #allowLost = false; // the last refusal was for a lost camera: the next press arms without it

  constructor(onDone) {
    this.#onDone = onDone;
    $("controls").addEventListener("submit", (event) => {
      event.preventDefault();
      const request = { board_type: $("board-type").value };
      if ($("board-id").value.trim()) request.board_id = $("board-id").value.trim();
      if (this.#allowLost) request.allow_lost_cameras = true;
      this.#command(() => rest.arm(request), texts.armedFor(request.board_type));
    });
    $("disarm").addEventListener("click", () => this.#command(() => rest.disarm(), texts.disarmed));
  }

  // The list of board types, keeping the choice.
  async reload() {
    try {
      const types = await rest.boardTypes();
      const chosen = this.#armedType ?? $("board-type").value;
      $("board-type").replaceChildren(
        ...types.map((type) => {
          const text = type.fault ? `${type.name} (${texts.unusable})` : type.name;
          return Object.assign(document.createElement("option"), { value: type.name, textContent: text, disabled: !!type.fault });
        }),
      );
      if (types.some((type) => type.name === chosen)) $("board-type").value = chosen;
    } catch (error) {
      this.#say(error instanceof rest.Refusal ? error.message : texts.noAnswer, true);
    }
  }

  show(now) {
    const type = now.armed_with?.board_type ?? null;
    if (type && type !== this.#armedType) $("board-type").value = type;
    this.#armedType = type;
    if (now.all_cameras_ready) this.#offer(false);
  }

  // A button for each database that was set aside, until an administrator has acknowledged it.
  showSetAside(files) {
    const open = files.filter((f) => !f.acknowledged).map((f) => f.file);
    const list = $("set-aside");
    if (open.join("\n") === list.dataset.shown) return;
    list.dataset.shown = open.join("\n");
    list.hidden = open.length === 0;
    list.replaceChildren(
      ...open.map((file) => {
        const button = Object.assign(document.createElement("button"), { type: "button", textContent: texts.acknowledge(file) });
        button.addEventListener("click", () => this.#command(() => rest.acknowledge(file), texts.acknowledged(file)));
        return button;
      }),
    );
  }

  enable(on) {
    for (const id of ["arm", "disarm", "board-type", "board-id", "component"]) $(id).disabled = !on;
  }

  async #command(call, done) {
    this.#say("", false);
    try {
      await call();
      this.#say(done, false);
      this.#offer(false);
      $("board-id").value = "";
    } catch (error) {
      this.#say(error instanceof rest.Refusal ? error.message : texts.noAnswer, true);
      this.#offer(error instanceof rest.Refusal && error.code === "camera-lost");
    }
    this.#onDone();
  }

  #offer(allowLost) {
    this.#allowLost = allowLost;
    $("arm").textContent = allowLost ? texts.armAnyway : texts.arm;
  }

  #say(text, refused) {
    $("answer").textContent = text;
    $("answer").classList.toggle("refused", refused);
  }
}
