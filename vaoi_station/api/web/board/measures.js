// What is measured of the parts of a board: remarks, the parts in doubt, and whether the board is one of the good ones. The station
// measures, the tester judges.
import { arrowKeys, make, said, saidOf, View } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { number, texts } from "../texts/texts.js";
import { measureText, VALUES } from "./colours.js";

const LIKELY = 0.5; // probability from which on something is said of a part in doubt
const SIGNIFICANT = 4; // σ of a shift that is stated as one
const MOST_SHIFTED = 5;
const MOST_DOUBTS = 60; // more are seen better by colour
const PART = `
<p id="measures-note" role="status"></p>
<ul id="measures-remarks"></ul>
<div id="doubts" role="group" data-label="board.doubts"></div>
<div id="good-tools"><button type="button" id="measure" data-text="board.measure" hidden></button><button type="button" id="good" hidden></button></div>
<div id="good-answer" role="status"></div>`;

// What the panel of a part says of its measure, as pairs of name and value. A cause that concerns all figures stands once.
export function linesOf(measure, reason_texts) {
  const why = measure.reasons.map((code) => texts.board.cannotSayWhy[code] ?? reason_texts[code] ?? code).join("; ");
  const found = Object.keys(VALUES).filter((name) => VALUES[name](measure) != null);
  return [
    ...found.map((name) => [texts.board.colours[name], measureText(name, measure)]),
    ...(measure.height_mm == null ? [] : [[texts.board.parallax, `${number(measure.height_mm, 2)} mm`]]),
    ...(measure.marked ? [[texts.board.marked, markedText(measure)]] : []),
    ...(why ? [[texts.board.cannotSay, why]] : []),
    [texts.board.restsOn, texts.board.basis(measure.frames, measure.boards)],
  ];
}

// A remark in the language of the page; undefined for one that a newer station makes, or an older one has stored.
const remarkText = ({ remark_codes, remark_values }, n) => texts.board.remarks[remark_codes?.[n]]?.(remark_values[n]);

const markedText = (measure) => texts.board.beyondLimits(measure.marked.map((name) => texts.board.limitNames[name]));

// The parts in doubt, as [address, what is said of it]: beyond a limit, absent, turned otherwise, unlike, most shifted; in each group the worst first.
export function doubtsOf(measures) {
  const rest = Object.entries(measures);
  const take = (rank, word) => {
    const found = rest.filter(([, measure]) => rank(measure) > 0).sort((a, b) => rank(b[1]) - rank(a[1]));
    for (const entry of found) rest.splice(rest.indexOf(entry), 1);
    return found.map(([address, measure]) => [address, word(measure)]);
  };
  const limited = (measure) => measure.marked?.length ?? 0;
  const below = (value) => (value == null ? 0 : LIKELY - value);
  const names = texts.board.colours;
  const shift = (measure) => (measure.dx_mm == null || VALUES.shift(measure) <= SIGNIFICANT * measure.sigma_mm ? 0 : VALUES.shift(measure));
  return [
    ...take(limited, (measure) => markedText(measure)),
    ...take((measure) => below(measure.presence), (measure) => texts.board.doubt.absent(measureText("presence", measure))),
    ...take((measure) => below(VALUES.orientation(measure)), (measure) => `${names.orientation} ${measureText("orientation", measure)}`),
    ...take((measure) => below(measure.alike), (measure) => texts.board.doubt.unlike(measureText("alike", measure))),
    ...take(shift, (measure) => `${names.shift} ${measureText("shift", measure)}`).slice(0, MOST_SHIFTED),
  ];
}

export class Measures extends View {
  #onPart;
  #onMeasured;
  #run = null;
  #good = [];
  #chosen = "";

  // onPart(address): a part was chosen; onMeasured({ measures, reason_texts }): the parts of the run are measured.
  constructor(root, onPart, onMeasured) {
    super(PART, root);
    [this.#onPart, this.#onMeasured] = [onPart, onMeasured];
    arrowKeys(this.part("doubts"), () => [...this.part("doubts").querySelectorAll("button")]);
    this.part("measure").addEventListener("click", () => rest.unattended(this.#ask()));
    this.part("good").addEventListener("click", () => rest.unattended(this.#teach()));
  }

  // Without good boards parts are measured at the first request, which costs seconds: they are asked for only if somebody wants them.
  async show(run) {
    this.#run = run;
    const { boards } = await rest.goodBoards(run.board_type);
    if (run !== this.#run) return;
    this.#offer(boards);
    if (boards.length) await this.#ask();
    else this.part("measures-note").replaceChildren(texts.board.noGoodBoards);
  }

  #offer(boards) {
    this.#good = boards.map((board) => board.run);
    this.part("good").hidden = false;
    this.part("good").textContent = this.#isGood() ? texts.board.notGood : texts.board.isGood;
    this.part("measure").hidden = boards.length > 0;
  }

  #isGood() {
    return this.#good.includes(this.#run.id);
  }

  async #ask() {
    const run = this.#run;
    this.part("measures-note").replaceChildren(texts.board.measuring);
    try {
      const found = await rest.measures(run.id);
      if (run === this.#run) this.#list(found);
    } catch (error) {
      if (run === this.#run) this.part("measures-note").replaceChildren(...saidOf(error));
    }
  }

  #list(found) {
    const all = Object.values(found.parts);
    this.part("measures-note").replaceChildren(
      texts.board.measured(all.filter((measure) => measure.presence != null).length, all.length, found.good_boards.length));
    this.part("measures-remarks").replaceChildren(...found.remarks.map((remark, n) => make("li", {}, ...said(remarkText(found, n) ?? remark))));
    const doubts = doubtsOf(found.parts);
    const buttons = doubts.slice(0, MOST_DOUBTS).map(([address, word]) => this.#button(address, `${address}: ${word}`));
    const more = doubts.length > MOST_DOUBTS ? [texts.board.moreDoubts(doubts.length - MOST_DOUBTS)] : [];
    this.part("doubts").replaceChildren(...(buttons.length ? [make("b", { textContent: texts.board.doubts }), ...buttons, ...more] : [texts.board.noDoubts]));
    this.choose(this.#chosen);
    this.#onMeasured({ measures: found.parts, reason_texts: found.reason_texts });
  }

  #button(address, textContent) {
    const button = make("button", { type: "button", textContent, onclick: () => this.#onPart(address) });
    button.dataset.address = address;
    return button;
  }

  // Choose the part in doubt that comes next in the list, or before.
  step(by) {
    const all = [...this.part("doubts").querySelectorAll("button")];
    const at = all.findIndex((button) => button.dataset.address === this.#chosen);
    if (all.length) this.#onPart(all[at < 0 && by < 0 ? all.length - 1 : (at + by + all.length) % all.length].dataset.address);
  }

  // Mark a part in the list, if it is there.
  choose(address) {
    this.#chosen = address;
    const buttons = [...this.part("doubts").querySelectorAll("button")];
    const here = buttons.find((button) => button.dataset.address === address);
    for (const button of buttons) {
      button.setAttribute("aria-pressed", button === here);
      button.tabIndex = button === (here ?? buttons[0]) ? 0 : -1;
    }
  }

  async #teach() {
    const [run, was, answer] = [this.#run, this.#isGood(), this.part("good-answer")];
    this.part("good").disabled = true;
    answer.replaceChildren(texts.board.teaching);
    try {
      const reply = await (was ? rest.removeFromGood(run.id) : rest.keepAsGood(run.id));
      if (run !== this.#run) return;
      this.#offer(reply.boards);
      answer.replaceChildren(was ? texts.board.removed(reply.boards.length) : texts.board.keptAsGood(reply.boards.length), ...this.#doubtsOf(reply));
      if (reply.boards.length) await this.#ask();
      else this.part("measures-note").replaceChildren(texts.board.noGoodBoards);
    } catch (error) {
      if (run === this.#run) answer.replaceChildren(...saidOf(error));
    } finally {
      this.part("good").disabled = false;
    }
  }

  // What speaks against the board, or against another good one, for the person to look at.
  #doubtsOf({ absent, disagreements }) {
    const lines = [
      ...absent.map((address) => this.#button(address, texts.board.wasAbsent(address))),
      ...disagreements.map(({ board, part }) => (board === this.#run.id ? this.#button(part, texts.board.disagrees(part))
        : make("a", { className: "button", href: `#/board/${encodeURIComponent(board)}?${new URLSearchParams({ component: part })}`, textContent: texts.board.otherDisagrees(part, board) }))),
    ];
    return lines.length ? [make("p", { textContent: texts.board.lookAt }), ...lines] : [];
  }
}
