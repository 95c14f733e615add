// How the figures of boards develop: a chart per figure, that which moved most first, what changed meanwhile, and the comparison of two
// spans.
import { make, options, saidOf, setText, View } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { stateShown } from "../parts/settings.js";
import { duration, moment, texts } from "../texts/texts.js";
import { Chart, TimeAxis } from "./chart.js";
import { Comparison } from "./comparison.js";

const SPANS_H = { hours: 8, day: 24, week: 7 * 24, month: 30 * 24, year: 365 * 24 };
const POINTS = 400;
const AGAIN_MS = 20_000; // at most so often the charts follow new boards
const PART = `
<form id="trend-tools">
  <label><span data-text="trends.span"></span><select name="span"></select></label>
  <label><span data-text="boardType"></span><select name="board_type"></select></label>
  <p id="trend-answer" role="status"></p>
</form>
<div id="trend-top"></div>
<div id="time-axis"></div>
<div id="charts"></div>
<p id="trend-help" data-text="trends.help"></p>`;

// Bring the values of a series to their times; between them are gaps.
function spread(series, count) {
  for (const name of ["values", "least", "largest", "runs"]) {
    if (!series[name]) continue;
    const column = new Array(count).fill(null);
    series.at.forEach((n, k) => (column[n] = series[name][k]));
    series[name] = column;
  }
}

export class TrendsView extends View {
  name = "trends-view";
  #axis = new TimeAxis();
  #charts = new Map();
  #order = []; // figures, that which moved most first
  #query;
  #asked = 0;
  #due = 0;

  constructor(_station, query) {
    super(PART, make("div", { className: "trends" }));
    this.#query = new URLSearchParams(query);
    this.comparison = new Comparison(this.#query.get("compare") ?? "day", (changes) => this.#arrange(changes));
    this.marks = make("section", { id: "marks" });
    this.part("trend-top").append(this.comparison.root, this.marks);
    this.part("time-axis").append(this.#axis.root);
    this.#field("span").append(...options(Object.entries(texts.trends.spans)));
    this.#field("span").value = this.#query.get("span") in SPANS_H ? this.#query.get("span") : "day";
    this.#field("board_type").append(make("option", { value: "", textContent: texts.any }));
    this.root.querySelector("form").addEventListener("change", () => {
      stateShown("#/trends", this.#stated()); // a link reproduces the view
      rest.unattended(this.#load());
    });
    this.root.querySelector("form").addEventListener("submit", (event) => event.preventDefault());
    this.comparison.choice.addEventListener("change", () => stateShown("#/trends", this.#stated()));
  }

  #field(name) {
    return this.root.querySelector(`[name="${name}"]`);
  }

  #stated() {
    const stated = { span: this.#field("span").value, board_type: this.#field("board_type").value, compare: this.comparison.choice.value };
    return new URLSearchParams(Object.entries(stated).filter(([, value]) => value));
  }

  async open() {
    const types = await rest.boardTypes().catch(() => []);
    const chosen = this.#query.get("board_type") ?? "";
    const names = new Set([...types.map((type) => type.name), ...(chosen ? [chosen] : [])]);
    this.#field("board_type").append(...options([...names].map((name) => [name, name])));
    this.#field("board_type").value = chosen;
    await rest.unattended(this.#load());
  }

  close() {
    clearTimeout(this.#due);
    this.#due = -1;
    this.#axis.close();
    for (const chart of this.#charts.values()) chart.close();
  }

  onEvent(event) {
    if (event.kind !== "run" || this.#due) return;
    this.#due = setTimeout(() => {
      this.#due = 0;
      rest.unattended(this.#load(true));
    }, AGAIN_MS);
  }

  // `again`: new boards have come, and the charts stay where they are.
  async #load(again = false) {
    const asked = ++this.#asked;
    const until = new Date(Date.now() + 1000);
    const since = new Date(until - SPANS_H[this.#field("span").value] * 3_600_000);
    const type = this.#field("board_type").value;
    const query = { since: since.toISOString(), until: until.toISOString(), points: POINTS, ...(type ? { board_type: type } : {}) };
    let found;
    try {
      found = await rest.trends(query);
    } catch (error) {
      this.part("trend-answer").replaceChildren(...saidOf(error));
      return;
    }
    if (asked !== this.#asked) return; // overtaken by a later choice
    found.series.forEach((series) => spread(series, found.times.length));
    this.#say(found);
    // Without boards nothing is known of what changed, and there are no charts to move in.
    this.marks.hidden = !found.boards && !found.marks.length;
    this.part("trend-help").hidden = !found.boards;
    this.#showMarks(found.marks);
    const [changes] = await Promise.all([this.comparison.show(found.marks, type), this.#showCharts(found), this.#axis.show(found)]);
    if (!again && changes) this.#arrange(changes);
    this.root.dataset.shown = asked;
  }

  #say(found) {
    const words = texts.trends;
    const each = found.bin_s == null ? words.perBoard : words.perBin(duration(found.bin_s));
    const text = found.boards ? `${words.boards(found.boards)}, ${each}.` : words.none;
    setText(this.part("trend-answer"), found.complete ? text : `${text} ${words.incomplete}`);
  }

  #showMarks(marks) {
    const words = texts.trends;
    const lines = marks.map((mark) => {
      const state = mark.kind === "restart" ? (time) => time && moment(time) : short;
      const text = words.mark(words.kinds[mark.kind], mark.board_type, state(mark.before), state(mark.after));
      return make("li", {}, make("a", { href: `#/board/${encodeURIComponent(mark.run)}`, textContent: moment(mark.time) }), ` ${text}`);
    });
    const list = lines.length ? make("ol", {}, ...lines.reverse()) : make("p", { textContent: words.noMarks });
    this.marks.replaceChildren(make("h2", { textContent: words.marks }), list);
  }

  #sorted(names) {
    const place = (name) => (this.#order.includes(name) ? this.#order.indexOf(name) : Infinity);
    return names.map((name, n) => [place(name), n, name]).sort((a, b) => (a[0] === b[0] ? a[1] - b[1] : a[0] - b[0])).map(([, , name]) => name);
  }

  // Put the figure first that moved most between the spans that are compared.
  #arrange(changes) {
    this.#order = [...new Set(changes.map((change) => change.figure))];
    this.part("charts").append(...this.#sorted([...this.#charts.keys()]).map((name) => this.#charts.get(name).root));
  }

  async #showCharts(found) {
    const names = this.#sorted([...new Set(found.series.map((series) => series.figure))]);
    for (const [name, chart] of this.#charts) if (!names.includes(name)) chart.close();
    this.#charts = new Map(names.map((name) => [name, this.#charts.get(name) ?? new Chart(name)]));
    const [charts, place] = [[...this.#charts.values()], this.part("charts")];
    const roots = charts.map((chart) => chart.root);
    // Charts that are there already stay in their place, with the focus of the keyboard.
    for (const there of [...place.children]) if (!roots.includes(there)) there.remove();
    roots.forEach((root, n) => root !== place.children[n] && place.insertBefore(root, place.children[n] ?? null));
    await Promise.all(names.map((name, n) => charts[n].show(found, found.series.filter((series) => series.figure === name))));
  }
}

const short = (text) => (text.length > 60 ? `${text.slice(0, 59)}…` : text);
