// Which board a run shows: the id of the line's order and the id that was read from the board, side by side.
import { texts } from "../texts/texts.js";

// On a panel, each board has an id of its own.
const readIds = (identity) => identity.board_id ?? Object.entries(identity.boards ?? {}).map(([place, id]) => `${place}: ${id}`).join(", ");

export function readId(identity) {
  if (!identity || identity.state === "not-expected") return "";
  return [readIds(identity), texts.identities[identity.state]].filter(Boolean).join(", ");
}

export const identityOf = (run) => texts.identityOf(run.board_id, readIds(run.identity), texts.identities[run.identity.state]);
