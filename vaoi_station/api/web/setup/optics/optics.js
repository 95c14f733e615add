// Optics: the plan of a line as a form, drawn to scale, with every constraint and what would mend those that are violated.
import { make, markWrong } from "../../parts/elements.js";
import { stateShown } from "../../parts/settings.js";
import { entered, language, texts } from "../../texts/texts.js";
import { attempt, facts, input, labelled, say, section, SetupPage, table, Wrong } from "../fields.js";
import * as requests from "../requests.js";
import { lineDrawing } from "./line_drawing.js";

const UNITS = {
  width_mm: "mm", longest_board_mm: "mm", resolution_px_per_mm: "px/mm", depth_of_field_mm: "mm", sensor_px_h: "px", sensor_px_v: "px", sensor_width_mm: "mm", circle_of_confusion_mm: "mm", distance_max_mm: "mm",
  distance_min_mm: "mm", lens_mm: "mm", speed_mm_s: "mm/s", exposure_us: "µs", readout_us: "µs", frame_rate_hz: "1/s", blur_px: "px", link_mbit_s: "Mbit/s", camera_link_mbit_s: "Mbit/s", packet_bytes: "B",
};
const GROUPS = {
  board: ["width_mm", "longest_board_mm", "resolution_px_per_mm", "depth_of_field_mm"],
  sensor: ["sensor_px_h", "sensor_px_v", "sensor_width_mm", "circle_of_confusion_mm", "bits_per_pixel"],
  lens: ["distance_max_mm", "distance_min_mm", "lens_mm", "f_number"],
  motion: ["speed_mm_s", "blur_px", "exposure_us", "readout_us", "frame_rate_hz", "multiplicity_v"],
  array: ["cameras", "multiplicity_h", "link_mbit_s", "camera_link_mbit_s", "packet_bytes", "runs_in_memory"],
};
const REQUIRED = ["width_mm", "resolution_px_per_mm", "speed_mm_s", "sensor_px_h", "sensor_px_v", "sensor_width_mm", "distance_max_mm"];
const CHOSEN = ["lens_mm", "f_number", "cameras", "frame_rate_hz", "exposure_us"];
const OPEN = ["distance_min_mm", "depth_of_field_mm", "circle_of_confusion_mm", "longest_board_mm", "link_mbit_s", "camera_link_mbit_s"];
const ALL = Object.values(GROUPS).flat();

const shown = (value, unit = "") => {
  if (value == null) return "–";
  const digits = Math.abs(value) >= 100 ? 1 : Math.abs(value) >= 1 ? 2 : 4;
  const text = value.toLocaleString(language, { maximumFractionDigits: digits });
  return unit ? `${text} ${unit}` : text;
};

const plain = (textContent, onclick) => make("button", { type: "button", textContent, onclick });

export class Page extends SetupPage {
  #drawn = make("div");
  #found = make("div", { className: "column" });
  #mended = make("div", { className: "column" });
  #page = make("div", { className: "two optics unplanned" });
  #fields = {};
  #turn = 0; // an answer to an earlier request is not shown

  async show() {
    const [t, { query }] = [texts.optics, this];
    for (const name of ALL) {
      this.#fields[name] = input(name, "", { inputMode: "decimal", required: REQUIRED.includes(name), id: `optics-${name}` });
      this.#fields[name].addEventListener("change", () => {
        this.#source(name, "");
        this.#plan();
      });
    }
    const form = make("form", { className: "optics-form" }, ...Object.entries(GROUPS).map(([group, names]) =>
      make("fieldset", {}, make("legend", { textContent: t.groups[group] }), make("div", { className: "fields" }, ...names.map((name) => this.#field(name))))));
    form.addEventListener("submit", (event) => event.preventDefault());
    const starts = ["station", "paper"].map((of) => plain(of === "station" ? t.ofStation : t.ofPaper, () => this.#begin(of)));
    this.#page.append(make("div", { className: "column plan" }, this.#drawn, this.#found), make("div", { className: "column" }, form, this.#mended));
    this.root.replaceChildren(make("h2", { textContent: texts.setup.pages.optics }), make("p", { className: "help", textContent: t.help }), make("div", { className: "buttons" }, ...starts), this.answer,
      this.#page);
    const given = ALL.filter((name) => query.has(name));
    if (!given.length) return this.#begin("station");
    for (const name of given) this.#fields[name].value = Number.isFinite(Number(query.get(name))) ? entered(Number(query.get(name))) : query.get(name);
    return this.#plan();
  }

  #field(name) {
    const t = texts.optics;
    return labelled(t.names[name], this.#fields[name], { unit: UNITS[name] ?? "", help: this.#otherwise(name) || " " });
  }

  // What holds while a field is empty.
  #otherwise(name) {
    const t = texts.optics;
    if (CHOSEN.includes(name)) return t.chosen;
    if (OPEN.includes(name)) return t.open;
    return REQUIRED.includes(name) ? t.required : "";
  }

  // Says below a field where its value comes from, as long as no person has changed it.
  #source(name, source) {
    const t = texts.optics;
    this.#fields[name].nextElementSibling.textContent = source ? t.from(source) : this.#otherwise(name);
  }

  async #begin(of) {
    const turn = ++this.#turn;
    const fine = await attempt(null, async () => {
      const { values, sources } = await requests.opticsRequirements(of);
      if (turn !== this.#turn) return; // a person has entered a value or chosen other values meanwhile
      for (const name of ALL) {
        this.#fields[name].value = name in values ? entered(values[name]) : "";
        this.#source(name, sources[name]);
      }
    }, this.answer);
    if (fine && turn === this.#turn) await this.#plan();
  }

  // The values as the station takes them; what is empty is absent.
  #values() {
    const given = ALL.map((name) => [name, this.#fields[name].value.trim().replace(",", ".")]).filter(([, value]) => value !== "");
    const wrong = given.find(([, value]) => !Number.isFinite(Number(value)));
    if (wrong) {
      this.#mark([wrong[0]]);
      throw new Wrong(texts.setup.notNumber(texts.optics.names[wrong[0]], wrong[1]));
    }
    return Object.fromEntries(given);
  }

  // Which field is meant: of a limit the place, of a contradiction the name in the message.
  #refuse(error) {
    const wrong = ALL.filter((name) => error.errors?.some((e) => e.where.endsWith(`.${name}`)) || error.message.includes(`: ${name} `));
    this.#mark(wrong);
    if (wrong.length) error.translation = texts.optics.wrong(wrong.map((name) => texts.optics.names[name]));
  }

  #mark(names) {
    for (const name of ALL) markWrong(this.#fields[name], names.includes(name));
  }

  async #plan() {
    const turn = ++this.#turn;
    let missing = [];
    const fine = await attempt(null, async () => {
      this.#mark([]);
      const values = this.#values();
      stateShown("#/setup/optics", new URLSearchParams(values));
      missing = REQUIRED.filter((name) => !(name in values));
      let plan = null;
      try {
        if (!missing.length) plan = await requests.opticsPlan(values);
      } catch (error) {
        if (turn === this.#turn) this.#refuse(error);
        throw error;
      }
      if (turn !== this.#turn) return;
      this.#page.classList.toggle("unplanned", !plan);
      if (plan) this.#showPlan(plan);
      else for (const place of [this.#drawn, this.#found, this.#mended]) place.replaceChildren();
    }, this.answer);
    if (turn === this.#turn) for (const name of REQUIRED) this.#fields[name].parentElement.classList.toggle("wanted", fine && missing.includes(name));
    if (fine && missing.length) say(this.answer, texts.optics.fillIn(missing.map((name) => texts.optics.names[name])), "missing");
  }

  #showPlan(plan) {
    const t = texts.optics;
    this.#drawn.replaceChildren(section(t.drawing, lineDrawing(plan), plan.data.rows == null ? make("p", { className: "help", textContent: t.noLength }) : ""));
    this.#found.replaceChildren(section(t.constraints, this.#constraints(plan)), section(t.results, this.#results(plan)));
    this.#mended.replaceChildren(...this.#remedies(plan));
  }

  #constraints({ constraints }) {
    const t = texts.optics;
    const violated = constraints.filter((c) => c.ok === false).length;
    const rows = constraints.map((c) => {
      const state = c.ok == null ? t.notChecked(c.missing.map((name) => t.names[name])) : c.ok ? t.met : t.violated;
      const name = make("span", {}, t.constraintNames[c.name], make("span", { className: "equation", textContent: c.equation }));
      const compared = c.limit == null ? shown(c.value, c.unit) : `${shown(c.value)} ${c.relation} ${shown(c.limit, c.unit)}`;
      return [name, compared, shown(c.margin), make("span", { className: `constraint ${c.ok == null ? "open" : c.ok ? "met" : "violated"}`, textContent: state })];
    });
    const all = make("p", { className: "verdict", role: "status", textContent: violated ? t.someViolated(violated) : t.allMet });
    return make("div", { className: "constraints" }, all, table(t.columns, rows));
  }

  #results({ requirements: asked, array, lens, motion, data }) {
    const [t, names] = [texts.optics, texts.optics.figures];
    const megabytes = (bytes) => (bytes == null ? null : shown(bytes / 1e6, "MB"));
    return facts([
      [names.cameras, t.camerasNeeded(array.cameras, shown(array.cameras_needed))], [names.view, `${shown(array.field_width_mm)} × ${shown(array.field_height_mm, "mm")}`], [names.pitch, shown(array.camera_pitch_mm, "mm")],
      [names.overlap, array.cameras > 1 ? shown(array.field_width_mm - array.camera_pitch_mm, "mm") : null], [names.focal, shown(lens.focal_length_mm, "mm")], [names.lens, shown(lens.lens_mm, "mm")], [names.distance, shown(lens.working_distance_mm, "mm")],
      [names.aperture, lens.f_number == null ? "–" : `f/${shown(lens.f_number)}`], [names.depth, shown(lens.depth_of_field_mm, "mm")], [names.airy, shown(lens.airy_disc_px, "px")],
      [names.exposure, t.upTo(shown(motion.exposure_us, "µs"), shown(motion.longest_exposure_us, "µs"))], [names.rate, t.atLeast(shown(motion.frame_rate_hz), shown(motion.lowest_frame_rate_hz))],
      [names.period, t.spare(shown(motion.trigger_period_us / 1000, "ms"), shown(motion.spare_time_us / 1000, "ms"))], [names.step, shown(motion.row_step_mm, "mm")], [names.multiplicity, t.seenBy(shown(array.multiplicity_h), shown(motion.multiplicity_v))],
      [names.parallaxRow, t.perHeight(shown(motion.parallax_px_per_mm))], [names.parallaxCamera, t.perHeight(shown(array.parallax_px_per_mm))], [names.data, shown(data.data_rate_mbit_s, "Mbit/s")],
      [names.capture, data.rows == null ? null : shown(data.capture_duration_s, "s")], [names.rows, data.rows == null ? null : shown(data.rows)], [names.memory, megabytes(data.run_bytes)], [names.ring(asked.runs_in_memory), megabytes(data.ring_bytes)],
    ]);
  }

  // One press enters the value, so that its consequences are seen at once.
  #remedies({ constraints, remedies }) {
    const t = texts.optics;
    if (!remedies.length) return [];
    const groups = constraints.filter((c) => c.ok === false).map(({ name }) => {
      const ways = remedies.filter((remedy) => remedy.constraint === name).map((remedy) => {
        const enter = plain(t.setTo(t.names[remedy.requirement], shown(remedy.value, UNITS[remedy.requirement] ?? "")), () => {
          this.#fields[remedy.requirement].value = entered(remedy.value);
          this.#source(remedy.requirement, "");
          this.#plan();
        });
        const also = remedy.violates.length ? make("span", { className: "help", textContent: t.alsoViolates(remedy.violates.map((other) => t.constraintNames[other])) }) : "";
        return make("li", {}, enter, also);
      });
      return [make("h4", { textContent: t.constraintNames[name] }), make("ul", { className: "ways" }, ...ways)];
    });
    return [section(t.remedies, make("p", { className: "help", textContent: t.remediesHelp }), ...groups.flat())];
  }
}
