// One board type: its drawing, state and revision, marks, earlier versions, and its reference run.
import { make, said } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { moment, number, texts } from "../texts/texts.js";
import { boardDrawing } from "./drawing.js";
import { button, facts, input, labelled, runChoice, section, SetupPage } from "./fields.js";
import { mmPerUnit } from "./geometry.js";
import { markChoice } from "./marks.js";
import * as requests from "./requests.js";
import { typeAddress } from "./types.js";

const MOST_RUNS = 20;

export class Page extends SetupPage {

  async show(said = "") {
    const t = texts.setup;
    const [{ content: type, tag }, versions, { runs }, reference] = await Promise.all([
      requests.boardType(this.name), requests.versions(this.name), rest.runs({ board_type: this.name, limit: MOST_RUNS }),
      requests.reference(this.name).catch((error) => {
        if (error.code === "no-reference") return null;
        throw error;
      }),
    ]);
    const side = make("div", { className: "column" }, this.#about(type), this.#state(type, tag), this.#lay(runs), this.#reference(reference, runs),
      this.#marks(type, tag), this.#versions(versions), this.#end());
    this.root.replaceChildren(make("a", { href: "#/setup/types", className: "up", textContent: t.toTypes }), make("h2", { textContent: type.name }), this.answer,
      make("div", { className: "two" }, boardDrawing(type), side));
    if (said) this.answer.textContent = said;
  }

  // A button whose work changes the board type, after which the page is shown anew.
  #order(text, work, said, fields = {}) {
    return button(text, async () => {
      await work();
      await this.show();
      return said;
    }, this.answer, fields);
  }

  #about(type) {
    const t = texts.setup;
    const guessed = type.components.filter((part) => part.size_from === "guess").length;
    return section(t.about, facts([
      [t.sideUp, t.sides[type.side ?? "top"]], [t.componentsOf, String(type.components.length)], [t.fiducialCount, String(type.fiducials.length)],
      [t.unit, type.unit ?? "mm"], [t.guessed, guessed ? t.ofAll(guessed, type.components.length) : ""],
      [t.tallest, type.components.some((part) => part.body_height) ? t.millimetres(number(Math.max(...type.components.map((part) => part.body_height ?? 0)) * mmPerUnit(type), 2)) : ""],
    ]));
  }

  #state(type, tag) {
    const t = texts.setup;
    const state = type.state ?? "approved";
    const revision = input("revision", type.revision ?? "", { maxLength: 40 });
    // An order that states no revision keeps it; a field that was emptied takes it out of the document.
    const store = (wanted) => {
      const stated = revision.value.trim();
      if (stated || !type.revision) return requests.setState(type.name, wanted, stated);
      return requests.storeType({ ...type, state: wanted, revision: undefined }, requests.ifStill(tag));
    };
    const set = (wanted) => this.#order(t.setState[wanted], () => store(wanted), t.stateIs(t.states[wanted]), { className: wanted === "approved" ? "primary" : "" });
    const others = ["approved", "draft", "retired"].filter((wanted) => wanted !== state);
    return section(t.stateTitle, make("p", {}, make("span", { className: `state ${state}`, textContent: t.states[state] }), ` – ${t.stateMeans[state]}`),
      labelled(t.revision, revision), make("div", { className: "buttons" }, ...others.map(set),
        this.#order(t.keepRevision, () => store(state), t.kept)));
  }

  #lay(runs) {
    const t = texts.setup;
    const seen = runs.filter((run) => run.verdict && run.verdict !== "failed" && run.frames_available);
    return section(t.layTitle, make("p", { className: "help", textContent: seen.length ? t.layHelp : t.noRuns }),
      seen.length ? make("a", { href: typeAddress(this.name, "lay"), className: "button", id: "lay", textContent: t.lay }) : "");
  }

  #reference(reference, runs) {
    const t = texts.setup;
    const good = runs.filter((run) => run.verdict === "ok" && run.frames_available);
    const run = runChoice(good);
    const fault = reference?.fault ? [" ", ...said(`${reference.fault.message} ${reference.fault.action}`, texts.translated.refusals["reference-unusable"])] : [];
    const now = reference ? [t.referenceIs(reference.run, moment(reference.taught), reference.frames), ...fault] : [t.noReference];
    return section(t.referenceTitle, make("p", {}, ...now), good.length ? labelled(t.run, run) : make("p", { className: "help", textContent: t.noGoodRun }),
      make("div", { className: "buttons" },
        good.length ? this.#order(t.teach, () => requests.teach(this.name, run.value), t.taught) : "",
        reference ? this.#order(t.forget, () => requests.forget(this.name), t.forgotten, { className: "plain" }) : ""));
  }

  #marks(type, tag) {
    const t = texts.setup;
    let chosen = null;
    const store = this.#order(t.storeMarks, () => requests.storeType({ ...type, ...chosen, state: "draft" }, requests.ifStill(tag)), t.storedDraft);
    store.disabled = true;
    return section(t.marksTitle, markChoice(type, (marks) => {
      chosen = marks;
      store.disabled = false;
      this.root.querySelector(".drawing").replaceWith(boardDrawing({ ...type, ...marks }));
    }), make("div", { className: "buttons" }, store));
  }

  #versions(versions) {
    const t = texts.setup;
    if (!versions.length) return section(t.versionsTitle, make("p", { className: "help", textContent: t.noVersions }));
    const back = this.#order(t.stepBack, () => requests.restore(this.name, versions[0].id), t.restored, { id: "step-back" });
    const earlier = versions.slice(1).map((version) => make("li", {}, make("span", { textContent: t.versionOf(moment(version.stored), moment(version.ended)) }),
      this.#order(t.restore, () => requests.restore(this.name, version.id), t.restored)));
    return section(t.versionsTitle, make("p", { textContent: t.versionOf(moment(versions[0].stored), moment(versions[0].ended)) }), back,
      earlier.length ? make("details", {}, make("summary", { textContent: t.earlier(earlier.length) }), make("ul", { className: "links" }, ...earlier)) : "");
  }

  #end() {
    return button(texts.setup.remove, async () => {
      await requests.deleteType(this.name);
      location.hash = "#/setup/types";
    }, this.answer, { className: "plain" });
  }
}
