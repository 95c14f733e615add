// From a board to its other side, and to both as one board. Boards of one side have neither.
import { make } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { sign } from "../parts/signs.js";
import { texts } from "../texts/texts.js";

// The page of a run: of this station, or of the one that films the other side. Its loopback address is that of this machine.
export function pageOf({ address, run }, component) {
  const query = component ? `?${new URLSearchParams({ component })}` : "";
  const page = `#/board/${encodeURIComponent(run)}${query}`;
  if (!address.includes("://")) return page;
  const other = new URL(address.split("/api/v1/")[0] + "/");
  if (["127.0.0.1", "localhost"].includes(other.hostname)) other.hostname = location.hostname;
  return `${other}${page}`;
}

const SECOND = ["side-too-old", "sides-same"]; // there is a second side, although none is joined

export async function showSideLinks(root, run) {
  const id = run.board_id ?? run.identity?.board_id;
  const board = id ? await rest.bothSides(id).catch(() => null) : null; // without it, all else of the board is shown
  const second = board && ((board.top && board.bottom) || board.coming.some((name) => !board[name]) || board.reasons.some((reason) => SECOND.includes(reason.code)));
  root.hidden = !second;
  root.replaceChildren();
  if (root.hidden) return;
  const mine = [board.top, board.bottom, ...board.others].find((side) => side?.run === run.id)?.side;
  const other = { top: board.bottom, bottom: board.top }[mine];
  const words = texts.board.sides;
  if (other) {
    const verdict = other.verdict ?? "failed";
    const title = `${words.names[other.side]}: ${texts.verdicts[verdict]} (Alt+S)`;
    root.append(make("a", { id: "other-side", className: "button", href: pageOf(other), title, ariaLabel: title, ariaKeyShortcuts: "Alt+S" }, sign(verdict), words.names[other.side]));
  }
  root.append(make("a", { id: "both-sides", className: "button", href: `#/sides/${encodeURIComponent(id)}`, textContent: words.both }));
}
