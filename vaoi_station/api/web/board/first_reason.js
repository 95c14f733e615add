// The first reason against a board, with a picture of the place where it is seen: one press leads there.
import { boardPicture, boxOf } from "../parts/board_picture.js";
import { make, View } from "../parts/elements.js";
import { boardGroup } from "../parts/orders.js";
import { unattended } from "../parts/rest.js";
import { texts } from "../texts/texts.js";
import { reasonSaid } from "./report.js";

const AROUND = 0.25; // half a side of the place of a link, in sides of a frame
const MARK_SIZES = 6;

const largest = (list, rank) => list.reduce((best, entry) => (best && rank(best) >= rank(entry) ? best : entry), null);
const square = ([x, y], half) => [[x - half, y - half], [x + half, y - half], [x + half, y + half], [x - half, y + half]];
const ofPart = (part, colour) => part && { component: part.address, colour, points: part.footprint };

// Where a reason is seen, by what it asks for: what is drawn there, and points in CAD coordinates; null if it has no place.
function placeOf(reason, parts, overlay) {
  const group = boardGroup(reason);
  if (group === "place") return ofPart(parts.find((part) => part.unseen), "views");
  if ((reason.cause || reason.code) === "positions-uncertain") return ofPart(largest(parts, (part) => part.sigma_px ?? 0), "sigma");
  if (group === "again") {
    const frame = overlay.frames.find((one) => !one.usable);
    return frame && { drawing: "frames", points: frame.corners };
  }
  if (["marks", "right", "type"].includes(group)) {
    const mark = largest(overlay.fiducials, (one) => one.residual_px ?? Infinity); // one that was not found has none
    return mark && { drawing: "fiducials", points: square(mark.at, MARK_SIZES * mark.diameter) };
  }
  const pair = largest(overlay.links.filter((one) => one.at), (one) => one.residual_px ?? 0);
  if (group === "identify" || !pair) return null;
  const [[x0, y0], [x1, y1]] = overlay.frames[0].corners;
  return { drawing: "residuals", points: square(pair.at, AROUND * Math.hypot(x1 - x0, y1 - y0)) };
}

export class FirstReason extends View {
  #onPlace;
  #shown = null;

  // onPlace({ drawing, colour, component, points }): the person wants to see the place.
  constructor(root, onPlace) {
    super("", root);
    this.#onPlace = onPlace;
  }

  // Show it of a run; with its parts, mosaics and overlay as soon as they are known.
  show(run, { parts = [], mosaics = [], overlay = null } = {}) {
    this.#shown = run;
    const [reason] = run.reasons;
    const place = reason && overlay && placeOf(reason, parts, overlay);
    const lead = place && mosaics.length ? [make("button", { type: "button", textContent: texts.board.showPlace, onclick: () => this.#onPlace(place) })] : [];
    this.root.replaceChildren(...(reason ? [...lead, make("p", {}, ...reasonSaid(reason))] : []));
    if (lead.length && mosaics[0].dzi) unattended(this.#picture(run, mosaics[0], place, lead[0]));
  }

  async #picture(run, mosaic, place, button) {
    const picture = await boardPicture(run, { mosaic, region: boxOf(mosaic, place.points, 0.5) });
    if (picture && run === this.#shown) button.prepend(picture);
  }
}
