// The operator's view: one word, one order, the last board, the last twenty, and one button.
import { make, setText, showLines, View } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { draw } from "../parts/signs.js";
import { clock, texts } from "../texts/texts.js";
import { Arming } from "./arming.js";
import { Beside } from "./beside.js";
import { LastBoard } from "./last_board.js";
import { Strip } from "./strip.js";

const SOON_MS = 5000; // attempts that are due sooner are not shown
const QUIET_MS = 60_000; // without any event, the state is asked for after this time: a day may have ended
const PASSING_MS = 5000; // the same while a board passes: a belt that stops is no event
const PAGE = `
<section id="band" aria-labelledby="state-word">
  <div id="state" role="status" aria-live="polite">
    <svg id="state-shape" viewBox="0 0 100 100" aria-hidden="true"></svg>
    <div id="state-word"></div>
    <p id="order"></p>
    <p id="lost"></p>
  </div>
  <p id="armed-with"></p>
  <button type="button" id="why" aria-expanded="false" aria-controls="details" data-text="why" hidden></button>
</section>
<section id="details" hidden aria-labelledby="details-title">
  <h2 id="details-title" data-text="technical"></h2>
  <ul id="reasons" lang="en"></ul>
  <ul id="warnings" lang="en"></ul>
  <p id="set-aside" hidden></p>
  <button type="button" id="close-details" data-text="close"></button>
</section>
<section id="last" aria-labelledby="last-title"></section>
<section id="beside" tabindex="0" data-label="lastMeasures"></section>
<section id="history" aria-labelledby="strip-title"></section>
<form id="controls"></form>`;

// The lost cameras without which boards are filmed, because a person has accepted it.
const without = (now) => (now.line_ready ? now.cameras.filter((c) => !c.connected).map((c) => texts.camera(c.name)) : []);

// Which cameras do not answer: their names, where they hang, and since when. At the start all are still to come.
function lostOf(now) {
  const lost = ["starting", "stopping"].includes(now.state) ? [] : now.cameras.filter((camera) => !camera.connected);
  return lost.map((camera) => texts.lostCamera(texts.camera(camera.name), [camera.address, camera.link].filter(Boolean).join(", "), camera.lost_since && clock(camera.lost_since))).join(" · ");
}

export class LineView extends View {
  name = "line-view";
  #station;
  #refresh;
  #again = 0;
  #shownAt = 0;

  constructor(station, refresh) {
    super(PAGE, make("div", { className: "line" }));
    [this.#station, this.#refresh] = [station, refresh];
    this.boards = station.boards;
    this.last = new LastBoard(this.part("last"), () => this.#decided());
    this.beside = new Beside(this.part("beside"));
    this.strip = new Strip(this.part("history"));
    this.arming = new Arming(this.part("controls"), this.part("set-aside"), refresh);
    this.part("why").addEventListener("click", () => this.#openDetails(this.part("details").hidden));
    this.part("close-details").addEventListener("click", () => this.#openDetails(false));
  }

  open() {
    this.arming.reload();
  }

  close() {
    clearTimeout(this.#again);
  }

  onEvent(event) {
    if (event.kind === "board-type") this.arming.reload();
    if (event.kind === "parts") rest.unattended(this.beside.measured(event.run));
  }

  onAge(old) {
    this.arming.enable(!old);
  }

  tick() {
    this.last.tick(this.#station.time_ms());
    this.beside.neighbours.tick();
    const { now, stale } = this.#station;
    const passing = now?.line_held.some((reason) => ["line-filming", "belt-stopped"].includes(reason.code));
    if (performance.now() - this.#shownAt > (passing ? PASSING_MS : QUIET_MS) && !stale) this.#refresh();
  }

  show(now) {
    this.#shownAt = performance.now();
    this.arming.show(now);
    this.beside.showOrders(now);
    this.#showDetails(now);
  }

  async showBoards() {
    this.strip.show(this.boards);
    await this.last.show(this.boards.runs, this.#station.situation.board, this.#station.time_ms());
    await this.beside.showBoard(this.last.run);
  }

  async #decided() {
    this.boards.readAgain();
    await this.#refresh();
  }

  onSituation(shown) {
    const { now, stale } = this.#station;
    draw(this.part("state-shape"), shown.shown);
    this.part("state-shape").dataset.state = shown.state;
    setText(this.part("state-word"), shown.word);
    setText(this.part("order"), shown.order);
    setText(this.part("lost"), !stale && now ? lostOf(now) : "");
    const held = ["lacking", "held"].includes(shown.state);
    const armed = !stale && now?.armed_with ? texts.armedWith(now.armed_with, without(now), held) : "";
    setText(this.part("armed-with"), armed);
  }

  #showDetails(now) {
    const held = now.line_held.filter((reason) => now.state === "armed" || reason.code === "belt-stopped");
    const say = (reason) => `${reason.message} ${reason.action}`.trim();
    const lines = new Set([...held, ...now.reasons].map(say)); // a lost camera is among both
    showLines(this.part("reasons"), [...lines, ...this.#nextTries(now)]);
    showLines(this.part("warnings"), now.warnings.map(say));
    this.arming.showSetAside(now.set_aside ?? []);
    const any = this.part("reasons").children.length + this.part("warnings").children.length > 0 || !this.part("set-aside").hidden;
    this.part("why").hidden = !any;
    this.part("why").classList.toggle("warned", now.warnings.length > 0 || without(now).length > 0);
    if (!any) this.#openDetails(false);
  }

  #openDetails(open) {
    this.part("details").hidden = !open;
    this.part("why").setAttribute("aria-expanded", open);
    if (open) this.part("close-details").focus();
  }

  // Pending retries. No event may come before a retry, so the page requests the state again after it.
  #nextTries(now) {
    const cameras = now.cameras.map((c) => ({ name: texts.camera(c.name), next_try: c.next_try }));
    const until = (time) => Date.parse(time) - this.#station.time_ms();
    const far = [...now.processes, ...cameras].filter((p) => p.next_try && until(p.next_try) > SOON_MS);
    clearTimeout(this.#again);
    if (far.length) this.#again = setTimeout(this.#refresh, Math.min(...far.map((p) => until(p.next_try))) + SOON_MS);
    return far.map((p) => texts.nextTry(p.name, clock(p.next_try)));
  }
}
