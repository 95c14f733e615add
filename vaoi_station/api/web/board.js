// The last board: its data, its verdict, and the pictures of one component.
import * as rest from "./rest.js";
import { draw } from "./marks.js";
import { texts } from "./texts.en.js";

const $ = (id) => document.getElementById(id);
const MAX_PICTURES = 24;
const DECODE_LIMIT_MS = 1000;

export class Board {
  #run = null;
  #seen = "";
  #offset_ms = 0;
  #chosen = null;
  #since = null;

  constructor() {
    $("component").addEventListener("change", () => {
      this.#chosen = $("component").value;
      this.#showPictures();
    });
  }

  // Ages are computed with the station's clock; the clock of the browser's computer may be wrong.
  setClock(time) {
    this.#offset_ms = Date.parse(time) - Date.now();
  }

  until(time) {
    return Date.parse(time) - Date.now() - this.#offset_ms;
  }

  tick() {
    if (this.#since && this.#run?.finished) {
      const ago = texts.ago((Date.now() + this.#offset_ms - Date.parse(this.#run.finished)) / 1000);
      if (this.#since.textContent !== ago) this.#since.textContent = ago;
    }
  }

  showNone() {
    this.#verdict("none", texts.noBoard, texts.noBoardHint);
    $("chooser").classList.add("hidden");
    $("facts").replaceChildren();
    $("pictures").replaceChildren();
  }

  async show(id) {
    const run = await rest.run(id);
    const seen = `${run.id} ${run.state} ${run.frames_available} ${run.recording}`;
    if (seen === this.#seen) return;
    this.#run = run;
    this.#showFacts();
    await this.#showComponents();
    this.#seen = seen;
  }

  #verdict(name, word, reason) {
    const facts = $("board-facts");
    facts.classList.remove("degraded", "failed");
    if (name === "degraded" || name === "failed") facts.classList.add(name);
    draw($("verdict-shape"), name);
    $("verdict-word").textContent = word;
    $("verdict-reason").textContent = reason;
  }

  // What to do comes first, each order once; then the reasons.
  #reasons(run) {
    const orders = run.reasons.map((r) => texts.orders[texts.orderOf[r.cause]]).filter(Boolean);
    return [...new Set(orders), ...run.reasons.map((r) => r.message)].join(" ");
  }

  #showFacts() {
    const run = this.#run;
    const verdict = run.verdict ?? "none";
    this.#verdict(verdict, texts.verdicts[verdict], this.#reasons(run));
    const { ok, incomplete, missing, unproven } = run.counts;
    const lines = [
      [texts.facts.board, run.board_id || texts.noId],
      [texts.facts.type, run.board_type],
      ...(run.job_id ? [[texts.facts.job, run.job_id]] : []),
      [texts.facts.run, run.id],
      [texts.facts.frames, texts.frames(ok, incomplete, missing, unproven, run.rows, run.cameras)],
      ...(run.unseen?.length ? [[texts.facts.unseen, texts.unseen(run.unseen)]] : []),
      ...(run.proof ? [[texts.facts.trigger, texts.trigger(run.proof)]] : []),
      [texts.facts.since, ""],
    ];
    const cells = lines.flatMap(([name, value]) => [
      Object.assign(document.createElement("dt"), { textContent: name }),
      Object.assign(document.createElement("dd"), { textContent: value }),
    ]);
    $("facts").replaceChildren(...cells);
    this.#since = cells.at(-1);
    this.#since.setAttribute("aria-live", "off");
    this.tick();
  }

  async #showComponents() {
    const list = this.#run.verdict === "failed" ? [] : await rest.components(this.#run.id);
    $("chooser").classList.toggle("hidden", list.length === 0);
    if (list.length === 0) {
      $("pictures").replaceChildren(note(this.#run.verdict === "failed" ? texts.verdicts.failed : texts.noComponents));
      return;
    }
    const addresses = list.map((c) => c.address);
    const labels = list.map((c) => (c.unseen ? texts.unseenOption(c) : c.address));
    if (labels.join("\n") !== $("component").dataset.list) {
      $("component").dataset.list = labels.join("\n");
      $("component").replaceChildren(
        ...addresses.map((a, n) => Object.assign(document.createElement("option"), { value: a, textContent: labels[n] })),
      );
    }
    if (!addresses.includes(this.#chosen)) this.#chosen = (largestSeen(list) ?? list[0]).address;
    $("component").value = this.#chosen;
    await this.#showPictures();
  }

  async #showPictures() {
    const [run, ref] = [this.#run, this.#chosen];
    if (!run.frames_available && !run.recording) {
      $("views").textContent = "";
      $("pictures").replaceChildren(note(texts.picturesGone));
      return;
    }
    const { views } = await rest.component(run.id, ref);
    if (run !== this.#run || ref !== this.#chosen) return; // overtaken by a later board or choice
    const figures = views.slice(0, MAX_PICTURES).map((view) => picture(run, ref, view));
    await loaded(figures);
    if (run !== this.#run || ref !== this.#chosen) return;
    $("views").textContent = texts.views(views.length);
    $("pictures").className = figures.length <= 2 ? "few" : figures.length <= 6 ? "some" : "";
    $("pictures").replaceChildren(...(figures.length ? figures : [note(texts.noPictures)]));
  }
}

// Waits until the pictures are decoded, so that they change together; a slow one is not awaited longer than this.
function loaded(figures) {
  const images = figures.map((figure) => figure.querySelector("img").decode());
  return Promise.race([Promise.allSettled(images), new Promise((done) => setTimeout(done, DECODE_LIMIT_MS))]);
}

const note = (text) => Object.assign(document.createElement("p"), { textContent: text });

// The default choice: defects are seen best on the largest component.
function largestSeen(list) {
  const seen = list.filter((c) => c.views > 0);
  return seen.sort((a, b) => b.width_mm * b.height_mm - a.width_mm * a.height_mm)[0];
}

function picture(run, ref, view) {
  const figure = document.createElement("figure");
  const image = document.createElement("img");
  // After a reinstallation run ids may repeat; the start time keeps the browser from using a cached picture.
  const address = new URL(view.url, location.href);
  address.searchParams.set("format", "jpeg");
  address.searchParams.set("_", run.started);
  image.alt = texts.alt(ref, view);
  const caption = document.createElement("figcaption");
  caption.textContent = texts.caption(view) + texts.whole(Math.floor(view.coverage * 100 + 0.5));
  figure.append(image, caption);
  image.onerror = () => {
    figure.classList.add("unloadable");
    caption.textContent = texts.caption(view) + texts.unloadable;
  };
  image.src = address.href;
  return figure;
}
