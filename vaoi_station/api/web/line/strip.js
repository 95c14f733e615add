// The last twenty boards as signs, with those that were missed, and the counts of the day.
import { make } from "../parts/elements.js";
import { sign } from "../parts/signs.js";
import { clock, number, texts } from "../texts/texts.js";

export class Strip {
  #root;
  #shown = "";

  constructor(root) {
    this.#root = root;
    root.append(
      make("h2", { id: "strip-title", textContent: texts.strip }),
      make("ol", { id: "strip" }),
      make("dl", { id: "counts" }),
    );
  }

  show(boards) {
    const entries = boards.strip;
    const wanted = JSON.stringify([entries.map((e) => [e.time, e.run?.verdict, e.run?.decision?.choice]), boards.counts]);
    if (wanted === this.#shown) return;
    this.#shown = wanted;
    this.#root.querySelector("#strip").replaceChildren(...entries.map((entry) => this.#entry(entry)));
    const counts = boards.counts;
    const cells = counts ? Object.entries(texts.counts).flatMap(([key, text]) => [
      make("dd", { className: `count-${key}${counts[key] ? "" : " zero"}`, textContent: number(counts[key]) }),
      make("dt", { textContent: text }),
    ]) : [];
    this.#root.querySelector("#counts").replaceChildren(make("dt", { className: "today", textContent: texts.today }), ...cells);
  }

  #entry({ time, run }) {
    const what = run ? `${run.board_id ?? texts.noId}: ${texts.verdicts[run.verdict ?? "failed"]}` : texts.missedBoard;
    const name = `${clock(time)} ${what}`;
    const item = make("li", { className: run ? run.verdict ?? "failed" : "missed" });
    const named = { title: name, ariaLabel: name };
    const inside = run ? make("a", { href: `#/board/${encodeURIComponent(run.id)}`, ...named }) : make("span", { role: "img", ...named });
    inside.append(sign(item.className));
    item.append(inside);
    return item;
  }
}
