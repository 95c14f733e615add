// Calibration: print the board, film it, let the station measure its marks, judge, accept or try again.
import { make, options as choicesOf, said } from "../parts/elements.js";
import { saveFile } from "../parts/files.js";
import * as rest from "../parts/rest.js";
import { keep, kept, stateShown } from "../parts/settings.js";
import { moment, number, texts } from "../texts/texts.js";
import { LiveMarks, showCount, svgOfMarks } from "./calibration/live_marks.js";
import { attempt, button, facts, input, labelled, runChoice, section, SetupPage, table, tick, Wrong } from "./fields.js";
import * as requests from "./requests.js";

const POLL_MS = 500;
const FILES = ["pdf", "svg", "gbr"];
const UNDER_WAY = ["reading", "fitting"];
const UNFINISHED = ["filming", "stitching"];

// What is missing is named as the fields of this page are.
const localised = (error) => (error.code === "nominal-values-missing" ? new Wrong(texts.setup.nominalMissing) : error);

function readEntered() {
  try {
    return JSON.parse(kept("calibration", "{}"));
  } catch {
    return {};
  }
}

export class Page extends SetupPage {
  #entered = readEntered(); // what was entered in this browser: the board is printed on one day and filmed on another
  #board = {}; // fields of the artwork
  #limits = {};
  #only = null; // the choice of a single camera
  #layout = null; // the layout.json that was chosen instead of the artwork of this page
  #live = null;
  #judged = make("div");
  #drawn = make("div");
  #run;
  #row = input("row", "0", { type: "range", min: 0, max: 0 });
  #runs = [];
  #shown = "";
  #searched = 0; // counts the searches for marks: a later one ends the one before
  #closed = false;

  close() {
    this.#closed = true;
    this.#live?.stop();
  }

  async show() {
    const t = texts.setup;
    await this.#readRuns();
    const { cameras } = await rest.station();
    const alone = cameras.map((camera) => [String(camera.camera), t.onlyCamera(camera.name)]);
    this.#only = make("select", { name: "camera" }, ...choicesOf([["", t.wholeArray], ...alone]));
    this.#live = new LiveMarks(cameras.map((camera) => camera.name), () => this.#searchedFor());
    const limits = make("details", {}, make("summary", { textContent: t.limits }), make("div", { className: "fields" }, ...this.#limitFields()));
    this.root.replaceChildren(make("h2", { textContent: t.pages.calibration }), this.answer, this.#judged,
      make("div", { className: "two even" }, section(t.printBoard, make("p", { className: "help", textContent: t.printHelp }), this.#artwork(), this.#drawn),
        make("div", { className: "column" }, section(t.filmBoard, this.#live.root, make("p", { className: "help", textContent: t.filmHelp }), this.#choice()),
          section(t.calibrate, labelled(t.calibrated, this.#only, { help: t.onlyHelp }), this.#layoutField(), limits, make("div", { className: "buttons" }, button(t.beginTrial, () => this.#begin(), this.answer, { className: "primary", id: "calibrate" }))))));
    this.#row.addEventListener("change", () => this.#showFrames());
    this.#draw();
    this.#showFrames();
    rest.unattended(this.#follow()); // not awaited: the page is open at once, and can be closed meanwhile
  }

  #artwork() {
    const t = texts.setup;
    const field = (name, text, value, unit = "") => {
      this.#board[name] = this.#remembered(input(name, value, { inputMode: "decimal" }));
      this.#board[name].addEventListener("change", () => this.#redraw());
      return labelled(text, this.#board[name], { unit });
    };
    const light = tick("light_marks", t.lightMarks);
    this.#board.light_marks = this.#remembered(light.querySelector("input"));
    this.#board.light_marks.addEventListener("change", () => this.#redraw());
    return make("div", { className: "fields", id: "artwork" }, field("columns", t.marksAcross, "5"), field("rows", t.marksDown, "4"), field("mark_mm", t.markSize, "2", "mm"),
      field("tolerance_mm", t.edgeDistance, "3", "mm"), field("pitch_mm", t.pitch, "", "mm"), field("px_per_mm", t.resolution, "", "px/mm"), light);
  }

  // A field that has again what was entered, and keeps what is entered from now on.
  #remembered(field) {
    const value = field.type === "checkbox" ? "checked" : "value";
    field[value] = this.#entered[field.name] ?? field[value];
    field.addEventListener("change", () => {
      this.#entered[field.name] = field[value];
      keep("calibration", JSON.stringify(this.#entered));
    });
    return field;
  }

  #options() {
    return Object.fromEntries(Object.entries(this.#board).map(([name, field]) => [name, field.type === "checkbox" ? field.checked || "" : field.value.trim().replace(",", ".")]));
  }

  #redraw() {
    this.#draw();
    this.#showFrames(); // other marks are searched
  }

  // The drawing is what is printed. A refusal says which value is missing.
  #draw() {
    const t = texts.setup;
    attempt(null, async () => {
      const options = this.#options();
      const { marks } = await requests.layout(options).catch((error) => {
        throw localised(error);
      });
      const picture = make("img", { src: requests.artwork("calibration-board.svg", options), alt: t.artworkAlt(marks.length), className: "artwork" });
      const links = FILES.map((kind) => make("a", { className: "button", href: requests.artwork(`calibration-board.${kind}`, options), download: `calibration-board.${kind}`, textContent: t.artworkFiles[kind] }));
      this.#drawn.replaceChildren(picture, make("div", { className: "buttons" }, ...links,
        make("a", { className: "button", href: requests.artwork("calibration-board-outline.gbr", options), download: "calibration-board-outline.gbr", textContent: t.artworkFiles.outline }), this.#layoutLink(options)));
    }, this.answer).then((fine) => fine || this.#drawn.replaceChildren());
  }

  #layoutLink(options) {
    return button("layout.json", async () => {
      saveFile("layout.json", [JSON.stringify(await requests.layout(options), null, 1)], "application/json");
    }, this.answer);
  }

  #choice() {
    const t = texts.setup;
    if (!this.#runs.length) return make("p", { id: "film-choice", textContent: t.noFrames });
    this.#run = runChoice(this.#runs, this.query.get("run"));
    this.#run.addEventListener("change", () => this.#showFrames(true));
    return make("div", { id: "film-choice" }, labelled(t.run, this.#run), labelled(t.row, this.#row), make("p", { id: "row-shown" }), make("div", { className: "frames" }));
  }

  // The frames of the row, so that a person sees whether every camera shows the board.
  #showFrames(other = !this.#shown) {
    const run = this.#runs.find((r) => r.id === this.#run?.value);
    if (!run) return;
    if (other) Object.assign(this.#row, { max: run.rows - 1, value: this.#rowBefore(run) ?? Math.floor(run.rows / 2) });
    if (this.#shown) stateShown("#/setup/calibration", new URLSearchParams({ run: run.id, row: this.#row.value }));
    this.#shown = run.id;
    this.root.querySelector("#row-shown").textContent = texts.setup.rowOf(this.#row.value, run.rows);
    const figures = Array.from({ length: run.cameras }, (_, camera) => {
      const picture = make("img", { src: requests.frame(run.id, camera, this.#row.value), alt: texts.setup.frameOf(camera, this.#row.value) });
      const name = make("figcaption", {}, make("span", { textContent: texts.setup.frameOf(camera, this.#row.value) }), make("strong"));
      picture.onerror = () => (name.firstChild.textContent += texts.unloadable);
      return make("figure", {}, make("div", { className: "marked" }, picture), name);
    });
    this.root.querySelector(".frames").replaceChildren(...figures);
    rest.unattended(this.#findMarks(run, figures));
  }

  // The marks that are searched: of the chosen layout.json, else of the artwork of this page.
  async #searchedFor() {
    const { pitch_mm, px_per_mm } = this.#options();
    return { layout: this.#layout ?? (await requests.layout(this.#options())), pitch_mm: Number(pitch_mm) || null, px_per_mm: Number(px_per_mm) || null };
  }

  // The marks over the frames, one after the other, and how many of those that are expected: what is laid wrongly is seen before a trial.
  async #findMarks(run, figures) {
    const turn = ++this.#searched;
    const wanted = { run: run.id, row: Number(this.#row.value), ...(await this.#searchedFor()) };
    for (const [camera, figure] of figures.entries()) {
      if (turn !== this.#searched || this.#closed) return;
      const marks = await requests.findMarks({ ...wanted, camera }).catch((error) => {
        if (error instanceof rest.Refusal) return null; // this frame never arrived
        throw error;
      });
      if (!marks) continue;
      showCount(figure.querySelector("strong"), marks);
      figure.firstChild.append(svgOfMarks(marks));
    }
  }

  // A board that has passed is shown at once: it is laid, filmed and watched without a press on this page.
  onEvent(event) {
    if (event.kind === "run" && !UNFINISHED.includes(event.state) && !this.#runs.some((run) => run.id === event.run)) rest.unattended(this.#offerNew());
  }

  async #offerNew() {
    const known = this.#runs[0]?.id;
    await this.#readRuns();
    if (this.#closed || this.#runs[0]?.id === known) return;
    this.query.delete("run");
    this.root.querySelector("#film-choice").replaceWith(this.#choice());
    this.#showFrames(true);
  }

  async #readRuns() {
    const { runs } = await rest.runs({ limit: 30 });
    this.#runs = runs.filter((run) => run.finished && (run.frames_available || run.recording));
  }

  #rowBefore(run) {
    const row = this.query.get("row");
    return run.id === this.query.get("run") && Number(row) < run.rows ? row : null;
  }

  #layoutField() {
    const t = texts.setup;
    const file = make("input", { type: "file", accept: ".json,application/json", id: "layout-file", className: "file" });
    const named = make("span", { id: "layout-name" });
    const without = button(t.withoutLayout, () => {
      this.#layout = null;
      [file.value, named.textContent, without.hidden] = ["", "", true];
    }, this.answer, { hidden: true });
    file.addEventListener("change", () => attempt(file, async () => {
      if (!file.files.length) return "";
      const { name } = file.files[0];
      try {
        this.#layout = JSON.parse(await file.files[0].text());
      } catch {
        throw new Wrong(t.noLayout(name));
      }
      [named.textContent, without.hidden] = [name, false];
      return "";
    }, this.answer));
    const field = labelled(t.layoutFile, file, { help: t.layoutHelp });
    field.append(make("div", { className: "buttons" }, make("label", { htmlFor: file.id, className: "button", textContent: t.chooseFile }), without), named);
    return field;
  }

  #limitFields() {
    const t = texts.setup;
    return [["working_distance_mm", "", "mm"], ["center_tolerance_mm", "2", "mm"], ["residual_limit_px", "0.2", "px"], ["mark_accuracy_um", "0", "µm"], ["flatness_um", "0", "µm"]].map(([name, value, unit]) => {
      this.#limits[name] = this.#remembered(input(name, value, { inputMode: "decimal" }));
      return labelled(t.limitNames[name], this.#limits[name], { unit });
    });
  }

  async #begin() {
    const t = texts.setup;
    if (!this.#run) throw new Wrong(t.noFrames);
    const values = Object.entries(this.#limits).map(([name, field]) => [name, field.value.trim().replace(",", ".")]).filter(([, value]) => value !== "");
    const wrong = values.find(([, value]) => !Number.isFinite(Number(value)));
    if (wrong) throw new Wrong(t.notNumber(t.limitNames[wrong[0]], wrong[1]));
    const options = this.#options();
    const only = this.#only.value === "" ? {} : { camera: Number(this.#only.value) };
    const design = Object.fromEntries(["pitch_mm", "px_per_mm"].filter((name) => options[name] !== "").map((name) => [name, Number(options[name])]));
    try {
      const layout = this.#layout ?? (await requests.layout(options));
      await requests.beginTrial({ run: this.#run.value, row: Number(this.#row.value), layout, ...only, ...design, ...Object.fromEntries(values.map(([name, value]) => [name, Number(value)])) });
    } catch (error) {
      throw localised(error);
    }
    // The button is below what it shows.
    await this.#follow(() => this.#judged.scrollIntoView({ block: "nearest" }));
    return "";
  }

  // Show the latest trial, again and again while it is made. The station keeps it, so that a page that is loaded anew goes on.
  async #follow(shown = () => {}) {
    for (;;) {
      // An answer that is lost on its way ends nothing: the station goes on.
      const trial = await requests.trial().catch((error) => {
        if (error instanceof TypeError || error.status >= 500) return null;
        throw error;
      });
      if (this.#closed) return;
      if (trial) this.#judged.replaceChildren(...this.#shownTrial(trial));
      if (trial) shown();
      shown = () => {}; // a person who scrolls on is not brought back
      if (trial && !UNDER_WAY.includes(trial.state)) return;
      await new Promise((done) => setTimeout(done, POLL_MS));
    }
  }

  #shownTrial(trial) {
    const t = texts.setup;
    if (trial.state === "none") return [];
    const title = `${t.trialStates[trial.state]}: ${t.trialOf(trial.run, trial.row, moment(trial.begun))}`;
    if (UNDER_WAY.includes(trial.state)) {
      const bar = make("progress", { max: trial.frames + 1, value: trial.frames_read, ariaLabel: title });
      return [section(title, bar, make("p", { textContent: t.trialProgress(trial.frames_read, trial.frames) }))];
    }
    const refused = trial.message ? make("p", { className: "answer refused" }, ...said(`${trial.message} ${trial.action ?? ""}`.trim(), t.trialRefused)) : "";
    const figures = trial.cameras.length ? table(t.trialColumns, trial.cameras.map((c) => [
      c.name, t.ofAll(c.used, c.marks), ...[[c.residual_px, 3], [c.corner_sigma_px, 3], [c.distortion_px, 3], [c.changed_px, 2]].map(([value, digits]) => (value == null ? "–" : number(value, digits))), make("span", {}, ...(c.refusal ? said(c.refusal, t.refusedCamera) : [t.good])),
    ])) : "";
    const against = trial.shift_mm ? facts([
      [t.inForce, trial.in_force_created ? moment(trial.in_force_created) : "–"], [t.boardShift, t.millimetres(trial.shift_mm.map((v) => number(v, 3)).join(" / "))], [t.turn, `${number(trial.turned_deg, 4)}°`],
    ]) : "";
    const pictures = trial.cameras.length ? ["marks", ...(trial.shift_mm ? ["difference"] : [])].map((name) => {
      const picture = make("img", { src: requests.trialPicture(name, trial.begun), alt: t.trialPictures[name] });
      return make("figure", {}, make("a", { href: picture.src, target: "_blank" }, picture), make("figcaption", { textContent: t.trialPictures[name] }));
    }) : [];
    const discard = button(t.discardTrial, async () => {
      await requests.discardTrial();
      await this.#follow();
      return "";
    }, this.answer, { id: "discard-trial" });
    const orders = trial.state === "judged" ? make("div", { className: "buttons" }, button(t.accept, async () => {
      await requests.acceptTrial();
      await this.#follow();
      return "";
    }, this.answer, { className: "primary", id: "accept" }), make("a", { className: "button", href: requests.trialCalibration, download: "calibration.json", textContent: t.download }), discard) : make("div", { className: "buttons" }, discard);
    const written = trial.state === "accepted" ? make("p", { className: "answer done", textContent: (trial.camera == null ? t.acceptedAs : t.acceptedAlone)(trial.accepted_as, trial.backup) }) : "";
    return [section(title, refused, written, figures, make("ul", { className: "warnings" }, ...trial.notes.map(({ code, message, values }) => make("li", {}, ...said(message, texts.translated.notes[code]?.(values))))), against, orders, make("div", { className: "pictures" }, ...pictures))];
  }
}
