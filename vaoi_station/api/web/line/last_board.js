// The last board: its picture, verdict, age, and what a person decides about it.
import { boardPicture } from "../parts/board_picture.js";
import { make, setText, View } from "../parts/elements.js";
import { Decisions } from "../parts/decisions.js";
import { short } from "../parts/orders.js";
import * as rest from "../parts/rest.js";
import { draw } from "../parts/signs.js";
import { clock, texts } from "../texts/texts.js";

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
<div id="actions"><div id="decisions"></div><a id="open-board" class="button" hidden></a></div>`;

export class LastBoard extends View {
  #decisions;
  run = null; // the one that is shown, with its frames and figures
  #seen = "";

  constructor(root, onDecided) {
    super(PART, root);
    this.#decisions = new Decisions(this.part("decisions"), onDecided);
    this.#showNone();
  }

  #showNone() {
    draw(this.part("verdict-shape"), "none");
    setText(this.part("verdict-word"), texts.noBoard);
    this.root.dataset.verdict = "none";
  }

  tick(now_ms) {
    if (this.run) setText(this.part("age"), texts.ago((now_ms - Date.parse(this.run.finished)) / 1000));
  }

  // `runs`: the last boards, oldest first; `open`: the one that needs a decision, or null.
  async show(runs, open, now_ms) {
    const summary = runs.at(-1);
    if (!summary) return;
    const other = open && open.id !== summary.id;
    this.root.classList.toggle("other-board", Boolean(other));
    this.#decisions.show(open ?? summary, other ? (short(open.board_id) ?? clock(open.started)) : "", runs);
    const { id, frames_available, decision, verdict: word, reasons } = summary; // the codes of a board are read after its result
    const seen = JSON.stringify([id, frames_available, decision?.decided, word, reasons]);
    if (seen === this.#seen) return;
    const run = await rest.run(summary.id);
    const changed = this.run?.id !== run.id;
    this.run = run;
    const verdict = run.verdict ?? "failed";
    this.root.dataset.verdict = verdict;
    draw(this.part("verdict-shape"), verdict);
    setText(this.part("verdict-word"), texts.verdicts[verdict]);
    setText(this.part("board-name"), run.board_id ?? texts.noId);
    setText(this.part("board-order"), run.decision ? texts.decided[run.decision.choice](run.decision.name) : "");
    const remarks = [
      run.unseen?.length && texts.unseenCount(run.unseen.length),
      run.skipped_boards?.length && texts.skippedBoards(run.skipped_boards),
    ];
    setText(this.part("unseen"), remarks.filter(Boolean).join(" · "));
    this.part("open-board").href = `#/board/${encodeURIComponent(run.id)}`;
    this.part("open-board").hidden = false;
    setText(this.part("open-board"), verdict === "failed" ? texts.openFailed : texts.open);
    this.tick(now_ms);
    this.#seen = seen;
    if (changed) this.#showPicture(run); // not awaited: the state must not wait for a picture
  }

  async #showPicture(run) {
    // Words in its place, also in place of the picture of the board before: a worker reads all frames first.
    this.part("last-picture").replaceChildren(make("p", { textContent: texts.pictureBeingMade }));
    const picture = await boardPicture(run, { alt: texts.lastBoard }).catch(() => null);
    if (run !== this.run) return; // overtaken by a later board
    this.part("last-picture").replaceChildren(picture ?? make("p", { textContent: texts.noMosaic }));
  }
}
