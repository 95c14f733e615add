// Why are they worse than yesterday: which figures changed between two spans by more than their spread.
import { make, options, setText, View } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { moment, number, texts } from "../texts/texts.js";

const HOUR_MS = 3_600_000;
const DAY_MS = 24 * HOUR_MS;
const MOST_SHOWN = 8;
const FULL_SPREADS = 6; // a change of this size fills its bar

const PART = `
<div class="compare-head">
  <h2 data-text="trends.compare"></h2>
  <select id="compare-choice" data-label="trends.compare"></select>
</div>
<p id="trend-compare-answer" role="status"></p>
<ol id="changes"></ol>`;

export class Comparison extends View {
  #marks = [];
  #type = "";
  #wanted; // the choice of the person, or of the address: its mark may not have come yet
  #asked = 0;

  // onChosen(changes): a person has chosen which spans are compared.
  constructor(choice, onChosen) {
    super(PART, make("section", { id: "trend-compare" }));
    this.choice = this.part("compare-choice");
    this.choice.addEventListener("change", () => {
      this.#wanted = this.choice.value;
      rest.unattended(this.#show().then((changes) => changes && onChosen(changes)));
    });
    this.#wanted = choice;
    this.#offer();
  }

  // `marks`: what changed in the span that is shown; each may be compared with before. Returns the changes, the largest first.
  async show(marks, type) {
    [this.#marks, this.#type] = [marks, type];
    this.#offer();
    return this.#show();
  }

  #offer() {
    const marks = this.#marks.map((mark) => [mark.time, texts.trends.sinceMark(texts.trends.kinds[mark.kind], moment(mark.time))]);
    this.choice.replaceChildren(...options([...Object.entries(texts.trends.choices), ...marks]));
    this.choice.value = this.#wanted;
    if (!this.choice.value) this.choice.value = "day";
  }

  // The spans in ms: that before, and that now.
  #spans() {
    const now = Date.now();
    const midnight = new Date().setHours(0, 0, 0, 0);
    const yesterday = new Date(midnight - HOUR_MS).setHours(0, 0, 0, 0);
    const known = { day: [yesterday, midnight, midnight, now], hour: [now - 2 * HOUR_MS, now - HOUR_MS, now - HOUR_MS, now], week: [now - 14 * DAY_MS, now - 7 * DAY_MS, now - 7 * DAY_MS, now] };
    if (this.choice.value in known) return known[this.choice.value];
    const mark = Date.parse(this.choice.value);
    return [2 * mark - now, mark, mark, now];
  }

  async #show() {
    const asked = ++this.#asked;
    const [before_since, before_until, since, until] = this.#spans().map((ms) => new Date(ms).toISOString());
    const query = { before_since, before_until, since, until, ...(this.#type ? { board_type: this.#type } : {}) };
    const found = await rest.trendComparison(query);
    if (asked !== this.#asked) return null; // overtaken by a later choice
    const changed = found.changes.filter((change) => change.changed);
    const words = texts.trends;
    const sizes = words.versus(words.boards(found.before_boards), found.boards);
    const said = !found.changes.length ? words.few : changed.length ? words.changed(changed.length) : words.unchanged;
    setText(this.part("trend-compare-answer"), `${said} (${sizes})`);
    this.part("changes").replaceChildren(...changed.slice(0, MOST_SHOWN).map((change) => this.#row(change)));
    return found.changes;
  }

  #row(change) {
    const words = texts.trends;
    const said = change.worse == null ? words.other : change.worse ? words.worse : words.better;
    const digits = change.figure.endsWith("_px") ? 3 : 1;
    const bar = make("span", { className: "change-bar" }, make("span", {}));
    bar.firstChild.style.width = `${Math.min(change.spreads / FULL_SPREADS, 1) * 100}%`;
    const name = make("a", { href: `#chart-${change.figure}`, textContent: `${words.figures[change.figure]}${change.part ? ` ${change.part}` : ""}` });
    name.addEventListener("click", (event) => {
      event.preventDefault(); // the address is that of the view
      document.getElementById(`chart-${change.figure}`)?.querySelector(".chart-area").focus();
    });
    return make("li", { className: change.worse ? "worse" : "" },
      name,
      make("span", { className: "change-values", textContent: `${number(change.before.middle, digits)} → ${number(change.now.middle, digits)} ${words.units[change.figure]}` }),
      bar,
      make("span", { className: "change-spreads", textContent: words.spreads(number(change.spreads, 1)) }),
      make("span", { className: "change-word", textContent: said }));
  }
}
