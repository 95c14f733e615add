// A cell of CSV (RFC 4180). A text that a spreadsheet would take for a formula gets an apostrophe; a number is none, also as text.
export function quoted(value) {
  const text = typeof value === "string" && /^(?!-[\d.,]+$)[=+\-@\t\r]/.test(value) ? `'${value}` : String(value);
  return `"${text.replaceAll('"', '""')}"`;
}
