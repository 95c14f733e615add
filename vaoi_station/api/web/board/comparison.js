// The comparison of a board with another one: which, and how: a slider between both, or blinking.
import { make, options, saidOf, setText, View } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { texts } from "../texts/texts.js";

const BLINK_MS = 700;
const SOUGHT = 20; // earlier or later runs among which the board before or after is sought
const PART = `
<label><span data-text="board.compare"></span><select id="with"></select></label>
<input id="with-run" maxlength="64" spellcheck="false" autocomplete="off" data-label="board.otherRun" hidden>
<div id="how" role="group" data-label="board.how" hidden></div>
<input id="divide" type="range" min="0" max="100" value="50" data-label="board.divide" hidden>
<p id="compare-answer" role="status"></p>`;

const hasPictures = (run) => run.verdict === "ok" || run.verdict === "degraded";

export class Comparison extends View {
  #state;
  #onChange;
  #run = null;
  #other = null;
  #mosaics = [];
  #timer = null;
  #visible = true;
  #asked = 0;

  // onChange({ run, mosaics, visible, from, beside }): the other run or null, its mosaics, and how it is shown: blinking, from this share
  // of the width on, or beside this one.
  constructor(root, state, onChange) {
    super(PART, root);
    [this.#state, this.#onChange] = [state, onChange];
    const choices = { "": texts.board.nothing, previous: texts.board.previous, next: texts.board.next, reference: texts.board.reference, run: texts.board.otherRun };
    this.part("with").append(...options(Object.entries(choices)));
    this.part("how").append(...["slider", "blink", "beside"].map((how) => this.#mode(how)));
    const chosen = state.get("with");
    this.part("with").value = chosen in choices ? chosen : "run";
    this.part("with-run").value = chosen in choices ? "" : chosen;
    this.part("with").addEventListener("change", () => {
      const value = this.part("with").value;
      this.#state.set({ with: value === "run" ? this.part("with-run").value.trim() : value });
      if (value === "run") this.part("with-run").focus();
      rest.unattended(this.#resolve());
    });
    this.part("with-run").addEventListener("change", () => {
      this.#state.set({ with: this.part("with-run").value.trim() });
      rest.unattended(this.#resolve());
    });
    this.part("divide").addEventListener("input", () => this.#report());
  }

  #mode(how) {
    const button = make("button", { type: "button", textContent: texts.board[how] });
    button.dataset.how = how;
    button.addEventListener("click", () => {
      this.#state.set({ how });
      this.#begin();
    });
    return button;
  }

  async show(run) {
    this.#run = run;
    await this.#resolve();
  }

  // Find the other run; every refusal is said here.
  async #resolve() {
    const asked = ++this.#asked;
    const chosen = this.#state.get("with");
    this.part("with-run").hidden = this.part("with").value !== "run";
    let [other, mosaics, answer, refused] = [null, [], "", null];
    if (chosen) {
      try {
        const id = await this.#idOf(chosen);
        other = id && (await rest.run(id));
        if (!other) answer = texts.board.noOther[chosen] ?? texts.notFound;
        else if (other.board_type !== this.#run.board_type) [other, answer] = [null, texts.board.otherType(other.board_type)];
        else if (other.id === this.#run.id) [other, answer] = [null, texts.board.itself];
      } catch (error) {
        if (!(error instanceof rest.Refusal)) throw error;
        if (error.code === "no-reference") answer = texts.board.noOther.reference;
        else if (error.status === 404) answer = texts.notFound;
        else refused = error;
      }
    }
    if (other) {
      mosaics = await shownMosaics(other).catch(() => []);
      answer = texts.board.comparedWith(other.board_id ?? texts.noId, other.id) + (mosaics.length ? "" : ` ${texts.board.otherGone}`);
    }
    if (asked !== this.#asked) return; // overtaken by a later choice
    [this.#other, this.#mosaics] = [other, mosaics];
    setText(this.part("compare-answer"), answer);
    if (refused) this.part("compare-answer").replaceChildren(...saidOf(refused));
    this.#begin();
  }

  async #idOf(chosen) {
    if (chosen === "reference") return (await rest.reference(this.#run.board_type)).run;
    if (chosen === "next") return this.#next();
    if (chosen !== "previous") return chosen;
    const { runs } = await rest.runs({ board_type: this.#run.board_type, before: this.#run.id, limit: SOUGHT });
    return runs.find(hasPictures)?.id;
  }

  async #next() {
    let run = this.#run;
    for (let n = 0; n < SOUGHT && run; n++) {
      run = await rest.nextRun(run.id);
      if (run && run.board_type === this.#run.board_type && hasPictures(run)) return run.id;
    }
    return null;
  }

  #begin() {
    clearInterval(this.#timer);
    const how = this.#state.get("how");
    this.#visible = true;
    this.part("how").hidden = !this.#other;
    this.part("divide").hidden = !this.#other || how !== "slider";
    for (const button of this.part("how").children) button.setAttribute("aria-pressed", button.dataset.how === how);
    if (this.#other && how === "blink") {
      this.#timer = setInterval(() => {
        this.#visible = !this.#visible;
        this.#report();
      }, BLINK_MS);
    }
    this.#report();
  }

  #report() {
    const how = this.#state.get("how");
    const from = how === "slider" ? Number(this.part("divide").value) / 100 : 0;
    this.#onChange({ run: this.#other, mosaics: this.#mosaics, visible: this.#visible, from, beside: how === "beside" });
  }

  close() {
    this.#asked++;
    clearInterval(this.#timer);
  }
}

// The pictures of the whole board that can be shown of a run: its mosaics while the frames are in memory, else the kept one.
// `asked`: the list of them, if it was asked for before; it was refused if the run had no result then.
export async function shownMosaics(run, asked) {
  if (run.verdict == null || run.verdict === "failed") return [];
  const { mosaics, kept } = (await asked?.catch(() => null)) ?? (await rest.mosaicList(run.id));
  if (run.frames_available) return mosaics;
  return kept ? [{ ...kept, kept: true, name: "kept" }] : [];
}
