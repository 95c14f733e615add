// Beside the last board on wide screens: what was measured of it, the next orders and neighbours. On others neighbours below the page.
import { lines, make, View } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { number, texts } from "../texts/texts.js";
import { Neighbours } from "./neighbours.js";

const WIDE = matchMedia("(min-width: 1300px)"); // as line.css has it: on others no measures are asked for
const DIGITS = { sigma_px: 3, ready_ms: 0 };
const PART = `
<h2 data-text="lastMeasures"></h2>
<dl id="last-measures"></dl>
<h2 data-text="nextOrders"></h2>
<ol id="next-orders"></ol>
<div id="neighbours"></div>`;

// The figures of a run that has a result, as pairs of name and value.
function figuresOf(run) {
  const { ok, incomplete, missing, unproven } = run.counts;
  const { figures: names, units } = texts.trends;
  const known = Object.keys(DIGITS).filter((name) => run.figures?.[name] != null);
  return [
    [texts.facts.frames, texts.framesOf(ok, ok + incomplete + missing + unproven)],
    ...(run.verdict === "failed" ? [] : [[names.unseen_parts, number(run.unseen.length)]]),
    ...known.map((name) => [names[name], `${number(run.figures[name], DIGITS[name])} ${units[name]}`]),
  ];
}

export class Beside extends View {
  #run = null;
  #parts = [];

  constructor(root) {
    super(PART, root);
    this.neighbours = new Neighbours(this.part("neighbours"));
  }

  async showBoard(run) {
    if (!run || !WIDE.matches) return;
    const other = run.id !== this.#run?.id;
    const first = !this.#run; // of later boards the event "parts" says when they are measured
    if (other) this.#parts = [];
    this.#run = run;
    this.#show();
    if (first && run.verdict !== "failed") rest.unattended(this.measured(run.id)); // not awaited: the state must not wait for measures
  }

  // The parts of a run are measured: how many are in doubt. Without good boards there is nothing to ask for.
  async measured(id) {
    const run = this.#run;
    if (!WIDE.matches || run?.id !== id || !(await rest.goodBoards(run.board_type)).boards.length) return;
    const [{ doubtsOf }, found] = await Promise.all([import("../board/measures.js"), rest.measures(id)]);
    if (run !== this.#run) return; // overtaken by a later board
    this.#parts = [[texts.board.doubts, texts.framesOf(number(doubtsOf(found.parts).length), number(Object.keys(found.parts).length))]];
    this.#show();
  }

  #show() {
    this.part("last-measures").replaceChildren(...lines([...this.#parts, ...figuresOf(this.#run)]));
  }

  // The orders that wait, or without orders the type that the next boards are filmed as.
  showOrders({ orders = [], orders_waiting = 0, next_order, armed_with }) {
    const next = next_order ?? armed_with;
    const said = orders.length ? orders.map(texts.orderOf) : next ? [texts.orderOf(next)] : [texts.noOrder];
    const more = orders_waiting > orders.length ? [texts.moreOrders(orders_waiting - orders.length)] : [];
    this.part("next-orders").replaceChildren(...[...said, ...more].map((textContent) => make("li", { textContent })));
  }
}
