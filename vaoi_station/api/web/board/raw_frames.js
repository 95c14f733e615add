// The frames of a board without usable pictures, as they were filmed: by camera and row, uncorrected, with the places that look most like
// fiducials.
import { make } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { svg, titled } from "../parts/svg.js";
import { number, texts } from "../texts/texts.js";

const LARGEST_PX = 320;
const SHARE = 0.04; // radius of a circle, in widths of the frame

export async function showRawFrames(root, run) {
  const words = texts.board;
  if (!run.frames_available && !run.recording) {
    root.replaceChildren(make("p", { className: "note", textContent: `${words.framesGone(run.state)} ${words.notRecorded}` }));
    return;
  }
  const result = await rest.matrices(run.id).catch(() => null); // a run may end without a result
  const places = result?.quality.fiducial_places ?? [];
  const names = Array.from({ length: run.cameras }, (_, camera) => make("th", { scope: "col", textContent: texts.camera(String(camera)) }));
  const rows = Array.from({ length: run.rows }, (_, row) => {
    const frames = run.frames.filter((frame) => frame.row === row).sort((a, b) => a.camera - b.camera);
    return make("tr", {}, make("th", { scope: "row", textContent: `${row}` }), ...frames.map((frame) => cell(run, frame, places)));
  });
  const table = make("table", {}, make("thead", {}, make("tr", {}, make("th", { scope: "col", textContent: words.row }), ...names)), make("tbody", {}, ...rows));
  root.replaceChildren(make("p", { textContent: `${words.asFilmed} ${words.placesTaken(places.length)}` }), make("div", { className: "scrolled", tabIndex: 0 }, table));
}

function cell(run, frame, places) {
  const words = texts.board;
  const state = frame.verdict !== "ok" ? frame.verdict : frame.proven ? "" : "unproven";
  const note = make("p", { textContent: state && [words.frameStates[state], frame.cause].filter(Boolean).join(": ") });
  const found = make("td", { className: state }, note);
  if (state === "missing") return found;
  const image = make("img", { alt: words.frame(frame.camera, frame.row, frame.light), loading: "lazy", src: rest.cameraPicture({ ...frame, run: run.id }, { largest_px: LARGEST_PX }) });
  image.onerror = () => found.replaceChildren(make("p", { textContent: words.unloadable }));
  const link = make("a", { href: rest.runAddress(run.id, `/frames/${frame.camera}/${frame.row}?incomplete=show&format=png`), target: "_blank" }, image);
  const mine = places.filter((place) => place.frame[0] === frame.camera && place.frame[1] === frame.row);
  if (mine.length) link.append(circles(mine));
  found.prepend(link);
  return found;
}

function circles(places) {
  const [width, height] = places[0].frame_px;
  const over = svg("svg", { viewBox: `0 0 ${width} ${height}`, "aria-hidden": "true" });
  for (const { px, score } of places) over.append(titled(svg("circle", { cx: px[0], cy: px[1], r: SHARE * width }), texts.board.likeFiducial(number(score, 2))));
  return over;
}
