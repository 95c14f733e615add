// Which word, sign and order the operator is shown, from the station's state, its reasons and the last boards.
// docs/operator.md has the same as a table; tests/api/web/test_orders.py compares them.
import { clock, texts } from "../texts/texts.js";

// What a reason of the station asks for, besides holding boards back.
const GROUPS = {
  camera: ["camera-lost", "camera-absent"],
  controller: [
    "controller-silent", "controller-not-ready", "controller-reset", "controller-safe", "foreign-device", "port-absent", "port-lost",
  ],
  wait: ["acquisition-lost", "workers-starting", "devices-silent", "thread-lost", "worker-lost", "line-filming"],
  board: ["board-in-barrier"],
  belt: ["belt-stopped"],
  none: ["ring-full", "memory-short", "line-not-armed", "no-order"],
};
const DISK = /^(storage|database|store$)/;

export function stationGroup(code) {
  const found = Object.keys(GROUPS).find((group) => GROUPS[group].includes(code));
  return found ?? (DISK.test(code) ? "disk" : "engineer");
}

// What the reason of a run asks for: by its cause, or its code.
const BOARD_GROUPS = {
  again: [
    "no-frames", "camera-absent", "trigger-doubtful", "rows-lost", "rows-not-connected", "frames-unconfirmed", "rows-not-chained",
    "frames-missing", "frames-incomplete", "boards-too-close", "run-too-long", "run-cut-short", "acquisition-lost", "station-restarted",
    "worker-lost",
  ],
  flat: ["board-off-plane", "links-scatter", "surface-unlikely"],
  right: [
    "fiducials-not-found", "outline-shifted", "outline-turned", "outline-invisible", "board-turned", "texture-off-board",
    "reference-contradicts", "unlisted-parts",
  ],
  marks: ["fiducial-missing", "fiducial-off-place", "local-fiducial-unusable", "board-unplaced", "bad-board-doubtful"],
  light: ["no-texture", "light-dark", "overlap-blank", "overlap-exposure"],
  place: ["components-unseen"],
  identify: [
    "board-id-differs", "next-machine-differs", "codes-disagree", "product-differs", "code-unread", "identity-not-read", "board-id-uncertain",
    "edge-lost", "order-uncertain",
  ],
  camera: ["wrong-rows", "camera-displaced", "camera-not-calibrated", "lens-differs", "pictures-blurred", "not-explained"],
  type: [
    "overlap-repetitive", "rows-repetitive", "no-board-type", "too-few-fiducials", "fiducial-size", "fiducial-wrong", "scale-wrong",
    "components-shifted", "orientation-ambiguous", "reference-not-found", "positions-uncertain", "no-error-measure", "reference-unusable",
  ],
};

export function boardGroup(reason) {
  const codes = [reason.cause, reason.code];
  for (const code of codes) {
    const found = Object.keys(BOARD_GROUPS).find((group) => BOARD_GROUPS[group].includes(code));
    if (found) return found;
  }
  return codes.some((code) => code?.startsWith("trigger-")) ? "camera" : "again";
}

const TONES = { blocked: "caution", lacking: "caution", held: "caution", uncalibrated: "caution", degraded: "caution", missed: "caution", faulted: "fault", failed: "fault", unknown: "stale" };
export const QUIET = ["armed", "idle"]; // states in which the order may speak of a board that has passed
const OLD_MS = 30 * 60 * 1000;

// Why the next board must wait, without the board that is passing: it needs no order. Cameras that were accepted as lost are not among it.
const heldBy = (now) => now.line_held.filter((reason) => reason.code !== "line-filming");

export function stateOf(now) {
  if (now.state === "idle" && now.warnings.some((w) => w.code === "no-calibration")) return "uncalibrated";
  if (now.state === "armed" && !now.line_ready) return heldBy(now)[0]?.code === "camera-lost" ? "lacking" : "held";
  return now.state in texts.words ? now.state : "unknown";
}

// The board that needs a decision: the newest without pictures, or the last one if they are doubtful. `runs`: oldest first.
export function openBoard(runs, now_ms) {
  const settled = new Set();
  for (const [n, run] of [...runs].reverse().entries()) {
    if (run.decision) settled.add(run.board_id ?? run.id);
    else if (run.verdict === "ok") settled.add(run.board_id ?? run.id);
    else if (run.finished && !settled.has(run.board_id ?? run.id) && now_ms - Date.parse(run.finished) < OLD_MS) {
      if (run.verdict !== "degraded" || n === 0) return { run, last: n === 0 };
    }
  }
  return null;
}

export function short(id) {
  return id && id.length > 14 ? `…${id.slice(-12)}` : id;
}

// Without pictures because frames did not come: what was not found in the rest says nothing about type, direction or fiducials.
const LOST_FRAMES = ["frames-missing", "frames-incomplete"];

// What is to be done with a board, without naming it.
export function boardAdvice(run) {
  const lost = run.verdict !== "degraded" && run.reasons.some((reason) => LOST_FRAMES.includes(reason.code));
  return texts.boardOrders[run.reasons.length && !lost ? boardGroup(run.reasons[0]) : "again"];
}

function boardOrder(run, last) {
  const say = run.verdict === "degraded" ? texts.doubtfulPicturesOf : texts.noPicturesOf;
  return say(texts.boardOf(short(run.board_id), last ? "" : clock(run.started)), boardAdvice(run));
}

// One word, one sign and one order. `boards`: the last ones, and the times of missed ones. `stale`: no data come from the station.
// `board`: the one that needs a decision, also while word and order speak of the station.
export function situation(now, boards, now_ms, stale) {
  const state = stale || !now ? "unknown" : stateOf(now);
  const quiet = QUIET.includes(state);
  const undecided = openBoard(boards.runs, now_ms);
  const open = quiet ? undecided : null;
  const missed = quiet && !open && missedLast(boards, now_ms);
  const shown = open ? (open.run.verdict === "degraded" ? "degraded" : "failed") : missed ? "missed" : state;
  const order = open ? boardOrder(open.run, open.last) : missed ? texts.orders.missed : stateOrder(state, now);
  return { state, shown, tone: TONES[shown] ?? "", word: texts.words[shown], order, board: undecided?.run ?? null };
}

// Whether the board that came last was missed, a short time ago.
function missedLast(boards, now_ms) {
  const time = Date.parse(boards.missed.at(-1));
  const run = boards.runs.at(-1);
  return now_ms - time < OLD_MS && !(run && Date.parse(run.started) > time);
}

function stateOrder(state, now) {
  const hold = texts.orders[state];
  if (state === "armed" && now.warnings.some((w) => w.code === "board-id-uncertain")) return texts.extra.identify;
  if (state === "filming" && heldBy(now)[0]?.code === "belt-stopped") return `${hold} ${texts.extra.belt}`;
  if (!["faulted", "lacking", "held"].includes(state)) return hold;
  const causes = state === "faulted" ? now.reasons : heldBy(now);
  const group = causes.length ? stationGroup(causes[0].code) : state === "faulted" ? "engineer" : "wait";
  if (group === "none") return texts.orders.held;
  return group === "engineer" && state === "faulted" ? hold : `${texts.orders.held} ${texts.extra[group]}`;
}
