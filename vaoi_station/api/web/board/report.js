// The report of a board in words and figures: why its verdict is what it is.
import { identityOf } from "../parts/identity.js";
import { make, said } from "../parts/elements.js";
import { moment, number, texts } from "../texts/texts.js";

export function showReport(root, run, { parts, overlay }) {
  const reasons = run.reasons.map((reason) => make("li", {}, ...said(`${reason.message} ${reason.action}`.trim(), translatedReason(reason))));
  root.replaceChildren(
    make("ul", { id: "verdict-reasons" }, ...reasons),
    make("dl", { id: "facts" }, ...lines([...facts(run), ...figures(parts, overlay)])),
  );
}

// By its cause, or its code.
const translatedReason = ({ cause, code }) => texts.translated.reasons[cause] ?? texts.translated.reasons[code];

// The largest residual of the proof in µs; "" if no frame has one.
function within(proof) {
  const residuals = proof.cameras.map((camera) => camera.max_residual_us).filter((us) => us != null);
  return residuals.length ? number(Math.max(...residuals), 1) : "";
}

const lines = (found) => found.flatMap(([name, value]) => [make("dt", { textContent: name }), make("dd", {}, ...[value].flat())]);

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
    ...(run.unseen?.length ? [[names.unseen, texts.unseen(run.unseen)]] : []),
    ...(run.skipped_boards?.length ? [[names.skipped, run.skipped_boards.join(", ")]] : []),
    ...(run.proof ? [[names.trigger, texts.trigger(run.proof, within(run.proof))]] : []),
    ...(run.belt ? [[names.belt, texts.belt(number(Math.hypot(...run.belt.measured_mm_s), 2), number(run.belt.ratio * 100, 2))]] : []),
    ...(run.timings?.ready_after_last_frame_ms == null ? [] : [[names.result, texts.resultAfter(number(run.timings.ready_after_last_frame_ms))]]),
    [names.software, `${run.software.station}`],
  ];
}

// The figures behind the verdict, from what is drawn over the board.
function figures(parts, overlay) {
  const found = [];
  const worst = parts.filter((part) => part.sigma_px != null).sort((a, b) => b.sigma_px - a.sigma_px)[0];
  if (worst) found.push([texts.board.worstSigma, `${number(worst.sigma_px, 3)} px, ${number(worst.sigma_mm * 1000, 1)} µm (${worst.address})`]);
  if (!overlay) return found;
  const linked = overlay.links.filter((pair) => pair.used);
  if (linked.length) {
    const used = linked.reduce((sum, pair) => sum + pair.used, 0);
    const rms = Math.sqrt(linked.reduce((sum, pair) => sum + pair.used * pair.rms_px ** 2, 0) / used);
    found.push([texts.board.linkFit, texts.board.linkFigures(number(used), linked.length, number(rms, 3))]);
    const seam = linked.filter((pair) => pair.a[0] !== pair.b[0]).sort((a, b) => b.residual_px - a.residual_px)[0];
    if (seam) found.push([texts.board.worstSeam, `${number(seam.residual_px, 3)} px (${seam.a.join("/")} – ${seam.b.join("/")})`]);
  }
  const without = overlay.links.filter((pair) => !pair.used);
  if (without.length) found.push([texts.board.unlinked, said([...new Set(without.map((pair) => `${pair.a.join("/")} – ${pair.b.join("/")}: ${pair.why}`))].slice(0, 12).join("; "))]);
  const marks = overlay.fiducials.map((mark) => `${mark.name}: ${mark.residual_px == null ? texts.board.notFoundMark : `${number(mark.residual_px, 3)} px`}`);
  if (marks.length) found.push([texts.board.fiducials, marks.join(", ")]);
  return found;
}
