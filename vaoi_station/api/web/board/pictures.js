// The pictures of one part: which frames show it, under which light, and one of them large, beside that of another board.
import { lines, make, options, saidOf, setText, View } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { number, texts } from "../texts/texts.js";
import { heightText } from "./colours.js";
import { linesOf } from "./measures.js";

const MAX_PICTURES = 48;
const DECODE_LIMIT_MS = 1000;
const PART = `
<div id="part-head"><h3 id="part-name"></h3><span id="views"></span></div>
<dl id="part-facts"></dl>
<div id="picture-tools">
  <label id="light-label"><span data-text="board.light"></span><select id="light"></select></label>
  <label id="minus-label"><span data-text="board.minus"></span><select id="minus"></select></label>
  <button type="button" id="hdr" data-text="board.hdr"></button>
</div>
<div id="stage" hidden>
  <div id="stage-view" tabindex="0" data-label="board.large"><div id="pair"><img id="large" alt=""><img id="other" alt=""></div></div>
  <div id="stage-tools"><button type="button" id="size"></button><a id="file" class="button" target="_blank" data-text="board.file"></a></div>
  <p id="stage-facts"></p><p id="other-facts"></p>
</div>
<p id="pictures-note" role="status"></p>
<div id="pictures" role="group" data-label="component"></div>`;

export class Pictures extends View {
  #state;
  #run = null;
  #shown = null;
  #views = [];
  #other = { run: null, views: [], visible: true, from: 0, beside: false };
  #mirrored = false;
  #turn = 0;

  constructor(root, state) {
    super(PART, root);
    this.#state = state;
    const chosen = (name) => () => {
      state.set({ [name]: this.part(name).value, ...(name === "light" ? { minus: "" } : {}), hdr: "", picture: "" });
      rest.unattended(this.#load());
    };
    for (const name of ["light", "minus"]) this.part(name).addEventListener("change", chosen(name));
    this.part("hdr").addEventListener("click", () => {
      state.set({ hdr: state.get("hdr") ? "" : "1", picture: "" });
      rest.unattended(this.#load());
    });
    this.part("size").addEventListener("click", () => {
      state.set({ size: state.get("size") === "1:1" ? "fit" : "1:1" });
      this.#lay();
    });
    for (const id of ["large", "other"]) this.part(id).addEventListener("load", () => this.#lay());
    this.part("large").addEventListener("error", () => this.#say(texts.board.unloadable));
  }

  // Show a part of a run. `mirrored`: its pictures show the bottom side, on which angles run the other way.
  async show(run, part, measured, mirrored) {
    if (part.address !== this.#shown?.address && this.#shown) this.#state.set({ picture: "" });
    [this.#run, this.#shown, this.#mirrored] = [run, part, mirrored];
    setText(this.part("part-name"), part.address);
    this.measured(measured);
    this.#offer(run);
    await this.#load();
  }

  // Say how high the part is, what is measured of it, and its other figures.
  measured({ heights, measures, reason_texts }) {
    const part = this.#shown;
    if (!part) return;
    const figures = [
      [texts.board.sigma, part.sigma_px == null ? texts.board.noValue : `${number(part.sigma_px, 3)} px, ${number(part.sigma_mm * 1000, 1)} µm`],
      ...(part.coverage == null ? [] : [[texts.board.coverage, `${number(part.coverage * 100)} %${part.in_one_frame ? "" : `, ${texts.board.inSeveral}`}`]]),
      [texts.board.height, heights?.[part.address] ? heightText(heights[part.address]) : texts.board.noValue],
      [texts.board.footprint, `${number(part.width_mm, 1)} × ${number(part.height_mm, 1)} mm, ${number(part.rotation_deg)}°`],
      ...(measures?.[part.address] ? linesOf(measures[part.address], reason_texts) : []),
    ];
    this.part("part-facts").replaceChildren(...lines(figures));
  }

  // The lights and exposures that the run has.
  #offer(run) {
    const usable = run.frames.filter((f) => f.verdict === "ok" && f.proven);
    const lights = [...new Set(usable.map((f) => f.light).filter(Boolean))];
    const offer = (none, values) => options([["", none], ...values.map((value) => [value, value])]);
    this.part("light").replaceChildren(...offer(texts.board.allLights, lights));
    this.part("light").value = lights.includes(this.#state.get("light")) ? this.#state.get("light") : "";
    this.part("minus").replaceChildren(...offer(texts.board.nothing, lights.filter((light) => light !== this.part("light").value)));
    this.part("minus").value = this.#state.get("minus");
    this.part("light-label").hidden = lights.length < 2;
    this.part("minus-label").hidden = lights.length < 2 || !this.part("light").value;
    this.part("hdr").hidden = new Set(usable.map((f) => f.exposure_us).filter(Boolean)).size < 2;
    this.part("hdr").setAttribute("aria-pressed", this.#state.get("hdr") === "1");
  }

  // The query for the pictures of the part, of this run and of the one it is compared with.
  #query() {
    const query = { align: "part" }; // turned to the part's own orientation, so that pin 1 of every U1 is at the same corner
    if (this.part("light").value) query.light = this.part("light").value;
    if (this.part("light").value && this.part("minus").value) query.minus = this.part("minus").value;
    return query;
  }

  async #load() {
    const turn = ++this.#turn;
    const [run, part] = [this.#run, this.#shown];
    this.#offer(run);
    const gone = !run.frames_available && !run.recording;
    this.part("picture-tools").hidden = gone;
    if (gone) {
      this.#views = [];
      setText(this.part("views"), "");
      this.part("stage").hidden = true;
      this.part("pictures").replaceChildren();
      this.#say(texts.picturesGone);
      return;
    }
    this.#say(this.#views.length ? "" : texts.board.loading);
    try {
      const views = await viewsOf(run, part, this.#state.get("hdr") === "1", this.#query());
      if (turn !== this.#turn) return; // overtaken by a later choice
      const figures = views.slice(0, MAX_PICTURES).map((view) => this.#figure(view));
      await loaded(figures);
      if (turn !== this.#turn) return;
      this.#views = views;
      setText(this.part("views"), texts.views(views.length));
      this.part("pictures").replaceChildren(...figures);
      this.#say(figures.length ? "" : texts.noPictures);
      this.#choose(this.#chosen());
      await this.#loadOther();
    } catch (error) {
      if (!(error instanceof rest.Refusal)) throw error;
      if (turn !== this.#turn) return;
      this.#views = [];
      this.part("stage").hidden = true;
      this.part("pictures").replaceChildren();
      this.part("pictures-note").replaceChildren(...saidOf(error));
    }
  }

  #say(text) {
    setText(this.part("pictures-note"), text);
  }

  #chosen() {
    return this.#views.find((view) => nameOf(view) === this.#state.get("picture")) ?? this.#views[0];
  }

  #figure(view) {
    const image = make("img", { alt: texts.alt(this.#shown.address, view) });
    const caption = make("figcaption", { textContent: captionOf(view) });
    const button = make("button", { type: "button" }, image);
    const figure = make("figure", {}, button, caption);
    figure.dataset.picture = nameOf(view);
    this.#upright(image, view);
    image.onerror = () => {
      figure.classList.add("unloadable");
      caption.textContent = captionOf(view) + texts.unloadable;
    };
    image.src = addressOf(this.#run, view);
    button.addEventListener("click", () => {
      this.#state.set({ picture: nameOf(view) });
      this.#choose(view);
      this.part("stage").scrollIntoView({ block: "nearest" });
    });
    return figure;
  }

  // Merged pictures follow the CAD axes: they are turned here.
  #upright(image, view) {
    const angle = this.#shown.rotation_deg * (this.#mirrored ? -1 : 1);
    image.style.transform = view.merged && angle % 360 ? `rotate(${angle}deg)` : "";
  }

  #choose(view) {
    this.part("stage").hidden = !view;
    if (!view) return;
    for (const figure of this.part("pictures").children) {
      const here = figure.dataset.picture === nameOf(view);
      figure.classList.toggle("chosen", here);
      figure.firstChild.setAttribute("aria-pressed", here);
    }
    this.#upright(this.part("large"), view);
    Object.assign(this.part("large"), { src: addressOf(this.#run, view), alt: texts.alt(this.#shown.address, view) });
    this.part("file").href = addressOf(this.#run, view);
    setText(this.part("stage-facts"), factsOf(view));
    this.#lay();
    this.#showOther();
  }

  // What is shown of another board; `run` is null if there is none.
  compare({ run, visible, from, beside }) {
    const same = run?.id === this.#other.run?.id;
    Object.assign(this.#other, { run, visible, from, beside });
    if (same) {
      this.#cut();
      return;
    }
    this.#other.views = [];
    if (this.#shown) rest.unattended(this.#loadOther());
  }

  async #loadOther() {
    const [turn, run] = [this.#turn, this.#other.run];
    let [views, answer, refused] = [[], "", null];
    if (run && this.#views.length) {
      if (!run.frames_available && !run.recording) answer = texts.board.otherPicturesGone;
      else {
        try {
          views = await viewsOf(run, this.#shown, this.#state.get("hdr") === "1", this.#query());
          if (!views.length) answer = texts.board.otherHasNone;
        } catch (error) {
          if (!(error instanceof rest.Refusal)) throw error;
          refused = error;
        }
      }
    }
    if (turn !== this.#turn || run !== this.#other.run) return;
    this.#other.views = views;
    setText(this.part("other-facts"), answer);
    if (refused) this.part("other-facts").replaceChildren(...saidOf(refused));
    this.#showOther();
  }

  // The other board's picture that was taken most like the chosen one.
  #showOther() {
    const [view, image] = [this.#chosen(), this.part("other")];
    const found = view && alike(view, this.#other.views);
    image.hidden = !found;
    if (found) {
      this.#upright(image, found);
      const src = addressOf(this.#other.run, found);
      if (image.getAttribute("src") !== src) Object.assign(image, { src, alt: texts.alt(this.#shown.address, found) });
      setText(this.part("other-facts"), `${texts.board.besideIt} ${captionOf(found)}`);
    } else image.removeAttribute("src");
    this.#cut();
  }

  #cut() {
    const image = this.part("other");
    image.style.visibility = this.#other.visible ? "" : "hidden";
    this.part("pair").classList.toggle("beside", this.#other.beside && !image.hidden);
    image.style.clipPath = this.#other.from > 0 ? `inset(0 0 0 ${this.#other.from * 100}%)` : "";
  }

  // Lay the large picture out: as large as its place, or one pixel of the camera on one pixel of the screen.
  #lay() {
    const [large, exact] = [this.part("large"), this.#state.get("size") === "1:1"];
    setText(this.part("size"), exact ? texts.board.fit : texts.board.exact);
    this.part("stage-view").classList.toggle("exact", exact);
    const [width, height] = exact ? [large.naturalWidth, large.naturalHeight].map((n) => `${n / devicePixelRatio}px`) : ["", ""];
    Object.assign(this.part("pair").style, { width, height });
  }

  close() {
    this.#turn++;
  }
}

// The views of a part, or with `hdr` its merged pictures, the one of all frames first.
async function viewsOf(run, part, hdr, query) {
  if (!hdr) return (await rest.component(run.id, part.address, query)).views;
  const pictures = await rest.merged(run.id, { component: part.address, ...(query.light ? { light: query.light } : {}) });
  return pictures.reverse().map((p) => ({ ...p, camera: p.merged[0][0], row: p.merged[0][1], light: p.lights.join(", "), coverage: 1 }));
}

const nameOf = (view) => (view.merged ? `m${view.k}` : `${view.camera}.${view.row}`);

// After a reinstallation run ids may repeat; the start time keeps the browser from using a cached picture.
function addressOf(run, view) {
  const address = new URL(view.url, location.href);
  address.searchParams.set("format", "jpeg");
  address.searchParams.set("_", run.started);
  return address.href;
}

function captionOf(view) {
  if (view.merged) return texts.board.mergedOf(view.merged.length, view.exposures) + (view.light ? `, ${view.light}` : "");
  return texts.caption(view) + texts.whole(Math.floor(view.coverage * 100 + 0.5));
}

function factsOf(view) {
  const facts = [captionOf(view)];
  if (view.minus) facts.push(texts.board.minusFrame(...view.minus));
  if (view.exposure_us != null) facts.push(`${number(view.exposure_us)} µs`);
  if (view.gain != null && view.gain !== 1) facts.push(`${texts.board.gain} ${number(view.gain, 2)}`);
  if (view.view_angle_deg != null) facts.push(texts.board.angle(number(view.view_angle_deg, 1), view.view_azimuth_deg == null ? null : number(view.view_azimuth_deg)));
  if (view.sigma_px != null) facts.push(`σ ${number(view.sigma_px, 3)} px`);
  facts.push(`${number(view.px_per_mm, 1)} px/mm`);
  return facts.join(" · ");
}

// The view that was taken most like another one: same light, same camera, seen at the same place of the frame.
function alike(view, views) {
  const cost = (v) => (v.light !== view.light ? 100 : 0) + (v.camera !== view.camera ? 10 : 0) + Math.abs((v.off_center ?? 0) - (view.off_center ?? 0)) + Math.abs((v.exposure_us ?? 0) - (view.exposure_us ?? 0)) / 1e3;
  return [...views].sort((a, b) => cost(a) - cost(b))[0];
}

// Waits until the pictures are decoded, so that they change together; a slow one is not awaited longer than this.
function loaded(figures) {
  const images = figures.map((figure) => figure.querySelector("img").decode());
  return Promise.race([Promise.allSettled(images), new Promise((done) => setTimeout(done, DECODE_LIMIT_MS))]);
}
