// One board: the whole board to zoom into, its parts, all pictures of one part, and the report in words.
import { Decisions } from "../parts/decisions.js";
import { make, setText } from "../parts/elements.js";
import { boardOrder } from "../parts/orders.js";
import * as rest from "../parts/rest.js";
import { draw } from "../parts/signs.js";
import { moment, number, texts } from "../texts/texts.js";
import { DeepZoom } from "./deep_zoom.js";

const MAX_PICTURES = 48;
const DECODE_LIMIT_MS = 1000;
const PART = `
<section id="report" aria-labelledby="board-title">
  <div id="head"><svg id="verdict-shape" viewBox="0 0 100 100" aria-hidden="true"></svg><h2 id="board-title"></h2></div>
  <p id="board-order"></p>
  <div id="decisions"></div>
  <ul id="verdict-reasons"></ul>
  <dl id="facts"></dl>
  <a href="#/boards" class="button" data-text="back"></a>
</section>
<section id="zoom" data-label="mosaic"></section>
<section id="part">
  <div id="chooser" class="hidden"><label for="component" data-text="component"></label><select id="component"></select><span id="views"></span></div>
  <div id="pictures" role="group" tabindex="0" data-label="component"></div>
</section>`;

export class BoardView {
  name = "board-view";
  #station;
  #id;
  #query;
  #run = null;
  #seen = "";
  #chosen = null;
  #zoom = null;
  #decisions;

  constructor(station, id, query) {
    [this.#station, this.#id, this.#query] = [station, id.replaceAll("%20", " "), new URLSearchParams(query)];
    this.root = make("div", { className: "board" });
    this.root.innerHTML = PART;
    this.#chosen = this.#query.get("component");
    this.#decisions = new Decisions(this.#part("decisions"), () => rest.unattended(this.show()));
    this.#part("component").addEventListener("change", () => this.#choose(this.#part("component").value));
  }

  #part(id) {
    return this.root.querySelector(`#${id}`);
  }

  close() {
    this.#zoom?.close();
  }

  async show() {
    let run;
    try {
      run = await rest.run(this.#id);
    } catch (error) {
      if (!(error instanceof rest.Refusal)) throw error;
      setText(this.#part("board-title"), error.status === 404 ? texts.notFound : error.message);
      return;
    }
    const seen = `${run.state} ${run.frames_available} ${run.recording} ${run.decision?.decided}`;
    if (seen === this.#seen) return;
    this.#run = run;
    this.#showReport(run);
    await this.#showParts(run);
    this.#seen = seen;
  }

  #showReport(run) {
    const verdict = run.verdict ?? (run.finished ? "failed" : "none");
    draw(this.#part("verdict-shape"), verdict);
    this.#part("report").dataset.verdict = verdict;
    this.#decisions.show(run);
    setText(this.#part("board-title"), `${run.board_id ?? texts.noId}: ${texts.verdicts[verdict]}`);
    setText(this.#part("board-order"), run.decision ? `${texts.decided[run.decision.choice](run.decision.name)}: ${run.decision.reason}` : verdict === "ok" || verdict === "none" ? "" : boardOrder(run));
    this.#part("verdict-reasons").replaceChildren(...run.reasons.map((reason) => make("li", { textContent: `${reason.message} ${reason.action}`.trim() })));
    const { ok, incomplete, missing, unproven } = run.counts;
    const facts = texts.facts;
    const lines = [
      [facts.type, run.board_type],
      ...(run.job_id ? [[facts.job, run.job_id]] : []),
      [facts.run, run.id],
      ...(run.finished ? [[facts.since, moment(run.finished)]] : []),
      [facts.frames, texts.frames(ok, incomplete, missing, unproven, run.rows, run.cameras)],
      ...(run.unseen?.length ? [[facts.unseen, texts.unseen(run.unseen)]] : []),
      ...(run.proof ? [[facts.trigger, texts.trigger(run.proof)]] : []),
      ...(run.belt ? [[facts.belt, texts.belt(number(Math.hypot(...run.belt.measured_mm_s), 2), number(run.belt.ratio * 100, 2))]] : []),
      ...(run.timings?.ready_after_last_frame_ms == null ? [] : [[facts.result, texts.resultAfter(number(run.timings.ready_after_last_frame_ms))]]),
      [facts.software, `${run.software.station}`],
    ];
    this.#part("facts").replaceChildren(...lines.flatMap(([name, value]) => [make("dt", { textContent: name }), make("dd", { textContent: value })]));
  }

  async #showParts(run) {
    const list = run.verdict === "failed" || run.verdict == null ? [] : await rest.components(run.id);
    this.#part("chooser").classList.toggle("hidden", list.length === 0);
    if (list.length === 0) {
      this.#say(run.verdict === "failed" ? texts.verdicts.failed : run.verdict ? texts.noComponents : texts.verdicts.none);
      return;
    }
    this.#part("component").replaceChildren(
      ...list.map((c) => make("option", { value: c.address, textContent: c.unseen ? texts.unseenOption(c) : c.address })),
    );
    if (!list.some((c) => c.address === this.#chosen)) this.#chosen = (largestSeen(list) ?? list[0]).address;
    this.#part("component").value = this.#chosen;
    const available = run.frames_available || run.recording;
    if (available && !this.#zoom) {
      const mosaics = await rest.mosaics(run.id).catch(() => []);
      if (mosaics.length) {
        this.#zoom = new DeepZoom(this.#part("zoom"), mosaics, list, (address) => this.#choose(address));
        this.#zoom.select(this.#chosen, this.#query.has("component"));
      }
    }
    rest.unattended(this.#showPictures()); // not awaited: the state must not wait for pictures
  }

  // A link to the page reproduces the choice.
  #choose(address) {
    this.#chosen = address;
    this.#part("component").value = address;
    history.replaceState(null, "", `#/board/${encodeURIComponent(this.#id)}?component=${encodeURIComponent(address)}`);
    this.#zoom?.select(address, true);
    rest.unattended(this.#showPictures());
  }

  #say(text) {
    this.#part("pictures").replaceChildren(make("p", { textContent: text }));
  }

  async #showPictures() {
    const [run, ref] = [this.#run, this.#chosen];
    if (!run.frames_available && !run.recording) {
      setText(this.#part("views"), "");
      this.#say(texts.picturesGone);
      return;
    }
    // Turned to the part's own orientation, so that pin 1 of every U1 is at the same corner.
    const { views } = await rest.component(run.id, ref, { align: "part" });
    if (run !== this.#run || ref !== this.#chosen) return; // overtaken by a later choice
    const figures = views.slice(0, MAX_PICTURES).map((view) => picture(run, ref, view));
    await loaded(figures);
    if (run !== this.#run || ref !== this.#chosen) return;
    setText(this.#part("views"), texts.views(views.length));
    if (figures.length) this.#part("pictures").replaceChildren(...figures);
    else this.#say(texts.noPictures);
  }
}

// Waits until the pictures are decoded, so that they change together; a slow one is not awaited longer than this.
function loaded(figures) {
  const images = figures.map((figure) => figure.querySelector("img").decode());
  return Promise.race([Promise.allSettled(images), new Promise((done) => setTimeout(done, DECODE_LIMIT_MS))]);
}

// The default choice: defects are seen best on the largest component.
function largestSeen(list) {
  const seen = list.filter((c) => c.views > 0);
  return seen.sort((a, b) => b.width_mm * b.height_mm - a.width_mm * a.height_mm)[0];
}

function picture(run, ref, view) {
  // After a reinstallation run ids may repeat; the start time keeps the browser from using a cached picture.
  const address = new URL(view.url, location.href);
  address.searchParams.set("format", "jpeg");
  address.searchParams.set("_", run.started);
  const image = make("img", { alt: texts.alt(ref, view) });
  const caption = make("figcaption", { textContent: texts.caption(view) + texts.whole(Math.floor(view.coverage * 100 + 0.5)) });
  const link = make("a", { href: address.href, target: "_blank" }, image);
  const figure = make("figure", {}, link, caption);
  image.onerror = () => {
    figure.classList.add("unloadable");
    caption.textContent = texts.caption(view) + texts.unloadable;
  };
  image.src = address.href;
  return figure;
}
