// Alle Texte der Seiten auf Deutsch, mit denselben Schlüsseln wie en.js.
import { board } from "./board_de.js";
import { cameras } from "./cameras_de.js";
import { lights } from "./lights_de.js";
import { optics } from "./setup/optics_de.js";
import { settings } from "./setup/settings_de.js";
import { setup } from "./setup_de.js";
import { reasons } from "./station/reasons_de.js";
import { translated } from "./translated_de.js";
import { trends } from "./trends_de.js";

export const texts = {
  board,
  cameras,
  lights,
  optics,
  reasons,
  settings,
  setup,
  translated,
  trends,
  line: "Linie",
  boards: "Baugruppen",
  setUp: "Einrichten",
  interface: "API",
  otherLanguage: "English",
  soundOn: "Ton an",
  soundOff: "Ton aus",
  key: "Schlüssel",
  logIn: "Anmelden",
  wrongKey: "Dieser Schlüssel gilt nicht. Prüfen Sie, ob er vollständig ist, oder verlangen Sie einen neuen.",
  logInTitle: "Diese Station verlangt einen Schlüssel",
  logInHelp: "Den Schlüssel gibt der Verwalter der Station aus (vaoi keys create). Die Anmeldung gilt 12 Stunden, nur in diesem Browser.",
  logOut: "Abmelden",
  noAnswer: "Die Station hat nicht geantwortet. Versuchen Sie es noch einmal.",
  noData: (s) => `Keine Daten seit ${s} s`,
  unloaded: "Diese Ansicht wurde nicht geladen: Die Station hat ihre Dateien nicht gesendet. Sobald die Station antwortet, wird es erneut versucht.",
  loadAgain: "Neu laden",
  old: "Was diese Seite zeigt, ist veraltet.",
  loading: "Wird geladen …",
  why: "Warum?",
  close: "Schließen",
  details: "Einzelheiten (englisch)",
  technical: "Einzelheiten für den Techniker (englisch)",

  words: {
    starting: "Startet",
    idle: "Nicht aktiv",
    arming: "Wird bereit",
    armed: "Bereit",
    lacking: "Kamera fehlt",
    held: "Halt",
    filming: "Aufnahme",
    blocked: "Speicher voll",
    faulted: "Störung",
    stopping: "Endet",
    unknown: "Keine Daten",
    failed: "Unbrauchbar",
    degraded: "Prüfen",
    missed: "Verpasst",
  },
  orders: {
    starting: "Baugruppen zurückhalten. Warten.",
    idle: "Typ wählen, Aktivieren drücken.",
    arming: "Nächste zurückhalten.",
    armed: "Nächste einlassen.",
    lacking: "Nächste zurückhalten.",
    held: "Nächste zurückhalten.",
    filming: "Nicht berühren.",
    blocked: "Nächste zurückhalten.",
    faulted: "Baugruppen zurückhalten. Techniker rufen.",
    stopping: "Nächste zurückhalten.",
    unknown: "Zurückhalten. Station und Netz prüfen.",
    missed: "Eine wurde nicht aufgenommen. Neu aufnehmen.",
  },
  extra: {
    camera: "Kamerakabel prüfen.",
    controller: "Kabel der Steuerung prüfen.",
    disk: "Verwalter rufen: Festplatte.",
    wait: "Warten.",
    engineer: "Techniker rufen.",
    identify: "Mit ihrer Nummer neu aktivieren.",
    board: "Platine aus der Lichtschranke nehmen.",
    belt: "Band starten.",
  },
  boardOrders: {
    again: "Herausnehmen, neu aufnehmen.",
    flat: "Flach auflegen, neu aufnehmen.",
    right: "Typ und Richtung prüfen, neu aufnehmen.",
    marks: "Passmarken säubern, neu aufnehmen.",
    light: "Licht und Glas prüfen, neu aufnehmen.",
    place: "Lage prüfen, neu aufnehmen.",
    identify: "Nummer und Etikett prüfen.",
    camera: "Techniker rufen: Kameras.",
    type: "Techniker rufen: Typdaten.",
  },
  boardOf: (id, time) => (id ? `Nr. ${id}` : time ? `Die von ${time}` : "Die letzte"),
  noPicturesOf: (board, order) => `${board}: keine Bilder. ${order}`,
  doubtfulPicturesOf: (board, order) => `${board}: ${order}`,
  nextTry: (name, time) => `Nächster Versuch für ${name}: ${time}.`,
  camera: (name) => (name.toLowerCase().startsWith("camera") ? name : `Kamera ${name}`),

  boardType: "Typ",
  boardId: "Nummer",
  arm: "Aktivieren",
  armAnyway: "Ohne diese Kamera",
  disarm: "Deaktivieren: halten",
  armedWith: (armed, lost) =>
    [`Aktiv für ${armed.board_type}`, armed.board_id && `Nr. ${armed.board_id}`, armed.job_id && `Auftrag ${armed.job_id}`, lost.length && `ohne ${lost.join(", ")}`]
      .filter(Boolean)
      .join(", "),
  armedFor: (type) => `Aktiv für ${type}.`,
  disarmed: "Nicht mehr aktiv.",
  unusable: "unbrauchbar",
  acknowledge: (file) => `${file} bestätigen`,
  acknowledged: (file) => `Die Warnung vor ${file} wurde bestätigt.`,

  refusals: {
    "camera-lost": "Eine Kamera fehlt. Kabel prüfen.",
    "unknown-board-type": "Dieser Typ ist nicht mehr gespeichert. Anderen wählen.",
    "board-type-retired": "Dieser Typ wird nicht mehr aufgenommen. Anderen wählen.",
    "invalid-input": "Typ oder Nummer ist für die Station unbrauchbar. Techniker rufen.",
    "no-reference": "Dieser Typ hat keine Referenz. Techniker rufen.",
    "reference-unusable": "Die Referenz dieses Typs ist unbrauchbar. Techniker rufen.",
    "ring-full": "Der Speicher ist voll. Warten, dann noch einmal drücken.",
    "wrong-state": "Jetzt nicht möglich. Anweisung oben befolgen, dann noch einmal drücken.",
    "arming-failed": "Die Geräte haben nicht rechtzeitig geantwortet. Noch einmal drücken.",
    "disarming-failed": "Die Geräte haben nicht rechtzeitig geantwortet. Noch einmal drücken.",
    "acquisition-lost": "Die Kameras werden gestartet. Warten, dann noch einmal drücken.",
    busy: "Die Station ist beschäftigt. Noch einmal drücken.",
    device: "Ein Gerät antwortet nicht. Anweisung oben befolgen, dann noch einmal drücken.",
    "missing-scope": "Dieser Schlüssel erlaubt das nicht. Mit einem anderen anmelden.",
    "no-key": "Die Anmeldung ist beendet. Neu anmelden.",
    "not-stored": "Die Baugruppe ist noch nicht auf der Platte. Später noch einmal versuchen.",
    "run-forgotten": "Diese Baugruppe ist nicht mehr aufbewahrt.",
    other: "Die Station hat es abgelehnt. Techniker rufen.",
  },

  lastBoard: "Letzte Baugruppe",
  verdicts: {
    ok: "Bilder gut",
    degraded: "Bilder mit Vorbehalt",
    failed: "Keine brauchbaren Bilder",
    none: "Ergebnis kommt noch",
  },
  noBoard: "Noch keine Baugruppe",
  noId: "ohne Nummer",
  ago: (s) => {
    if (s < 60) return `vor ${Math.max(0, Math.floor(s))} s`;
    if (s < 3600) return `vor ${Math.floor(s / 60)} min`;
    if (s < 86400) return `vor ${Math.floor(s / 3600)} h`;
    return `vor ${Math.floor(s / 86400)} Tagen`;
  },
  skippedBoards: (list) => `Übersprungen: Baugruppe ${list.join(", ")}`,
  unseenCount: (n) => (n === 1 ? "1 Bauteil nicht gesehen" : `${n} Bauteile nicht gesehen`),
  filmAgain: "Neu aufnehmen",
  use: "Trotzdem nutzen",
  decided: { "film-again": (name) => `Wird neu aufgenommen (${name})`, use: (name) => `Genutzt, entschieden von ${name}` },
  yourName: "Ihr Name",
  reason: "Grund",
  cancel: "Abbrechen",
  open: "Alle Bilder",
  noMosaic: "Kein Bild",
  pictureBeingMade: "Das Bild wird gerade erstellt.",

  today: "Heute",
  counts: { ok: "gut", degraded: "mit Vorbehalt", failed: "unbrauchbar", missed: "verpasst" },
  strip: "Letzte Baugruppen",
  missedBoard: "Eine Baugruppe wurde nicht aufgenommen",

  span: "Zeitraum",
  spans: { any: "beliebig", today: "heute", yesterday: "gestern", week: "letzte 7 Tage", other: "von … bis …" },
  from: "Von",
  to: "Bis",
  verdict: "Urteil",
  any: "alle",
  noVerdict: "ohne Ergebnis",
  show: "Zeigen",
  more: "Weitere",
  csv: "Als CSV sichern",
  nothingFound: "Keine Baugruppe passt dazu.",
  searching: "Wird gesucht …",
  cut: (n) => `Die Datei hat die neuesten ${n} Baugruppen. Für ältere einen früheren Zeitraum wählen.`,
  columns: {
    started: "Zeit", board_id: "Nummer", read_id: "Gelesene Nummer", board_type: "Typ", verdict: "Urteil", frames: "Einzelbilder", reasons: "Gründe", decision: "Entscheid",
    ready_ms: "Ergebnis nach, ms", unseen_parts: "Nicht gesehen", sigma_px: "σ, px", residual_px: "Residuum, px", seam_px: "Schlechteste Naht, px",
    slip_percent: "Schlupf, %",
  },
  framesOf: (ok, all) => `${ok} von ${all}`,

  identities: {
    agrees: "stimmt überein", differs: "weicht ab", unread: "kein Code gelesen", "not-compared": "keine andere Nummer zum Vergleich", "not-expected": "keine Codes",
    pending: "wird gelesen", "not-read": "nicht gelesen",
  },
  identityOf: (armed, read, word) => `aktiviert ${armed ?? "ohne Nummer"}, gelesen ${read || "keine"}: ${word}`,

  component: "Bauteil",
  facts: {
    board: "Nummer", identity: "Identität", run: "Lauf", type: "Typ", job: "Auftrag", since: "Fertig", frames: "Einzelbilder", trigger: "Auslösung",
    unseen: "Nicht gesehene Bauteile", skipped: "Übersprungene Baugruppen (durchgestrichen)", software: "Software",
  },
  frames: (ok, incomplete, missing, unproven, rows, cameras) => {
    const all = ok + incomplete + missing + unproven;
    const lost = [
      incomplete && `${incomplete} unvollständig`,
      missing && `${missing} fehlen`,
      unproven && `${unproven} unbestätigt`,
    ].filter(Boolean);
    const size = `${rows} Reihen × ${cameras} Kameras`;
    return lost.length ? `${ok} von ${all} gut (${lost.join(", ")}), ${size}` : `alle ${all} gut, ${size}`;
  },
  trigger: (proof, within) => {
    if (proof.proven && within) return `alle Einzelbilder passen auf ${within} µs zu ihren Impulsen`;
    const cameras = proof.cameras.filter((c) => !c.proven).map((c) => c.camera);
    return cameras.length ? `nicht bestätigt für Kamera ${cameras.join(", ")}` : "kein Bild zu bestätigen";
  },
  unseen: (list) => {
    const named = list.slice(0, 40).map((c) => texts.unseenOption(c)).join(", ");
    return list.length > 40 ? `${named} und ${list.length - 40} weitere` : named;
  },
  unseenOption: (c) => `${c.address} (${Math.floor((c.coverage ?? 0) * 100)} % gesehen)`,
  views: (n) => (n === 1 ? "1 Bild" : `${n} Bilder`),
  caption: (view) => `Kamera ${view.camera}, Reihe ${view.row}` + (view.light ? `, ${view.light}` : ""),
  alt: (ref, view) => `${ref}, Kamera ${view.camera}, Reihe ${view.row}`,
  whole: (percent) => (percent >= 100 ? "" : `, ${percent} % davon`),
  unloadable: ", nicht verfügbar",
  picturesGone: "Die Bilder dieser Baugruppe sind nicht mehr im Speicher und wurden nicht als Aufnahme behalten.",
  noPictures: "Kein Bild zeigt dieses Bauteil.",
  noComponents: "Dieser Typ hat keine Bauteile.",
  notFound: "Diese Baugruppe gibt es nicht.",
  mosaic: "Ganze Baugruppe",
  back: "Alle Baugruppen",
};
