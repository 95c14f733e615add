// The neighbours in the line: who is there, which boards wait for the next machine, and what was said last.
import { make, setText, showLines, View } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { clock, texts } from "../texts/texts.js";

const AGAIN_MS = 2000;
const SHOWN = 8; // messages
const PART = `
<h2 data-text="neighbours"></h2>
<ul id="neighbour-list"></ul>
<ol id="waiting-boards"></ol>
<ol id="line-messages" lang="en"></ol>`;

const textOf = (message) => `${clock(message.time)} ${message.sent ? "→" : "←"} ${texts.sides[message.side]}: ${message.text}${message.fault ? ` (${message.fault})` : ""}`;

export class Neighbours extends View {
  #askedAt = -AGAIN_MS;
  #none = false;
  #sure = null; // the board of which the button was pressed once

  constructor(root) {
    super(PART, root);
    root.hidden = true;
  }

  async tick() {
    if (this.#none || performance.now() - this.#askedAt < AGAIN_MS) return;
    this.#askedAt = performance.now();
    await rest.unattended(rest.neighbours().then((status) => this.#show(status)));
  }

  #show({ role, neighbours, boards, messages, contacts }) {
    this.#none = role === "none";
    this.root.hidden = this.#none;
    showLines(this.part("neighbour-list"), [...neighbours.map(texts.neighbour), ...(contacts ? texts.contacts(contacts) : [])]);
    showLines(this.part("line-messages"), messages.slice(-SHOWN).reverse().map(textOf));
    const waiting = [...boards.map((board) => [board.board_id, texts.waitingBoard(board)]), ...(contacts?.boards ?? []).map((board) => [board.name, texts.waitsByContact(board)])];
    const wanted = JSON.stringify([waiting, this.#sure]);
    const list = this.part("waiting-boards");
    if (wanted === list.dataset.shown) return;
    list.dataset.shown = wanted;
    list.replaceChildren(...waiting.map(([id, text]) => this.#line(id, text)));
  }

  // Pressed twice, so that a touch in passing does not make the station forget a board.
  #line(board, text) {
    const button = make("button", { type: "button" });
    setText(button, this.#sure === board ? texts.reallyOut : texts.boardIsOut);
    button.addEventListener("click", () => this.#press(board));
    return make("li", {}, `${text} `, button);
  }

  async #press(board) {
    const sure = this.#sure === board;
    this.#sure = sure ? null : board;
    await rest.unattended((sure ? rest.boardIsOut(board) : rest.neighbours()).then((status) => this.#show(status)));
  }
}
