// All texts of the pages in English. Another language is another file with the same keys.
import { board } from "./board_en.js";
import { cameras } from "./cameras_en.js";
import { lights } from "./lights_en.js";
import { optics } from "./setup/optics_en.js";
import { settings } from "./setup/settings_en.js";
import { setup } from "./setup_en.js";
import { reasons } from "./station/reasons_en.js";
import { trends } from "./trends_en.js";

export const texts = {
  board,
  cameras,
  lights,
  optics,
  reasons,
  settings,
  setup,
  trends,
  translated: { refused: "", refusals: {}, findings: {}, checks: {}, remarks: {}, notes: {}, program: {} }, // what the station says is English
  // frame of all pages
  line: "Line",
  boards: "Boards",
  setUp: "Set up",
  interface: "API",
  otherLanguage: "Deutsch",
  soundOn: "Sound on",
  soundOff: "Sound off",
  key: "Key",
  logIn: "Log in",
  wrongKey: "This key is not valid. Check that it is complete, or ask for a new one.",
  logInTitle: "This station asks for a key",
  logInHelp: "The key comes from the administrator of the station (vaoi keys create). The login lasts 12 hours, in this browser only.",
  logOut: "Log out",
  noAnswer: "The station did not respond. Try again.",
  noData: (s) => `No data for ${s} s`,
  unloaded: "This view could not be loaded: the station did not send its files. It is tried again as soon as the station responds.",
  loadAgain: "Load again",
  old: "What this page shows is out of date.",
  loading: "Loading …",
  why: "Why?",
  close: "Close",
  details: "Details",
  technical: "Details for the engineer",

  // the word and the order of every state
  words: {
    starting: "Starting",
    idle: "Not armed",
    arming: "Arming",
    armed: "Ready",
    lacking: "Camera missing",
    held: "Hold",
    filming: "Filming",
    blocked: "Memory full",
    faulted: "Fault",
    stopping: "Stopping",
    unknown: "No data",
    failed: "Board failed",
    degraded: "Check board",
    missed: "Board missed",
  },
  orders: {
    starting: "Hold boards back. Wait.",
    idle: "Choose the type, press Arm.",
    arming: "Hold the next board back.",
    armed: "Let the next board in.",
    lacking: "Hold the next board back.",
    held: "Hold the next board back.",
    filming: "Do not touch the board.",
    blocked: "Hold the next board back.",
    faulted: "Hold boards back. Call the engineer.",
    stopping: "Hold the next board back.",
    unknown: "Hold boards back. Check station and network.",
    missed: "A board was not filmed. Film it again.",
  },
  // What else is to be done, by the group of a reason's code (parts/orders.js).
  extra: {
    camera: "Check the camera's cable.",
    controller: "Check the controller's cable.",
    disk: "Call the administrator: data disk.",
    wait: "Wait.",
    engineer: "Call the engineer.",
    identify: "Arm again with its id.",
    board: "Take the board out of the barrier.",
    belt: "Start the belt.",
  },
  // What to do about a board whose pictures are not good, by the group of a reason's cause.
  boardOrders: {
    again: "Take it out and film it again.",
    flat: "Lay it flat and film it again.",
    right: "Check type and direction. Film it again.",
    marks: "Clean its fiducials. Film it again.",
    light: "Check light and glass. Film it again.",
    place: "Check its place. Film it again.",
    identify: "Identify the board.",
    camera: "Call the engineer: cameras.",
    type: "Call the engineer: board type.",
  },
  boardOf: (id, time) => (id ? `Board ${id}` : time ? `Board of ${time}` : "The last board"),
  noPicturesOf: (board, order) => `${board}: no pictures. ${order}`,
  doubtfulPicturesOf: (board, order) => `${board}: ${order}`,
  nextTry: (name, time) => `Next attempt for ${name}: ${time}.`,
  camera: (name) => (name.toLowerCase().startsWith("camera") ? name : `camera ${name}`),

  // arming
  boardType: "Board type",
  boardId: "Board id",
  arm: "Arm",
  armAnyway: "Arm without this camera",
  disarm: "Disarm: hold",
  armedWith: (armed, lost) =>
    [`Armed for ${armed.board_type}`, armed.board_id && `board ${armed.board_id}`, armed.job_id && `job ${armed.job_id}`, lost.length && `without ${lost.join(", ")}`]
      .filter(Boolean)
      .join(", "),
  armedFor: (type) => `Armed for ${type}.`,
  disarmed: "Disarmed.",
  unusable: "unusable",
  acknowledge: (file) => `Acknowledge ${file}`,
  acknowledged: (file) => `The warning about ${file} was acknowledged.`,

  // Why a press had no effect, by the code of the refusal; another code has the last text.
  refusals: {
    "camera-lost": "A camera is missing. Check its cable.",
    "unknown-board-type": "This type is not stored any more. Choose another one.",
    "board-type-retired": "This type is no longer filmed. Choose another one.",
    "invalid-input": "The station cannot use this type or id. Call the engineer.",
    "no-reference": "This type has no reference. Call the engineer.",
    "reference-unusable": "The reference of this type is unusable. Call the engineer.",
    "ring-full": "All memory is in use. Wait, then press again.",
    "wrong-state": "Not possible now. Follow the order above, then press again.",
    "arming-failed": "The devices did not respond in time. Press again.",
    "disarming-failed": "The devices did not respond in time. Press again.",
    "acquisition-lost": "The cameras are being started. Wait, then press again.",
    busy: "The station is busy. Press again.",
    device: "A device does not respond. Follow the order above, then press again.",
    "missing-scope": "This key does not permit it. Log in with another one.",
    "no-key": "The login has ended. Log in again.",
    "not-stored": "The board is not on disk yet. Try again later.",
    "run-forgotten": "This board is not kept any more.",
    other: "The station has refused it. Call the engineer.",
  },

  // the last board
  lastBoard: "Last board",
  verdicts: {
    ok: "Pictures good",
    degraded: "Pictures with reservations",
    failed: "No usable pictures",
    none: "Result pending",
  },
  noBoard: "No board yet",
  noId: "no id",
  ago: (s) => {
    if (s < 60) return `${Math.max(0, Math.floor(s))} s ago`;
    if (s < 3600) return `${Math.floor(s / 60)} min ago`;
    if (s < 86400) return `${Math.floor(s / 3600)} h ago`;
    return `${Math.floor(s / 86400)} days ago`;
  },
  skippedBoards: (list) => `Skipped: board ${list.join(", ")}`,
  unseenCount: (n) => (n === 1 ? "1 part not seen" : `${n} parts not seen`),
  filmAgain: "Film again",
  use: "Use it anyway",
  decided: { "film-again": (name) => `To be filmed again (${name})`, use: (name) => `Used, decided by ${name}` },
  yourName: "Your name",
  reason: "Reason",
  cancel: "Cancel",
  open: "All pictures",
  noMosaic: "No picture",
  pictureBeingMade: "The picture is being made.",

  // counters and strip
  today: "Today",
  counts: { ok: "good", degraded: "with reservations", failed: "failed", missed: "missed" },
  strip: "Last boards",
  missedBoard: "A board passed without pictures",

  // list of boards
  span: "Span",
  spans: { any: "any", today: "today", yesterday: "yesterday", week: "last 7 days", other: "from … to …" },
  from: "From",
  to: "To",
  verdict: "Verdict",
  any: "any",
  noVerdict: "without a result",
  show: "Show",
  more: "More",
  csv: "Save as CSV",
  nothingFound: "No boards match.",
  searching: "Searching …",
  cut: (n) => `The file has the newest ${n} boards. For older ones, choose an earlier span.`,
  columns: {
    started: "Time", board_id: "Board", read_id: "Read id", board_type: "Type", verdict: "Verdict", frames: "Frames", reasons: "Reasons", decision: "Decision",
    ready_ms: "Result after, ms", unseen_parts: "Parts not seen", sigma_px: "σ, px", residual_px: "Residual, px", seam_px: "Worst seam, px", slip_percent: "Slip, %",
  },
  framesOf: (ok, all) => `${ok} of ${all}`,

  // which board it is
  identities: {
    agrees: "agrees", differs: "differs", unread: "no code read", "not-compared": "no other id to compare", "not-expected": "no codes",
    pending: "being read", "not-read": "not read",
  },
  identityOf: (armed, read, word) => `armed ${armed ?? "without id"}, read ${read || "none"}: ${word}`,

  // one board
  component: "Component",
  facts: {
    board: "Board", identity: "Identity", run: "Run", type: "Type", job: "Job", since: "Finished", frames: "Frames", trigger: "Trigger",
    unseen: "Parts not seen", skipped: "Skipped boards (crossed out)", software: "Software",
  },
  frames: (ok, incomplete, missing, unproven, rows, cameras) => {
    const all = ok + incomplete + missing + unproven;
    const lost = [
      incomplete && `${incomplete} incomplete`,
      missing && `${missing} missing`,
      unproven && `${unproven} not proven`,
    ].filter(Boolean);
    const size = `${rows} rows × ${cameras} cameras`;
    return lost.length ? `${ok} of ${all} good (${lost.join(", ")}), ${size}` : `all ${all} good, ${size}`;
  },
  trigger: (proof, within) => {
    if (proof.proven && within) return `all frames match their pulses within ${within} µs`;
    const cameras = proof.cameras.filter((c) => !c.proven).map((c) => c.camera);
    return cameras.length ? `not confirmed for camera ${cameras.join(", ")}` : "no frame to confirm";
  },
  unseen: (list) => {
    const named = list.slice(0, 40).map((c) => texts.unseenOption(c)).join(", ");
    return list.length > 40 ? `${named}, and ${list.length - 40} more` : named;
  },
  unseenOption: (c) => `${c.address} (${Math.floor((c.coverage ?? 0) * 100)} % seen)`,
  views: (n) => (n === 1 ? "1 picture" : `${n} pictures`),
  caption: (view) => `camera ${view.camera}, row ${view.row}` + (view.light ? `, ${view.light}` : ""),
  alt: (ref, view) => `${ref}, camera ${view.camera}, row ${view.row}`,
  whole: (percent) => (percent >= 100 ? "" : `, ${percent} % of it`),
  unloadable: ", not available",
  picturesGone: "The pictures of this board are no longer in memory, and it was not kept as a recording.",
  noPictures: "No frame shows this component.",
  noComponents: "This board type has no components.",
  notFound: "There is no such board.",
  mosaic: "Whole board",
  back: "All boards",
};
