// One board: the whole board to zoom into, the pictures of its parts, the report, the times of its steps, and files to take.
import { boardAsked, boardId } from "../ahead.js";
import { Decisions } from "../parts/decisions.js";
import { arrowKeys, make, saidOf, setText, View } from "../parts/elements.js";
import { boardAdvice } from "../parts/orders.js";
import * as rest from "../parts/rest.js";
import { draw } from "../parts/signs.js";
import { texts } from "../texts/texts.js";
import { Comparison, shownMosaics } from "./comparison.js";
import { showExports } from "./exports.js";
import { Measures } from "./measures.js";
import { Neighbour } from "./neighbour.js";
import { PageState } from "./page_state.js";
import { Pictures } from "./pictures.js";
import { showRawFrames } from "./raw_frames.js";
import { FirstReason } from "./first_reason.js";
import { showReport } from "./report.js";
import { showSideLinks } from "./side_links.js";
import { timing } from "./timing.js";
import { ZoomSide } from "./zoom.js";

const TABS = ["part", "report", "timing", "export"];
const PICTURE_FIRST_MS = 1000; // as long is the picture waited for: a first one, which must be planned, takes seconds
const NARROW = matchMedia("(max-width: 1100px)"); // as board.css has it
const PART = `
<section id="head">
  <svg id="verdict-shape" viewBox="0 0 100 100" aria-hidden="true"></svg>
  <h2 id="board-title" data-text="board.loading"></h2>
  <p id="board-order"></p>
  <div id="decisions"></div>
  <nav id="sides-of-board" data-label="board.sides.both" hidden></nav>
  <nav id="boards-beside" data-label="board.neighbours"></nav>
  <a href="#/boards" id="all-boards" class="button" data-text="back"></a>
</section>
<section id="first-reason"></section>
<section id="zoom" data-label="mosaic"></section>
<section id="raw" data-label="board.rawFrames" hidden></section>
<section id="side">
  <div id="tabs" role="tablist" data-label="board.tabs"></div>
  <div id="tab-part" role="tabpanel"><div id="measures"></div><div id="neighbour"></div><div id="compare"></div><div id="part"></div></div>
  <div id="tab-report" role="tabpanel" hidden></div>
  <div id="tab-timing" role="tabpanel" hidden></div>
  <div id="tab-export" role="tabpanel" hidden></div>
</section>`;

export class BoardView extends View {
  name = "board-view";
  #id;
  #state;
  #run = null;
  #seen = "";
  #shown = { parts: [], mosaics: [], overlay: null, heights: null, measures: null };
  #zoom;
  #pictures;
  #comparison;
  #measures;
  #decisions;
  #reason;
  #neighbour;
  #opening = null;
  #closed = new AbortController();

  constructor(_station, id, query) {
    super(PART, make("div", { className: "board" }));
    this.#id = boardId(id);
    this.#state = new PageState(this.#id, query);
    this.#decisions = new Decisions(this.part("decisions"), () => rest.unattended(this.show()));
    this.#zoom = new ZoomSide(this.part("zoom"), this.#state, (address) => this.#choose(address));
    this.#pictures = new Pictures(this.part("part"), this.#state);
    this.#comparison = new Comparison(this.part("compare"), this.#state, (other) => this.#compare(other));
    this.#measures = new Measures(this.part("measures"), (address) => this.#choose(address), (found) => this.#showMeasured(found));
    this.#reason = new FirstReason(this.part("first-reason"), (place) => this.#lead(place));
    this.#neighbour = new Neighbour(this.part("neighbour"));
    this.#makeTabs();
    this.#placeTabs();
    document.addEventListener("keydown", (event) => this.#key(event), this.#closed);
    NARROW.addEventListener("change", () => this.#placeTabs(), this.#closed);
  }

  // With Alt: the part in doubt that comes next or before, the board that came later or earlier, and the other side.
  #key(event) {
    const part = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    const board = { PageDown: "later", PageUp: "earlier" }[event.key] ?? (event.code === "KeyS" ? "other-side" : null);
    if (!event.altKey || !(part || board) || event.target instanceof HTMLSelectElement) return;
    event.preventDefault();
    if (part) this.#measures.step(part);
    else this.part(board)?.click();
  }

  // Links to the boards that came before and after this one, shown as it is.
  async #showNeighbours(run) {
    const [{ runs }, later] = await Promise.all([rest.runs({ before: run.id, limit: 1 }), rest.nextRun(run.id)]);
    const link = (id, other, textContent, ariaKeyShortcuts) => {
      const title = `${texts.board[id]} (${ariaKeyShortcuts})`;
      const found = make("a", { id, className: "button", href: this.#state.of(other.id), textContent, title, ariaLabel: title, ariaKeyShortcuts });
      found.addEventListener("click", () => (found.href = this.#state.of(other.id))); // the view may have changed
      return found;
    };
    this.part("boards-beside").replaceChildren(...(runs.length ? [link("earlier", runs[0], "‹", "Alt+PageUp")] : []), ...(later ? [link("later", later, "›", "Alt+PageDown")] : []));
  }

  #makeTabs() {
    const tabs = TABS.map((name) => {
      const tab = make("button", { type: "button", id: `to-${name}`, textContent: texts.board.tab[name] });
      tab.setAttribute("role", "tab");
      tab.setAttribute("aria-controls", `tab-${name}`);
      this.part(`tab-${name}`).setAttribute("aria-labelledby", tab.id);
      this.part(`tab-${name}`).tabIndex = 0; // it is scrolled by keyboard
      tab.addEventListener("click", () => {
        this.#open(name);
        this.part(`tab-${name}`).scrollIntoView(); // on narrow screens it is below the whole board
      });
      return tab;
    });
    this.part("tabs").append(...tabs);
    arrowKeys(this.part("tabs"), () => tabs);
    this.#open(TABS.includes(this.#state.get("tab")) ? this.#state.get("tab") : TABS[0]);
  }

  // On narrow screens the tabs are above the whole board. They are also before it in the document, so that the tabulator goes from
  // top to bottom.
  #placeTabs() {
    const [tabs, focused] = [this.part("tabs"), document.activeElement];
    if (NARROW.matches) this.part("zoom").before(tabs);
    else this.part("side").prepend(tabs);
    if (tabs.contains(focused)) focused.focus();
  }

  #open(name) {
    this.#state.set({ tab: name });
    for (const tab of TABS) {
      const here = tab === name;
      this.part(`tab-${tab}`).hidden = !here;
      this.part(`to-${tab}`).setAttribute("aria-selected", here);
      this.part(`to-${tab}`).tabIndex = here ? 0 : -1;
    }
    if (name === "timing" && this.#run) rest.unattended(timing(this.part("tab-timing"), this.#run));
  }

  close() {
    this.#closed.abort();
    this.#zoom.close();
    this.#pictures.close();
    this.#comparison.close();
  }

  // The frame of the page has a view shown when it knows the state of the station. The picture needs not wait for that, and the first list
  // of mosaics not for the run.
  open() {
    this.#opening = rest.unattended(boardAsked(this.#id).then(({ run, list }) => this.#renew(run, list)));
  }

  async show() {
    await this.#opening;
    await this.#renew();
  }

  async #renew(asked = rest.run(this.#id), list = null) {
    let run;
    try {
      run = await asked;
    } catch (error) {
      if (!(error instanceof rest.Refusal)) throw error;
      this.root.classList.add("unknown");
      draw(this.part("verdict-shape"), "unknown");
      this.part("board-title").replaceChildren(...(error.status === 404 ? [texts.notFound] : saidOf(error)));
      return;
    }
    const seen = `${run.state} ${run.frames_available} ${run.recording} ${run.decision?.decided} ${JSON.stringify(run.identity)}`;
    if (seen === this.#seen) return;
    this.#seen = seen;
    this.#run = run;
    this.#showHead(run);
    // None of these is awaited by the state of the page.
    rest.unattended(this.#showBoard(run, list));
  }

  #showHead(run) {
    const verdict = run.verdict ?? (run.finished ? "failed" : "none");
    draw(this.part("verdict-shape"), verdict);
    this.part("head").dataset.verdict = verdict;
    this.#decisions.show(run);
    setText(this.part("board-title"), [`${run.board_id ?? texts.noId}: ${texts.verdicts[verdict]}`, texts.came[run.came]].filter(Boolean).join(", "));
    const decided = run.decision && `${texts.decided[run.decision.choice](run.decision.name)}: ${run.decision.reason}`;
    setText(this.part("board-order"), decided ?? (verdict === "ok" || verdict === "none" ? "" : boardAdvice(run)));
    this.#reason.show(run);
    showReport(this.part("tab-report"), run, { parts: [], overlay: null });
    // Without pictures the page opens on the reasons, beside the frames as they were filmed.
    const failed = verdict === "failed";
    this.part("zoom").hidden = this.part("to-part").hidden = failed;
    this.part("raw").hidden = !failed;
    if (failed && this.#state.get("tab") === "part") this.#open("report");
    if (failed) rest.unattended(showRawFrames(this.part("raw"), run));
    rest.unattended(this.#showNeighbours(run));
    rest.unattended(showSideLinks(this.part("sides-of-board"), run));
  }

  async #showBoard(run, list) {
    const result = run.verdict != null && run.verdict !== "failed";
    let refused = null;
    const mosaics = await shownMosaics(run, list).catch((error) => {
      refused = error;
      return [];
    });
    // The lists take the station as long as all tiles of the picture, which would have to share its processor with them.
    if (run === this.#run && mosaics.length) await Promise.race([this.#zoom.begin(mosaics).catch(() => {}), pause(PICTURE_FIRST_MS)]);
    if (run !== this.#run) return;
    const listed = result ? [rest.components(run.id).catch(() => []), rest.overlay(run.id).catch(() => null)] : [[], null];
    const [parts, overlay] = await Promise.all(listed);
    if (run !== this.#run) return; // its state has changed meanwhile
    this.#shown = { parts, mosaics, overlay, heights: null, measures: null };
    showReport(this.part("tab-report"), run, this.#shown);
    showExports(this.part("tab-export"), run, this.#shown);
    if (this.#state.get("tab") === "timing") rest.unattended(timing(this.part("tab-timing"), run));
    this.part("part").hidden = this.part("compare").hidden = this.part("measures").hidden = parts.length === 0;
    const asked = parts.some((part) => part.address === this.#state.get("component"));
    if (!asked) this.#state.set({ component: (largestSeen(parts) ?? parts[0])?.address ?? "" });
    await this.#zoom.show({ parts, mosaics, overlay, why: mosaics.length ? whatIsShown(run, mosaics[0]) : why(run, parts, refused) });
    this.#reason.show(run, this.#shown);
    if (!parts.length) return;
    this.#choose(this.#state.get("component"), asked);
    rest.unattended(this.#showHeights(run).then(() => run === this.#run && this.#measures.show(run)));
    await this.#comparison.show(run);
  }

  // Heights may be measured only now: nothing else waits for them.
  async #showHeights(run) {
    const heights = await rest.heights(run.id).catch(() => null);
    if (run !== this.#run) return;
    this.#showMeasured({ heights });
  }

  // Show what is measured of the parts.
  #showMeasured(found) {
    Object.assign(this.#shown, found);
    this.#zoom.measured(this.#shown);
    this.#pictures.measured(this.#shown);
    showExports(this.part("tab-export"), this.#run, this.#shown);
    this.#showNeighbour();
  }

  #showNeighbour() {
    const part = this.#shown.parts.find((one) => one.address === this.#state.get("component"));
    if (part && this.#shown.measures) rest.unattended(this.#neighbour.show(this.#run, part));
  }

  #choose(address, fly = true) {
    const part = this.#shown.parts.find((p) => p.address === address);
    if (!part) return;
    this.#state.set({ component: address });
    this.#zoom.choose(address, fly);
    this.#measures.choose(address);
    this.#showNeighbour();
    const matrix = this.#shown.mosaics[0]?.image_from_cad;
    rest.unattended(this.#pictures.show(this.#run, part, this.#shown, matrix?.[0][0] < 0));
  }

  // Lead to the place where a reason is seen.
  #lead({ drawing, colour, component, points }) {
    if (component) this.#choose(component, false);
    this.#zoom.lead(drawing, colour, points);
    this.part("zoom").scrollIntoView({ block: "nearest" });
  }

  // Beside one another are pictures of a part; over the whole board the other one would hide this one.
  #compare({ run, mosaics, visible, from, beside }) {
    const wanted = this.#state.get("mosaic");
    this.#zoom.compare(mosaics.find((m) => m.name === wanted) ?? mosaics[0] ?? null, visible && !beside, from);
    this.#pictures.compare({ run, visible, from, beside });
  }
}

const pause = (ms) => new Promise((done) => setTimeout(done, ms));

// What is shown in place of the mosaics of a run whose frames are no longer in memory.
function whatIsShown(run, mosaic) {
  const words = texts.board;
  return !mosaic.kept ? "" : run.recording ? `${words.keptSmall} ${words.recordingKept}` : `${words.framesGone(run.state)} ${words.keptSmall}`;
}

// Why there is no picture of the whole board.
function why(run, parts, refused) {
  const words = texts.board;
  if (run.verdict == null) return texts.verdicts.none;
  if (refused) return saidOf(refused);
  if (run.frames_available) return parts.length ? texts.noMosaic : texts.noComponents;
  return `${run.recording ? words.recordingKept : `${words.framesGone(run.state)} ${words.notRecorded}`} ${words.nothingKept}`;
}

// The default choice: defects are seen best on the largest component.
function largestSeen(list) {
  const seen = list.filter((c) => c.views > 0);
  return seen.sort((a, b) => b.width_mm * b.height_mm - a.width_mm * a.height_mm)[0];
}
