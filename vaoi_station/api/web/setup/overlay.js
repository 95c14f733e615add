// A board type laid over a filmed board: checked by the station, moved by hand, stored as a draft.
import { fullLevel, TILE_PX, tileOfRun } from "../parts/board_picture.js";
import { make, said, signButton } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { stateShown } from "../parts/settings.js";
import { svg, titled } from "../parts/svg.js";
import { entered, number, texts } from "../texts/texts.js";
import { bodies } from "./drawing.js";
import { attempt, button, choice, facts, input, labelled, runChoice, say, section, SetupPage, tick, Wrong } from "./fields.js";
import { middle, mmPerUnit, moved, mover, outlineOf } from "./geometry.js";
import { PanZoom } from "./pan_zoom.js";
import * as requests from "./requests.js";
import { typeAddress } from "./types.js";

const FIRST_PX = 1600; // largest side of the picture that is shown before it is zoomed
const STEPS = ["0.01", "0.1", "1"];

export class Page extends SetupPage {
  #type;
  #tag;
  #mosaic;
  #run;
  #tiles = new Set();
  #move = { x: 0, y: 0, turn: 0 };
  #layer;
  #fields = {};
  #found;

  constructor(...page) {
    super(...page);
    for (const axis of Object.keys(this.#move)) this.#move[axis] = Number(this.query.get(axis)) || 0;
  }

  async show() {
    const t = texts.setup;
    const [{ content, tag }, { runs }] = await Promise.all([requests.boardType(this.name), rest.runs({ board_type: this.name, limit: 50 })]);
    [this.#type, this.#tag] = [content, tag];
    const usable = runs.filter((run) => run.verdict && run.verdict !== "failed" && run.frames_available);
    const head = [make("a", { href: typeAddress(this.name), className: "up", textContent: t.toType(this.name) }), make("h2", { textContent: t.layTitle }), this.answer];
    if (!usable.length) {
      this.root.replaceChildren(...head, make("p", { textContent: t.noRuns }));
      return;
    }
    const run = runChoice(usable, this.query.get("run"));
    const chosen = () => usable.find((r) => r.id === run.value);
    const drawing = make("div", { className: "drawing" });
    run.addEventListener("change", () => attempt(run, async () => {
      await this.#film(chosen(), drawing);
      this.#note(false);
    }, this.answer));
    this.#found = make("div");
    this.root.replaceChildren(...head, make("div", { className: "two" }, drawing,
      make("div", { className: "column" }, section(t.filmedBoard, labelled(t.run, run)), this.#check(), this.#nudge())));
    await this.#film(chosen(), drawing);
    if (this.query.has("measure")) this.root.querySelector("#check").click(); // the page was loaded anew: the station goes on, or has the result
  }

  // The address reproduces the run, the move, and whether the run is measured.
  #note(measure = this.query.has("measure")) {
    const move = Object.entries(this.#move).map(([axis, value]) => [axis, String(+value.toFixed(4))]).filter(([, value]) => Number(value));
    this.query = new URLSearchParams([["run", this.#run.id], ...move, ...(measure ? [["measure", "1"]] : [])]);
    stateShown(typeAddress(this.name, "lay"), this.query);
  }

  async #film(run, drawing) {
    this.#run = run;
    this.#tiles.clear();
    this.#found.replaceChildren();
    [this.#mosaic] = await rest.mosaics(run.id);
    const mosaic = this.#mosaic;
    if (!mosaic) {
      drawing.replaceChildren(make("p", { className: "answer refused", textContent: texts.setup.noPicture }));
      return;
    }
    this.#layer = svg("g", { class: "laid" }, svg("path", { class: "outline", d: `M${outlineOf(this.#type).map((p) => p.join(" ")).join("L")}Z` }), ...bodies(this.#type),
      ...this.#type.fiducials.map((f) => titled(svg("circle", { cx: f.x, cy: f.y, r: f.diameter / 2, class: "mark" }), f.name)));
    const picture = svg("g");
    const image = svg("svg", { class: "laying", role: "application", "aria-label": texts.setup.layLabel }, picture, this.#layer);
    const pan = new PanZoom(image, [0, 0, mosaic.width_px, mosaic.height_px], { onKey: (event) => this.#key(event), onChange: (view) => this.#load(view, picture, image) });
    drawing.replaceChildren(make("div", { className: "drawing-tools" }, make("span", { className: "size", textContent: texts.setup.layKeys }), ...pan.tools), image);
    this.#place();
  }

  // The tiles that are seen, from the level that has about one pixel per pixel of the screen.
  #load(pan, picture, image) {
    const mosaic = this.#mosaic;
    const shown = pan?.box ?? [0, 0, mosaic.width_px, mosaic.height_px];
    const wanted = Math.max(image.clientWidth || 0, FIRST_PX / 2);
    const reduction = Math.min(Math.max(Math.floor(Math.log2(shown[2] / wanted)), 0), mosaic.levels - 1);
    const [size, level] = [TILE_PX * 2 ** reduction, fullLevel(mosaic) - reduction];
    const range = (low, length, most) => [Math.max(Math.floor(low / size), 0), Math.min(Math.floor((low + length) / size), Math.ceil(most / size) - 1)];
    const [[left, right], [top, bottom]] = [range(shown[0], shown[2], mosaic.width_px), range(shown[1], shown[3], mosaic.height_px)];
    for (let row = top; row <= bottom; row++) {
      for (let column = left; column <= right; column++) {
        const name = `${level}/${column}_${row}`;
        if (this.#tiles.has(name)) continue;
        this.#tiles.add(name);
        const [x, y] = [column * size, row * size];
        const tile = svg("image", {
          href: tileOfRun(this.#run, mosaic, level, column, row), x, y, preserveAspectRatio: "none",
          width: Math.min(size, Math.ceil(mosaic.width_px / 2 ** reduction) * 2 ** reduction - x), height: Math.min(size, Math.ceil(mosaic.height_px / 2 ** reduction) * 2 ** reduction - y),
        });
        tile.addEventListener("error", () => this.#lost(tile, name));
        picture.append(tile);
      }
    }
  }

  // A tile that was not sent is asked for again when the view changes.
  #lost(tile, name) {
    if (!tile.isConnected) return; // of a run that is shown no more
    tile.remove();
    this.#tiles.delete(name);
    say(this.answer, texts.setup.tilesLost, "refused");
  }

  // C of the mosaic after the move, as one transform of all data.
  #place() {
    if (!this.#mosaic) return;
    const m = this.#mosaic.image_from_cad;
    const lead = mover(this.#type, this.#move);
    const at = (point) => {
      const [x, y] = lead(point);
      return [m[0][0] * x + m[0][1] * y + m[0][2], m[1][0] * x + m[1][1] * y + m[1][2]];
    };
    const [o, a, b] = [at([0, 0]), at([1, 0]), at([0, 1])];
    this.#layer.setAttribute("transform", `matrix(${[a[0] - o[0], a[1] - o[1], b[0] - o[0], b[1] - o[1], ...o].join(" ")})`);
    this.#layer.dataset.x = this.#move.x;
    for (const name of ["x", "y", "turn"]) {
      if (document.activeElement !== this.#fields[name]) this.#fields[name].value = entered(+this.#move[name].toFixed(4));
    }
  }

  // Move by a step to the right and up on the screen, or turn counter-clockwise on the screen.
  #by(right, upwards, ccw) {
    if (!this.#mosaic) return;
    const m = this.#mosaic.image_from_cad;
    const step = Number(this.#fields.step.value);
    const flip = this.#type.y_axis === "down" ? -1 : 1;
    const [sx, sy] = [Math.sign(m[0][0]), -Math.sign(m[1][1]) * flip];
    this.#move = { x: this.#move.x + right * step * sx, y: this.#move.y + upwards * step * sy, turn: this.#move.turn + ccw * step * sx * sy };
    this.#place();
    this.#note();
  }

  #key(event) {
    const steps = { ArrowRight: [1, 0, 0], ArrowLeft: [-1, 0, 0], ArrowUp: [0, 1, 0], ArrowDown: [0, -1, 0], "[": [0, 0, 1], "]": [0, 0, -1] }[event.key];
    if (!steps || event.shiftKey) return false;
    this.#by(...steps);
    return true;
  }

  #nudge() {
    const t = texts.setup;
    const [x, y] = middle(this.#type);
    for (const name of ["x", "y", "turn"]) {
      const field = (this.#fields[name] = input(name, "0", { inputMode: "decimal" }));
      field.addEventListener("input", () => {
        const value = Number(field.value.replace(",", "."));
        if (!Number.isFinite(value)) return;
        this.#move = { ...this.#move, [name]: value };
        this.#place();
        if (this.#run) this.#note();
      });
    }
    this.#fields.step = choice("step", STEPS, "0.1");
    const outline = tick("outline", t.withOutline);
    const press = (text, label, ...by) => signButton(text, label, () => this.#by(...by));
    const store = button(t.storeMoved, async () => {
      if (!this.#move.x && !this.#move.y && !this.#move.turn) throw new Wrong(t.notMoved);
      await requests.storeType(moved(this.#type, this.#move, outline.querySelector("input").checked), requests.ifStill(this.#tag));
      this.#move = { x: 0, y: 0, turn: 0 };
      this.#note(false);
      await this.show();
      return t.storedDraft;
    }, this.answer, { className: "primary", id: "store-moved" });
    return section(t.nudge, make("p", { className: "help", textContent: t.nudgeHelp(number(x * mmPerUnit(this.#type), 1), number(y * mmPerUnit(this.#type), 1)) }),
      make("div", { className: "fields" }, labelled("x", this.#fields.x, { unit: "mm" }), labelled("y", this.#fields.y, { unit: "mm" }), labelled(t.turn, this.#fields.turn, { unit: "°" }), labelled(t.stepSize, this.#fields.step, { unit: "mm, °" })),
      make("div", { className: "buttons arrows" }, press("←", t.left, -1, 0, 0), press("→", t.right, 1, 0, 0), press("↑", t.upwards, 0, 1, 0), press("↓", t.down, 0, -1, 0), press("⟲", t.ccw, 0, 0, 1), press("⟳", t.cw, 0, 0, -1)),
      outline, make("div", { className: "buttons" }, store));
  }

  #check() {
    const t = texts.setup;
    const start = button(t.check, async () => {
      this.#note(true);
      const found = await requests.check(this.#run.id, this.name);
      this.#showCheck(found);
      return found.warnings.length ? "" : t.checkGood;
    }, this.answer, { id: "check" });
    return section(t.checkTitle, make("p", { className: "help", textContent: t.checkHelp }), make("div", { className: "buttons" }, start), this.#found);
  }

  #showCheck(found) {
    const t = texts.setup;
    const { residual } = found;
    const shown = (value, sigma, digits) => `${number(value, digits)} ± ${number(sigma, digits)}`;
    const lines = residual ? facts([
      [t.shift, t.millimetres(residual.shift_mm.map((v, n) => shown(v, residual.shift_sigma_mm[n], 3)).join(" / "))],
      [t.turn, `${shown(residual.rotation_deg, residual.rotation_sigma_deg, 3)}°`], [t.scale, shown(residual.scale, residual.scale_sigma, 5)],
      [t.mirrored, residual.mirrored ? t.yes : t.no], [t.measured, t.ofAll(found.measured, found.components)],
      [t.absent, found.unlikely.map((u) => u.ref).join(", ")], [t.notFilmed, found.not_filmed.join(", ")],
    ]) : "";
    const picture = make("img", { src: requests.checkPicture(this.#run.id, this.name), alt: t.checkPicture });
    const correct = found.proposal ? button(t.correct, async () => {
      await requests.correct(this.name, this.#run.id);
      this.#move = { x: 0, y: 0, turn: 0 };
      this.#note(false);
      await this.show();
      return t.storedDraft;
    }, this.answer, { className: "primary", id: "correct" }) : "";
    this.#found.replaceChildren(lines, make("ul", { className: "warnings" }, ...found.warnings.map((w) => make("li", {}, ...said(w.message)))),
      make("div", { className: "buttons" }, correct), make("figure", {}, make("a", { href: picture.src, target: "_blank" }, picture), make("figcaption", { textContent: t.checkPicture })));
  }
}
