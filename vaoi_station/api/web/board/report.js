// The report of a board in words and figures: why its verdict is what it is.
import { identityOf } from "../parts/identity.js";
import { lines, make, said } from "../parts/elements.js";
import { moment, number, texts } from "../texts/texts.js";

const SEAM = "seam_px:"; // and the numbers of two cameras
const figureNames = texts.trends.figures;

export function showReport(root, run, { parts, overlay }) {
  const reasons = run.reasons.map((reason) => make("li", {}, ...reasonSaid(reason)));
  root.replaceChildren(
    make("ul", { id: "verdict-reasons" }, ...reasons),
    make("dl", { id: "facts" }, ...lines([...facts(run), ...figures(run.figures ?? {}, parts, overlay)])),
  );
}

// A reason with what to do; translated by its cause, or its code.
export const reasonSaid = ({ cause, code, message, action }) => said(`${sentence(message)} ${sentence(action)}`.trim(), texts.reasons[cause] ?? texts.reasons[code]);

// The reasons of results begin with a small letter and have no full stop.
export const sentence = (text) => text && `${text[0].toUpperCase()}${text.slice(1)}${/[.!?]$/.test(text) ? "" : "."}`;

// The largest residual of the proof in µs; "" if no frame has one.
function within(proof) {
  const residuals = proof.cameras.map((camera) => camera.max_residual_us).filter((us) => us != null);
  return residuals.length ? number(Math.max(...residuals), 1) : "";
}

function facts(run) {
  const { ok, incomplete, missing, unproven } = run.counts;
  const names = texts.facts;
  return [
    [names.type, [run.board_type, run.made_with?.board_type_revision].filter(Boolean).join(", ")],
    ...(run.job_id ? [[names.job, run.job_id]] : []),
    ...(run.identity ? [[names.identity, identityOf(run)]] : []),
    [names.run, run.id],
    ...(run.finished ? [[names.since, moment(run.finished)]] : []),
    [names.frames, texts.frames(ok, incomplete, missing, unproven, run.rows, run.cameras)],
    ...(run.unseen?.length ? [[figureNames.unseen_parts, texts.unseen(run.unseen)]] : []),
    ...(run.skipped_boards?.length ? [[names.skipped, run.skipped_boards.join(", ")]] : []),
    ...(run.proof ? [[names.trigger, texts.trigger(run.proof, within(run.proof))]] : []),
    ...(run.belt ? [[figureNames.belt_mm_s, `${number(Math.hypot(...run.belt.measured_mm_s), 2)} mm/s`], [figureNames.slip_percent, `${number(100 * (run.belt.ratio - 1), 2)} %`]] : []),
    ...(run.timings?.ready_after_last_frame_ms == null ? [] : [[figureNames.ready_ms, `${number(run.timings.ready_after_last_frame_ms)} ms`]]),
    [names.software, `${run.software.station}`],
  ];
}

// The figures behind the verdict: those that the trends have too, and what is drawn over the board.
function figures(known, parts, overlay) {
  const found = [];
  const worst = parts.filter((part) => part.sigma_px != null).sort((a, b) => b.sigma_px - a.sigma_px)[0];
  if (worst) found.push([figureNames.sigma_px, `${number(worst.sigma_px, 3)} px, ${number(worst.sigma_mm * 1000, 1)} µm (${worst.address})`]);
  if (known.residual_px != null) found.push([figureNames.residual_px, `${number(known.residual_px, 3)} px`]);
  const seams = Object.entries(known).filter(([name]) => name.startsWith(SEAM));
  if (seams.length) found.push([figureNames.seam_px, seams.map(([name, px]) => `${name.slice(SEAM.length)}: ${number(px, 3)} px`).join(", ")]);
  if (!overlay) return found;
  const linked = overlay.links.filter((pair) => pair.used);
  if (linked.length) {
    const used = linked.reduce((sum, pair) => sum + pair.used, 0);
    found.push([texts.board.links, texts.board.linkFigures(number(used), linked.length)]);
  }
  const without = overlay.links.filter((pair) => !pair.used);
  if (without.length) found.push([texts.board.unlinked, said([...new Set(without.map((pair) => `${pair.a.join("/")} – ${pair.b.join("/")}: ${pair.why}`))].slice(0, 12).join("; "))]);
  const marks = overlay.fiducials.map((mark) => `${mark.name}: ${mark.residual_px == null ? texts.board.notFoundMark : `${number(mark.residual_px, 3)} px`}`);
  if (marks.length) found.push([texts.board.fiducials, marks.join(", ")]);
  return found;
}
