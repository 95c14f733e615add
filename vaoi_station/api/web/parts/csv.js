// A cell of CSV (RFC 4180). A text that a spreadsheet would take for a formula gets an apostrophe; numbers are no texts.
export function quoted(value) {
  const text = typeof value === "string" && /^[=+\-@\t\r]/.test(value) ? `'${value}` : String(value);
  return `"${text.replaceAll('"', '""')}"`;
}
