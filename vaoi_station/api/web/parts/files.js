// Files that the page makes itself.
import { make } from "./elements.js";

export function saveFile(name, content, type) {
  const link = make("a", { href: URL.createObjectURL(new Blob(content, { type })), download: name });
  link.click();
  URL.revokeObjectURL(link.href);
}

// A table for spreadsheets.
export const saveTable = (name, rows) =>
  saveFile(name, ["\ufeff", rows.map((cells) => cells.map(quoted).join(",")).join("\r\n")], "text/csv");

// A cell of CSV (RFC 4180). A text that a spreadsheet would take for a formula gets an apostrophe; a number is none, also as text.
function quoted(value) {
  const text = typeof value === "string" && /^(?!-[\d.,]+$)[=+\-@\t\r]/.test(value) ? `'${value}` : String(value);
  return `"${text.replaceAll('"', '""')}"`;
}
