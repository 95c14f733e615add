// What can be taken from a run: documents, tables and pictures, each with why it cannot be had if it cannot.
import { make } from "../parts/elements.js";
import { saveTable } from "../parts/files.js";
import { runAddress } from "../parts/rest.js";
import { texts } from "../texts/texts.js";

export function showExports(root, run, { parts, mosaics, heights, measures }) {
  const result = run.verdict != null && run.verdict !== "failed";
  const frames = run.frames_available || run.recording;
  const tiff = mosaics.find((m) => m.tiff);
  const kept = mosaics.find((m) => m.url);
  const offers = [
    ["document", runAddress(run.id, ""), `${run.id}.json`, true],
    ["matrices", runAddress(run.id, "/matrices"), `${run.id}-matrices.json`, run.verdict != null, texts.board.noResult],
    ["heightsOf", runAddress(run.id, "/heights"), `${run.id}-heights.json`, Boolean(heights), texts.board.noHeights],
    ["partsOf", runAddress(run.id, "/parts"), `${run.id}-parts.json`, Boolean(measures), texts.board.noMeasures],
    ["overlayOf", runAddress(run.id, "/overlay"), `${run.id}-overlay.json`, result, texts.board.noResult],
    ["timelineOf", runAddress(run.id, "/timeline"), `${run.id}-timeline.json`, run.finished, texts.board.noResult],
    ["allPictures", runAddress(run.id, "/images?container=zip&format=png"), `${run.id}-pictures.zip`, result && frames, texts.picturesGone],
    ["wholeFile", tiff?.tiff ?? "", "", Boolean(tiff), texts.board.tiffGone],
    ...(kept ? [["keptFile", kept.url, `${run.id}-board.jpg`, true]] : []),
  ];
  const table = make("button", { type: "button", textContent: texts.board.export.table, disabled: parts.length === 0 });
  table.addEventListener("click", () => saveParts(run, parts, heights));
  root.replaceChildren(
    make("ul", { className: "exports" }, make("li", {}, table, make("p", { textContent: texts.board.exported.table })), ...offers.map(offer)),
    make("p", {}, texts.board.wholeRun, " ", make("code", { textContent: `vaoi export ${run.id} --out ${run.id}.vaoi` })),
  );
}

function offer([name, href, download, possible, why]) {
  const link = possible ? make("a", { className: "button", href, download, textContent: texts.board.export[name] }) : make("button", { type: "button", disabled: true, textContent: texts.board.export[name] });
  return make("li", {}, link, make("p", { textContent: possible ? texts.board.exported[name] : why }));
}

const COLUMNS = ["address", "x_mm", "y_mm", "rotation_deg", "views", "coverage", "unseen", "sigma_px", "sigma_mm", "height_mm", "height_sigma_mm", "comparison"];

function saveParts(run, parts, heights) {
  const rows = parts.map((part) => {
    const measured = heights?.[part.address] ?? {};
    const values = { ...part, x_mm: part.center_mm[0], y_mm: part.center_mm[1], height_mm: measured.height_mm, height_sigma_mm: measured.sigma_mm, comparison: measured.comparison };
    return COLUMNS.map((name) => values[name] ?? "");
  });
  saveTable(`${run.id}-components.csv`, [COLUMNS, ...rows]);
}
