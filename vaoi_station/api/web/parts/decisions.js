// What a person decides about a board whose pictures are not good: film it again, or use them. Kept with the run.
import { make } from "./elements.js";
import * as rest from "./rest.js";
import { keep, kept } from "./settings.js";
import { texts } from "../texts/texts.js";

const CHOICES = ["film-again", "use"];
const name_of = (choice) => (choice === "use" ? texts.use : texts.filmAgain);

export class Decisions {
  #root;
  #onDecided;
  #run = null;
  #shown = "";

  constructor(root, onDecided) {
    [this.#root, this.#onDecided] = [root, onDecided];
  }

  // `run`: the board to decide about, or null; `label`: what it is called if it is not the one shown beside.
  show(run, label = "") {
    const wanted = run && run.finished && run.verdict !== "ok" && !run.decision ? `${run.id} ${label}` : "";
    if (wanted === this.#shown || (this.#root.querySelector("form") && wanted)) return; // an open form stays
    this.#shown = wanted;
    this.#run = run;
    this.#offer(wanted ? label : null);
  }

  #offer(label) {
    const buttons = label === null ? [] : CHOICES.map((choice) => {
      const button = make("button", { type: "button", textContent: label ? `${label}: ${name_of(choice)}` : name_of(choice) });
      button.addEventListener("click", () => this.#ask(choice, label));
      return button;
    });
    this.#root.replaceChildren(...buttons);
  }

  // Name and reason are filled in as far as they are known: one more press confirms.
  #ask(choice, label) {
    const run = this.#run;
    const first = run.reasons[0];
    const name = make("input", { id: "decision-name", required: true, maxLength: 80, value: kept("name", "") });
    const reason = make("input", {
      id: "decision-reason", required: true, maxLength: 400, value: choice === "film-again" && first ? first.cause || first.code : "",
    });
    const cancel = make("button", { type: "button", textContent: texts.cancel });
    const answer = make("p", { id: "decision-answer" });
    answer.setAttribute("role", "alert");
    const form = make("form", { id: "decision" },
      make("label", { htmlFor: name.id, textContent: texts.yourName }), name,
      make("label", { htmlFor: reason.id, textContent: texts.reason }), reason,
      make("button", { textContent: `${name_of(choice)}: ${texts.confirm}` }), cancel, answer);
    cancel.addEventListener("click", () => this.#offer(label));
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      try {
        await rest.decide(run.id, { choice, name: name.value.trim(), reason: reason.value.trim() });
        keep("name", name.value.trim());
        this.#shown = "";
        this.#root.replaceChildren();
        this.#onDecided();
      } catch (error) {
        answer.textContent = error instanceof rest.Refusal ? error.message : texts.noAnswer;
      }
    });
    this.#root.replaceChildren(form);
    (name.value ? reason : name).focus();
  }
}
