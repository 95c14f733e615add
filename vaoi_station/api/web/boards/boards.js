// The list of boards: filters that the station applies, reasons, decisions, and a file for spreadsheets.
import { make, options, saidOf, setText, View } from "../parts/elements.js";
import { saveTable } from "../parts/files.js";
import { readId } from "../parts/identity.js";
import * as rest from "../parts/rest.js";
import { sign } from "../parts/signs.js";
import { language, moment, number, texts } from "../texts/texts.js";

const PAGE_RUNS = 100;
const MOST_SAVED = 5000; // boards in one file
// First and last midnight of each span, in days from today's; null: open.
const SPANS = { any: [null, null], today: [0, null], yesterday: [-1, 0], week: [-6, null] };
const FILTERS = ["since", "until", "board_type", "verdict", "board_id", "reason"];
const PART = `
<form id="filters">
  <label><span data-text="span"></span><select id="span"></select></label>
  <label><span data-text="from"></span><input type="datetime-local" name="since"></label>
  <label><span data-text="to"></span><input type="datetime-local" name="until"></label>
  <label><span data-text="boardType"></span><select name="board_type"></select></label>
  <label><span data-text="verdict"></span><select name="verdict"></select></label>
  <label><span data-text="boardId"></span><input name="board_id" maxlength="200" spellcheck="false"></label>
  <label><span data-text="reason"></span><select name="reason"></select></label>
  <button data-text="show"></button>
  <button type="button" id="save" data-text="csv"></button>
</form>
<p id="list-answer" role="alert"></p>
<div id="list" tabindex="0"><table><thead></thead><tbody></tbody></table></div>
<button type="button" id="more" data-text="more" hidden></button>`;

// A figure of a run, as the trends name it.
const figure = (name, digits) => (run) => (run.figures?.[name] == null ? "" : number(run.figures[name], digits));

// The largest of the seams, each of which is a figure of its own.
function worstSeam({ figures }) {
  const seams = Object.entries(figures ?? {}).filter(([name]) => name.startsWith("seam_px:"));
  return seams.length ? number(Math.max(...seams.map(([, px]) => px)), 3) : "";
}

const codesOf = (run) => [...new Set(run.reasons.map((reason) => reason.cause || reason.code))];

// What each column shows of a run, as text. The file has the same: of reasons the codes, which no language and no version changes.
const COLUMNS = {
  started: (run) => moment(run.started),
  board_id: (run) => run.board_id ?? "",
  verdict: (run) => texts.verdicts[run.verdict ?? (run.finished ? "failed" : "none")],
  reasons: (run) => codesOf(run).join(", "),
  frames: (run) => texts.framesOf(run.counts.ok, run.rows * run.cameras),
  unseen_parts: figure("unseen_parts", 0),
  sigma_px: figure("sigma_px", 3),
  residual_px: figure("residual_px", 3),
  seam_px: worstSeam,
  slip_percent: figure("slip_percent", 2),
  ready_ms: (run) => (run.timings?.ready_after_last_frame_ms == null ? "" : number(run.timings.ready_after_last_frame_ms)),
  board_type: (run) => run.board_type,
  read_id: (run) => readId(run.identity),
  decision: (run) => (run.decision ? `${texts.decided[run.decision.choice](run.decision.name)}: ${run.decision.reason}` : ""),
};

// Reasons in words; the code of each is beside it.
const reasonsOf = (run) => codesOf(run).map((code) => make("p", { textContent: texts.reasons[code] ?? code, title: code }));

const option = (value, textContent = value, title = "") => make("option", { value, textContent, title });

// The picture that is kept of a board, as small as it is shown; a run without one has none.
function thumbnail(run) {
  const picture = make("img", { src: rest.keptPicture(run, 72 * Math.ceil(devicePixelRatio)), alt: "", loading: "lazy", width: 72, height: 48 });
  picture.addEventListener("error", () => picture.remove());
  return make("td", { className: "thumbnail" }, picture);
}

export class BoardsView extends View {
  name = "boards-view";
  #query;
  #next = null;
  #turn = 0; // counts the readings: a later one, or the end of the view, ends the one before

  constructor(_station, query) {
    super(PART, make("div", { className: "boards" }));
    this.#query = new URLSearchParams(query);
    const verdicts = { "": texts.any, ok: texts.verdicts.ok, degraded: texts.verdicts.degraded, failed: texts.verdicts.failed, none: texts.noVerdict };
    this.#field("verdict").append(...options(Object.entries(verdicts)));
    this.#field("board_type").append(option("", texts.any));
    const reasons = Object.entries(texts.reasons).sort(([, a], [, b]) => a.localeCompare(b, language));
    this.#field("reason").append(option("", texts.any), ...reasons.map(([code, text]) => option(code, text, code)));
    this.part("span").append(...options(Object.entries(texts.spans)));
    this.part("span").addEventListener("change", () => this.#fillSpan());
    for (const name of ["since", "until"]) this.#field(name).addEventListener("input", () => (this.part("span").value = "other"));
    const heads = Object.keys(COLUMNS).map((name) => make("th", { scope: "col", className: name, textContent: texts.columns[name], title: texts.trends.figures[name] ?? "" }));
    this.root.querySelector("thead").append(make("tr", {}, make("td"), ...heads));
    this.part("filters").addEventListener("submit", (event) => {
      event.preventDefault();
      const hash = `#/boards?${this.#stated()}`;
      if (hash === location.hash) this.#again();
      else location.hash = hash;
    });
    this.part("more").addEventListener("click", () => this.#load());
    this.part("save").addEventListener("click", () => this.#save());
  }

  #field(name) {
    return this.root.querySelector(`[name="${name}"]`);
  }

  // A span of days fills in its times, and its boards are shown at once. A day begins at midnight of this browser.
  #fillSpan() {
    const span = this.part("span").value;
    if (span === "other") {
      this.#field("since").focus();
      return;
    }
    const [since, until] = SPANS[span];
    this.#field("since").value = since === null ? "" : local(midnight(since));
    this.#field("until").value = until === null ? "" : local(midnight(until));
    this.part("filters").requestSubmit();
  }

  // The filters of the form; times become UTC.
  #stated() {
    const query = new URLSearchParams();
    for (const name of FILTERS) {
      const value = this.#field(name).value.trim();
      if (value) query.set(name, name === "since" || name === "until" ? new Date(value).toISOString() : value);
    }
    return query;
  }

  async open() {
    const chosen = this.#query.get("board_type");
    if (chosen) this.#field("board_type").append(option(chosen));
    const reason = this.#query.get("reason"); // a link may have the code of another version of the station
    if (reason && !(reason in texts.reasons)) this.#field("reason").append(option(reason));
    for (const name of FILTERS) {
      const value = this.#query.get(name) ?? "";
      this.#field(name).value = value && (name === "since" || name === "until") ? local(value) : value;
    }
    const [since, until] = [this.#field("since").value, this.#field("until").value];
    const stated = (days) => (days === null ? "" : local(midnight(days)));
    this.part("span").value = Object.keys(SPANS).find((name) => stated(SPANS[name][0]) === since && stated(SPANS[name][1]) === until) ?? "other";
    // Only then the types are asked for: what a person chooses meanwhile stays.
    const types = await rest.boardTypes().catch(() => []);
    this.#field("board_type").append(...types.map((type) => type.name).filter((name) => name !== chosen).map((name) => option(name)));
    await this.#load();
  }

  async #page(before, limit) {
    const query = { limit, figures: true };
    for (const name of FILTERS) if (this.#query.get(name)) query[name] = this.#query.get(name);
    if (before) query.before = before;
    return rest.runs(query);
  }

  #again() {
    this.#next = null;
    this.root.querySelector("tbody").replaceChildren();
    this.#load();
  }

  async #load() {
    const more = this.part("more");
    const turn = ++this.#turn;
    more.disabled = true;
    try {
      let found;
      do {
        found = await this.#page(this.#next, PAGE_RUNS);
        if (turn !== this.#turn) return;
        this.#next = found.next ?? null;
        if (!found.runs.length && this.#next) setText(this.part("list-answer"), texts.searching);
      } while (!found.runs.length && this.#next); // one request looks through a bounded number of runs
      this.root.querySelector("tbody").append(...found.runs.map((run) => this.#row(run)));
      setText(this.part("list-answer"), this.root.querySelector("tbody").children.length ? "" : texts.nothingFound);
    } catch (error) {
      if (turn !== this.#turn) return;
      this.#next = null;
      this.part("list-answer").replaceChildren(...saidOf(error));
    }
    more.disabled = false;
    more.hidden = !this.#next;
  }

  #row(run) {
    const verdict = run.verdict ?? (run.finished ? "failed" : "none");
    const cells = Object.entries(COLUMNS).map(([name, text]) => {
      const cell = make("td", { className: name, textContent: ["started", "reasons"].includes(name) ? "" : text(run) });
      if (name === "started") cell.append(make("a", { href: `#/board/${encodeURIComponent(run.id)}`, textContent: text(run) }));
      if (name === "reasons") cell.append(...reasonsOf(run));
      if (name === "verdict") cell.prepend(sign(verdict));
      return cell;
    });
    return make("tr", { className: verdict }, thumbnail(run), ...cells);
  }

  async #save() {
    const boards = [];
    let before = null;
    try {
      do {
        const { runs, next } = await this.#page(before, 500);
        boards.push(...runs.map((run) => [run.started, ...Object.entries(COLUMNS).slice(1).map(([, text]) => text(run))]));
        before = next;
      } while (before && boards.length < MOST_SAVED);
    } catch (error) {
      this.part("list-answer").replaceChildren(...saidOf(error));
      return;
    }
    const cut = before || boards.length > MOST_SAVED;
    setText(this.part("list-answer"), cut ? texts.cut(number(MOST_SAVED)) : "");
    saveTable("boards.csv", [Object.keys(COLUMNS), ...boards.slice(0, MOST_SAVED)]);
  }

  close() {
    this.#turn++;
  }
}

// Midnight of today plus `days` days, also where a day of summer time has not 24 hours.
function midnight(days) {
  const now = new Date();
  return new Date(now.getFullYear(), now.getMonth(), now.getDate() + days);
}

// The value of a field for local time.
function local(time) {
  const date = new Date(time);
  return new Date(date - date.getTimezoneOffset() * 60_000).toISOString().slice(0, 16);
}
