// The last board: its picture, verdict, age, and what a person decides about it.
import { boardPicture } from "../parts/board_picture.js";
import { make, setText } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { keep, kept } from "../parts/settings.js";
import { draw } from "../parts/signs.js";
import { texts } from "../texts/texts.js";

const PART = `
<h2 id="last-title" data-text="lastBoard"></h2>
<div id="last-picture"></div>
<div id="last-facts" role="status" aria-live="polite">
  <svg id="verdict-shape" viewBox="0 0 100 100" aria-hidden="true"></svg>
  <div id="verdict-word"></div>
  <p id="last-board"><strong id="board-name"></strong> <span id="age" aria-live="off"></span></p>
  <p id="board-order"></p>
  <p id="unseen"></p>
</div>
<div id="decisions"></div>`;

export class LastBoard {
  #root;
  #onDecided;
  #run = null;
  #seen = "";

  constructor(root, onDecided) {
    [this.#root, this.#onDecided] = [root, onDecided];
    root.innerHTML = PART;
    this.#showNone();
  }

  #part(id) {
    return this.#root.querySelector(`#${id}`);
  }

  #showNone() {
    draw(this.#part("verdict-shape"), "none");
    setText(this.#part("verdict-word"), texts.noBoard);
    this.#root.dataset.verdict = "none";
  }

  tick(now_ms) {
    if (this.#run) setText(this.#part("age"), texts.ago((now_ms - Date.parse(this.#run.finished)) / 1000));
  }

  async show(summary, now_ms) {
    if (!summary) return;
    const seen = `${summary.id} ${summary.frames_available} ${summary.decision?.decided}`;
    if (seen === this.#seen) return;
    const run = await rest.run(summary.id);
    const other = this.#run?.id !== run.id;
    this.#run = run;
    const verdict = run.verdict ?? "failed";
    this.#root.dataset.verdict = verdict;
    draw(this.#part("verdict-shape"), verdict);
    setText(this.#part("verdict-word"), texts.verdicts[verdict]);
    setText(this.#part("board-name"), run.board_id ?? texts.noId);
    setText(this.#part("board-order"), run.decision ? texts.decided[run.decision.choice](run.decision.name) : "");
    setText(this.#part("unseen"), run.unseen?.length ? texts.unseenCount(run.unseen.length) : "");
    this.#showDecisions(run);
    this.tick(now_ms);
    this.#seen = seen;
    if (other) this.#showPicture(run); // not awaited: the state must not wait for a picture
  }

  async #showPicture(run) {
    const picture = await boardPicture(run, { alt: texts.lastBoard }).catch(() => null);
    if (run !== this.#run) return; // overtaken by a later board
    this.#part("last-picture").replaceChildren(picture ?? make("p", { textContent: texts.noMosaic }));
  }

  #showDecisions(run) {
    const all = make("a", { className: "button", href: `#/board/${encodeURIComponent(run.id)}`, textContent: texts.open });
    const choices = run.verdict === "ok" || run.decision ? [] : ["film-again", "use"].map((choice) => {
      const button = make("button", { type: "button", textContent: choice === "use" ? texts.use : texts.filmAgain });
      button.dataset.choice = choice;
      button.addEventListener("click", () => this.#ask(run, choice));
      return button;
    });
    this.#part("decisions").replaceChildren(...choices, all);
  }

  // Name and reason are filled in as far as they are known: one more press confirms.
  #ask(run, choice) {
    const name = make("input", { id: "decision-name", required: true, maxLength: 80, value: kept("name", "") });
    const first = run.reasons[0];
    const reason = make("input", { id: "decision-reason", required: true, maxLength: 400, value: choice === "film-again" && first ? first.cause || first.code : "" });
    const cancel = make("button", { type: "button", textContent: texts.cancel });
    const answer = make("p", { id: "decision-answer" });
    answer.setAttribute("role", "alert");
    const form = make("form", { id: "decision" },
      make("label", { htmlFor: name.id, textContent: texts.yourName }), name,
      make("label", { htmlFor: reason.id, textContent: texts.reason }), reason,
      make("button", { textContent: `${choice === "use" ? texts.use : texts.filmAgain}: ${texts.confirm}` }), cancel, answer);
    cancel.addEventListener("click", () => this.#showDecisions(run));
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      try {
        await rest.decide(run.id, { choice, name: name.value.trim(), reason: reason.value.trim() });
        keep("name", name.value.trim());
        this.#seen = "";
        this.#onDecided();
      } catch (error) {
        answer.textContent = error instanceof rest.Refusal ? error.message : texts.noAnswer;
      }
    });
    this.#part("decisions").replaceChildren(form);
    (name.value ? reason : name).focus();
  }
}
