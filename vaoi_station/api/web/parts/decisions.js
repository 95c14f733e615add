// What a person decides about a board whose pictures are not good: film it again, or use them. Kept with the run.
import { make, showRefusal } from "./elements.js";
import { short } from "./orders.js";
import * as rest from "./rest.js";
import { keep, kept } from "./settings.js";
import { clock, texts } from "../texts/texts.js";

// Without pictures there is nothing to use.
const choicesOf = (run) => (run.verdict === "degraded" ? ["film-again", "use"] : ["film-again"]);
const name_of = (choice) => (choice === "use" ? texts.use : texts.filmAgain);

export class Decisions {
  #root;
  #onDecided;
  #wanted = [null, ""]; // the board of the last call of show, and what it is called there
  #shown = "";
  #asked = null; // the board of the open form

  constructor(root, onDecided) {
    [this.#root, this.#onDecided] = [root, onDecided];
  }

  // `run`: the board to decide about, or null; `label`: what it is called if it is not the one shown beside. `runs`: what is known
  // of boards by now. An open form stays, whatever comes, until its own board is decided.
  show(run, label = "", runs = run ? [run] : []) {
    this.#wanted = [run, label];
    if (this.#asked && !runs.some((known) => known.id === this.#asked.id && known.decision)) return;
    this.#asked = null;
    const wanted = run && run.finished && run.verdict !== "ok" && !run.decision ? `${run.id} ${label}` : "";
    if (wanted === this.#shown && !this.#root.querySelector("form")) return;
    this.#shown = wanted;
    this.#offer(wanted ? run : null, label);
  }

  #offer(run, label) {
    const buttons = !run ? [] : choicesOf(run).map((choice) => {
      const button = make("button", { type: "button", textContent: label ? `${label}: ${name_of(choice)}` : name_of(choice) });
      button.addEventListener("click", () => this.#ask(run, choice));
      return button;
    });
    this.#root.replaceChildren(...buttons);
  }

  // Ends the form and offers what is to be decided now.
  #close() {
    this.#asked = null;
    this.#shown = "";
    this.#root.replaceChildren();
    this.show(...this.#wanted);
  }

  // Name and reason are filled in as far as they are known: one more press confirms.
  // The button names the board: the one that is shown beside may be another by then.
  #ask(run, choice) {
    this.#asked = run;
    const first = run.reasons[0];
    const name = make("input", { id: "decision-name", required: true, maxLength: 80, value: kept("name", "") });
    const reason = make("input", {
      id: "decision-reason", required: true, maxLength: 400, value: choice === "film-again" && first ? first.cause || first.code : "",
    });
    const cancel = make("button", { type: "button", textContent: texts.cancel });
    const answer = make("div", { id: "decision-answer", role: "alert" });
    const form = make("form", { id: "decision" },
      make("label", { htmlFor: name.id, textContent: texts.yourName }), name,
      make("label", { htmlFor: reason.id, textContent: texts.reason }), reason,
      make("button", { textContent: `${short(run.board_id) ?? clock(run.started)}: ${name_of(choice)}` }), cancel, answer);
    cancel.addEventListener("click", () => this.#close());
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      try {
        await rest.decide(run.id, { choice, name: name.value.trim(), reason: reason.value.trim() });
        keep("name", name.value.trim());
        this.#wanted = [null, ""]; // until the station's reply has come, nothing is offered
        this.#close();
        this.#onDecided();
      } catch (error) {
        showRefusal(answer, error);
      }
    });
    this.#root.replaceChildren(form);
    (name.value ? reason : name).focus();
  }
}
