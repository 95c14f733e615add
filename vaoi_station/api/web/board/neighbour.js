// One part beside that of the most similar good board, with their difference, and the limits by which its measures are marked.
import { make, options, saidOf, setText, View } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { number, texts } from "../texts/texts.js";

const MOST_NAMED = 8;
const LIMITS = ["presence", "orientation", "alike", "dx_mm", "dy_mm", "turn_deg", "least_height_mm", "most_height_mm"];
const PART = `
<p id="beside-good"></p>
<div id="trios"></div>
<details id="limits"><summary data-text="board.limits"></summary>
  <form>
    <label><span data-text="board.limitOf"></span><select id="limited"></select></label>
    <label><span data-text="board.limitFor"></span><select id="level"></select></label>
    <label><span data-text="board.limitValue"></span><input id="limit" type="number" step="any" min="0"></label>
    <button data-text="board.wouldMark"></button><button type="button" id="set-limit" data-text="board.setLimit"></button>
  </form>
  <p id="limit-answer" role="status"></p>
  <ul id="limit-marks"></ul>
</details>`;

const boardLink = (run, component, textContent) => make("a", { href: `#/board/${encodeURIComponent(run)}?${new URLSearchParams({ component })}`, textContent });

export class Neighbour extends View {
  #run = null;
  #part = null;
  #limits = {}; // those that apply to the part

  constructor(root) {
    super(PART, root);
    root.hidden = true;
    this.part("limited").append(...options(LIMITS.map((name) => [name, texts.board.limitNames[name]])));
    this.part("limited").addEventListener("change", () => this.#showLimit());
    this.part("limits").addEventListener("toggle", () => rest.unattended(this.#showLevels()));
    root.querySelector("form").addEventListener("submit", (event) => {
      event.preventDefault();
      rest.unattended(this.#try(rest.checkLimits));
    });
    this.part("set-limit").addEventListener("click", () => rest.unattended(this.#try(rest.setLimits, texts.board.limitSet)));
  }

  // Show a part of a run whose parts are measured.
  async show(run, part) {
    if (run === this.#run && part === this.#part) return;
    [this.#run, this.#part] = [run, part];
    this.part("level").replaceChildren(); // a limit is set for the part of which the form speaks
    const found = await rest.measuredPart(run.id, part.address).catch(() => null); // without it, all else of the part is shown
    if (run !== this.#run || part !== this.#part) return; // overtaken by a later choice
    this.root.hidden = !found;
    if (!found) return;
    const { views, good } = found;
    this.part("beside-good").replaceChildren(part.address, ...(good ? [` ${texts.board.besideGood} `, boardLink(good, part.address, good)] : [`: ${texts.board.noGoodPart}`]));
    this.part("trios").replaceChildren(...views.flatMap((view) => ["part", "good", "difference"].filter((what) => view[what]).map((what) => this.#figure(view, what))));
    this.#limits = found.limits;
    this.#showLimit();
    setText(this.part("limit-answer"), "");
    this.part("limit-marks").replaceChildren();
    if (this.part("limits").open) await this.#showLevels();
  }

  #figure(view, what) {
    const name = texts.board.trio[what];
    const facts = what === "part" ? [view.light, `${number(view.exposure)} µs`] : [];
    return make("figure", { className: what }, make("img", { src: view[what], alt: `${this.#part.address}, ${name}` }), make("figcaption", { textContent: [name, ...facts].filter(Boolean).join(", ") }));
  }

  #showLimit() {
    this.part("limit").value = this.#limits[this.part("limited").value] ?? "";
  }

  // A limit is set for this part, for its package if the board type states one, or for every part.
  async #showLevels() {
    if (!this.part("limits").open) return;
    const part = this.#part;
    const type = await rest.boardType(this.#run.board_type);
    if (part !== this.#part) return;
    const named = type.components.find((component) => component.ref === part.ref)?.package;
    const levels = [["parts", texts.board.thisPart(part.address)], ...(named ? [["packages", named]] : []), ["every", texts.board.everyPart]];
    this.part("level").replaceChildren(...options(levels));
    this.part("level").dataset.package = named ?? "";
  }

  // Check limits with the one of the form, or set them; both say what it would have marked. An empty value is no limit.
  async #try(send, done = "") {
    const [type, name, level, value] = [this.#run.board_type, this.part("limited").value, this.part("level").value, this.part("limit").value];
    const key = { parts: this.#part.address, packages: this.part("level").dataset.package }[level];
    if (!level) return;
    try {
      const limits = await rest.limits(type);
      const group = key ? (limits[level] ??= {}) : limits;
      group[key ?? level] = { ...group[key ?? level], [name]: value === "" ? null : Number(value) };
      const found = await send(type, limits);
      setText(this.part("limit-answer"), `${done} ${texts.board.marks(found.marked_parts, found.marked_runs, found.runs)}`.trim());
      this.part("limit-marks").replaceChildren(...found.marked.slice(0, MOST_NAMED).map((one) => make("li", {}, boardLink(one.run, one.part, `${one.run}: ${one.part}`))));
    } catch (error) {
      this.part("limit-answer").replaceChildren(...saidOf(error));
    }
  }
}
