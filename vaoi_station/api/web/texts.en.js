// All texts of the page; a translation is another file with the same keys.
export const texts = {
  interface: "Programming interface",
  key: "Key",
  logIn: "Log in",
  wrongKey: "This key is not valid. Check that it is complete, or ask for a new one.",
  logInTitle: "This station asks for a key",
  logInHelp: "The key comes from the administrator of the station (vaoi keys create). The login lasts 12 hours, in this browser only.",
  logOut: "Log out",
  boardType: "Board type",
  boardId: "Board id",
  arm: "Arm",
  armAnyway: "Arm anyway",
  disarm: "Disarm",
  acknowledge: (file) => `Acknowledge ${file}`,
  acknowledged: (file) => `The warning about ${file} was acknowledged.`,
  lastBoard: "Last board",
  component: "Component",
  unusable: "unusable",

  states: {
    starting: ["Starting", "Wait until workers, cameras and controller have started."],
    idle: ["Not armed", "Choose the board type and press Arm."],
    arming: ["Arming", "Hold the next board back for a moment."],
    armed: ["Ready", "Let the next board in."],
    lacking: ["Camera missing", "Hold the next board back. It would be filmed without one camera."],
    held: ["Hold", "Hold the next board back. It would not be filmed or kept."],
    filming: ["Filming", "A board is passing. Do not touch it."],
    blocked: ["Memory full", "Hold the next board back until this page shows Ready."],
    faulted: ["Fault", "Hold the next board back and call the engineer."],
    stopping: ["Stopping", "The station is shutting down. Hold the next board back."],
    unknown: ["Unknown", "Reload this page."],
  },
  verdicts: {
    ok: "Pictures good",
    degraded: "Pictures with reservations",
    failed: "No usable pictures",
    none: "Result pending",
  },
  // What the operator does about a run that is not good: by the code of each reason (`cause`).
  orders: {
    again: "Film this board again. If this recurs, call the engineer.",
    flat: "Check that the board lies flat, at the right height and fixed on the belt. Film it again.",
    right: "Check that this is the right board, and that it lies the right way round. Film it again.",
    marks: "Check the fiducials on the board: clean, uncovered, in view. Film it again.",
    light: "Check the light, and clean the glass of the cameras. Film the board again.",
    lamp: "A light has failed. Call the engineer: check the named lamp, its driver and its cable.",
    place: "Check where the named parts pass the cameras. Film the board again.",
    camera: "Call the engineer: cameras or trigger need attention.",
    type: "Call the engineer: the board type or its reference needs attention.",
  },
  orderOf: {
    "no-frames": "again", "camera-absent": "again", "trigger-doubtful": "again", "rows-lost": "again",
    "rows-not-connected": "again", "frames-unconfirmed": "again", "rows-not-chained": "again",
    "board-off-plane": "flat", "links-scatter": "flat", "surface-unlikely": "flat",
    "fiducials-not-found": "right", "outline-shifted": "right", "outline-turned": "right",
    "outline-invisible": "right", "board-turned": "right", "texture-off-board": "right",
    "reference-contradicts": "right",
    "fiducial-missing": "marks", "fiducial-off-place": "marks",
    "no-texture": "light", "light-dark": "lamp", "overlap-blank": "light", "overlap-exposure": "light",
    "components-unseen": "place",
    "wrong-rows": "camera", "camera-displaced": "camera", "lens-differs": "camera", "not-explained": "camera",
    "overlap-repetitive": "type", "rows-repetitive": "type", "no-board-type": "type",
    "too-few-fiducials": "type", "fiducial-size": "type", "fiducial-wrong": "type", "scale-wrong": "type",
    "components-shifted": "type",
    "orientation-ambiguous": "type", "reference-not-found": "type", "positions-uncertain": "type",
    "no-error-measure": "type",
  },
  noBoard: "No board yet",
  noBoardHint: "Arm the station and let a board pass.",
  facts: {
    board: "Board", run: "Run", type: "Type", job: "Job", since: "Finished", frames: "Frames", trigger: "Trigger",
    unseen: "Not seen",
  },
  noId: "no id",
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
  trigger: (proof) => {
    const worst = Math.max(0, ...proof.cameras.map((c) => c.max_residual_us ?? 0));
    if (proof.proven) return `all frames match their pulses within ${worst.toFixed(1)} µs`;
    const cameras = proof.cameras.filter((c) => !c.proven).map((c) => c.camera);
    return `not confirmed for camera ${cameras.join(", ")}`;
  },
  unseen: (list) => {
    const named = list.slice(0, 40).map((c) => texts.unseenOption(c)).join(", ");
    return list.length > 40 ? `${named}, and ${list.length - 40} more` : named;
  },
  unseenOption: (c) => `${c.address} (${Math.floor(c.coverage * 100)} % seen)`,
  ago: (s) => {
    if (s < 60) return `${Math.max(0, Math.floor(s))} s ago`;
    if (s < 3600) return `${Math.floor(s / 60)} min ago`;
    if (s < 86400) return `${Math.floor(s / 3600)} h ago`;
    return `${Math.floor(s / 86400)} days ago`;
  },
  views: (n) => (n === 1 ? "1 picture" : `${n} pictures`),
  caption: (view) => `camera ${view.camera}, row ${view.row}`,
  alt: (ref, view) => `${ref}, camera ${view.camera}, row ${view.row}`,
  whole: (percent) => (percent >= 100 ? "" : `, ${percent} % of it`),
  unloadable: ", not available",
  picturesGone: "The pictures of this board are no longer in memory.",
  noPictures: "No frame shows this component.",
  noComponents: "This board type has no components.",
  armedWith: (armed) =>
    [`Board type ${armed.board_type}`, armed.board_id && `board ${armed.board_id}`, armed.job_id && `job ${armed.job_id}`]
      .filter(Boolean)
      .join(", ") + ".",
  camera: (name) => (name.toLowerCase().startsWith("camera") ? name : `camera ${name}`),
  nextTry: (name, time) => `Next attempt for ${name}: ${time}.`,
  armedFor: (type) => `Armed for ${type}.`,
  disarmed: "Disarmed.",
  noAnswer: "The station did not respond. Try again.",
  noData: (s) => `No data for ${s} s:`,
  old: "the data below are out of date. Check the station and the network.",
  connecting: "the station does not respond. Check that it is running, and check the network.",
};
