"use strict";
// The script of the checklist. Everything that it knows about the plan is in the page; what is entered is kept in this
// browser under the plan's digest. The page is whole without it, to read and to print.

const plan = JSON.parse(document.getElementById("plan-data").textContent);
const byId = (id) => document.getElementById(id);
const every = (selector, inside = document) => [...inside.querySelectorAll(selector)];

const table = new Map(plan.times.map((time) => [time.metered, time]));  // what to dial, by metered time

// --- what has been entered -----------------------------------------------------------------------------------------

const sections = [...plan.scenes.map((scene) => scene.name), ...(plan.calibration.length ? ["calibration"] : [])];
const rows = new Map();      // "scene-1/4" -> what is known and entered of that row, with its element
const metered = new Map();   // scene -> its metered time, as the table has it
const prepared = new Set();
let undoable = [];           // what Undo takes back, the last at the end; without elements, so that it can be kept
let place = sections[0];     // the scene that is being shot
let lastTaken = null;
let unsaved = false;         // something would be lost if the page were closed

every("[data-row]").forEach((element) => {
  const key = element.dataset.row;
  const section = key.slice(0, key.indexOf("/"));
  const number = Number(key.slice(section.length + 1));
  const fixed = (section === "calibration" ? plan.calibration : plan.frames).find((row) => row.number === number);
  const row = {
    // Ticked at its present setting. Taken at another one it is not done, until the scene is metered as it was.
    get done() { return this.takenAt !== null && this.takenAt === this.dial; },
  };
  Object.assign(row, { key, section, element }, fixed, { takenAt: null, repeats: 0, file: "", remark: "" });
  rows.set(key, row);
});
const rowsOf = (section) => [...rows.values()].filter((row) => row.section === section);

const frameCount = (list) => list.reduce((sum, row) => sum + row.count, 0);

/** What is kept. */
function entered() {
  const one = ({ takenAt, repeats, file, remark }) => ({ takenAt, repeats, file, remark });
  return {
    metered: Object.fromEntries(metered),
    prepared: [...prepared],
    rows: Object.fromEntries([...rows].map(([key, row]) => [key, one(row)])),
  };
}

/** Take over what was kept; what does not fit this page changes nothing. */
function adopt(content) {
  const check = (right) => { if (!right) throw new Error("it is not of this page"); };
  check(content && Array.isArray(content.prepared));
  check(plan.scenes.every(({ name }) => table.get(content.metered?.[name])?.dials));
  check([...rows.keys()].every((key) => Number.isInteger(content.rows?.[key]?.repeats)));
  for (const [key, row] of rows) Object.assign(row, content.rows[key]);
  for (const { name } of plan.scenes) metered.set(name, content.metered[name]);
  prepared.clear();
  plan.preparation.filter((name) => content.prepared.includes(name)).forEach((name) => prepared.add(name));
}

// --- keeping -------------------------------------------------------------------------------------------------------

const KEY = `capture-checklist:${plan.digest}`;
const UNDO = `${KEY}:undo`;
const LONGEST_UNDO = 100000;  // characters: some two hundred steps

function kept(name) {
  try { return localStorage.getItem(name); } catch { notKept(); return null; }
}
function keep(name, text) {
  try { localStorage.setItem(name, text); return true; } catch { notKept(); return false; }
}
function notKept() {
  byId("not-kept").hidden = false;
}
function save() {
  unsaved = !keep(KEY, JSON.stringify(entered()));
  while (JSON.stringify(undoable).length > LONGEST_UNDO) undoable.shift();
  keep(UNDO, JSON.stringify(undoable));
}
function restore() {
  const text = kept(KEY);
  if (text === null) return;
  try {
    adopt(JSON.parse(text));
  } catch (error) {
    keep(`${KEY}:unreadable`, text);  // or the next tick would overwrite it
    byId("refused").hidden = false;
    byId("refused").textContent = `What this browser kept for this page cannot be read (${error.message}); a copy stays under "${KEY}:unreadable".`;
  }
}

/** Read what Undo takes back; of what does not fit this page nothing, since only ticks and notes are precious. */
function restoreUndo() {
  undoable = [];
  try {
    const found = JSON.parse(kept(UNDO) ?? "[]");
    const fits = (one) => sections.includes(one.place) && Array.isArray(one.prepared) && Object.keys(one.rows).every((key) => rows.has(key))
      && plan.scenes.every(({ name }) => table.get(one.metered[name])?.dials);
    if (found.every(fits)) undoable = found;
  } catch { /* written by another version of this page */ }
}

// --- showing -------------------------------------------------------------------------------------------------------

function replan(section) {
  const time = table.get(metered.get(section));
  if (!time) return;
  rowsOf(section).forEach((row, index) => { row.dial = plan.dials[time.dials[index]]; });
  byId(`${section}-problem`).hidden = true;
}

function showRow(row) {
  const { element } = row;
  const box = element.querySelector(".tick input");
  box.checked = row.done;
  element.querySelector(".dial").textContent = `${row.dial} s`;
  let state = "";
  if (row.repeats && !row.done) state = "Take it again; the last one counts.";
  if (row.repeats && row.done) state = `Taken ${row.repeats + 1} times; the last one counts.`;
  if (row.takenAt !== null && !row.done) state = `Taken at ${row.takenAt} s; take it again at this time.`;
  element.querySelector(".state").textContent = state;
  for (const name of ["file", "remark"]) {
    const input = element.querySelector(`.${name}`);
    if (input !== document.activeElement) input.value = row[name];
  }
  element.querySelector(".more").classList.toggle("used", Boolean(row.file || row.remark));
  element.querySelector(".again").disabled = !row.done || row.repeats === plan.most_repeats;
}

function showSection(section) {
  const list = rowsOf(section);
  list.forEach(showRow);
  byId(`${section}-title`).querySelector(".count").textContent = `${frameCount(list.filter((row) => row.done))} of ${frameCount(list)}`;
  const time = table.get(metered.get(section));
  if (!time) return;
  byId(`${section}-remarks`).replaceChildren(...time.remarks.map((text) => {
    const item = document.createElement("li");
    item.textContent = text;
    return item;
  }));
  byId(`${section}-metered`).value = time.metered;
  every(".metered-text", byId(`${section}-body`)).forEach((text) => { text.textContent = time.shown; });
}

const nextRow = () => rowsOf(place).find((row) => !row.done);

function sentence(row) {
  const last = row.number + row.count - 1;
  const which = row.count === 1 ? `frame ${row.number} of ${frameCount(rowsOf(row.section))}` : `frames ${row.number} to ${last}`;
  const what = row.element.querySelector(".tick .soft").textContent.split(" · ")[1];
  return `${row.section}, ${which}: ${what}`;
}

/** Which of the dials changes from the shot before: at the tripod one looks for that. */
function hint(row) {
  const list = rowsOf(place);
  const before = list[list.indexOf(row) - 1];
  if (row.repeats || row.takenAt) return "Take it again; the last one counts.";
  if (!before) return place === "calibration" ? "First calibration frames." : "First shot of the scene.";
  const changed = [before.iso !== row.iso && "ISO", before.dial !== row.dial && "shutter"].filter(Boolean);
  return changed.length ? `Change ${changed.join(" and ")}.` : "Settings stay as they are.";
}

function showNext() {
  const row = nextRow();
  const all = [...rows.values()];
  const done = frameCount(all.filter((one) => one.done));
  byId("total").value = done;
  byId("total-text").textContent = `${done} of ${frameCount(all)} frames`;
  byId("preparation-title").querySelector(".count").textContent = `${every(":checked", byId("preparation-body")).length} of ${every("[data-item]", byId("preparation-body")).length}`;
  byId("place").value = place;
  byId("where").textContent = row ? sentence(row) : done === frameCount(all) ? "All frames are taken. Copy the card." : `${place}: all frames are taken.`;
  byId("dials").hidden = !row;
  byId("next-iso").textContent = row ? row.iso : "";
  byId("next-dial").textContent = row ? `${row.dial} s` : "";
  byId("taken").disabled = !row;
  byId("taken").textContent = row && row.count > 1 ? `Taken, all ${row.count}` : "Taken";
  byId("show").disabled = !row;
  byId("again").disabled = !before(row);
  const undo = undoable[undoable.length - 1];
  byId("undo").disabled = !undo;
  byId("undo").textContent = undo ? `Undo ${undo.label}` : "Undo";
  every(".shot.now").forEach((element) => element.classList.remove("now"));
  row?.element.classList.add("now");
  showTimer();
  stayAwake();
}

/** What "Repeat the one before" means: the shot taken last, else the one before the next. */
function before(row) {
  if (lastTaken?.done) return lastTaken;
  const list = rowsOf(place);
  return list.slice(0, row ? list.indexOf(row) : list.length).reverse().find((one) => one.done);
}

function showAll() {
  sections.forEach((section) => { replan(section); showSection(section); });
  every("[data-item]").forEach((box) => { box.checked = prepared.has(box.dataset.item); });
  showNext();
}

/** Say what has happened, to readers of the screen with the next shot in one sentence. */
function announce(text) {
  const row = nextRow();
  const next = row ? `Next: ${sentence(row)}, ISO ${row.iso}, ${row.dial} s.` : byId("where").textContent;
  byId("say").textContent = text;
  byId("live").textContent = `${text} ${next}`.trim();
}

function fold(section, open) {
  const body = byId(`${section}-body`);
  if (!open && body.contains(document.activeElement)) return;  // never from under a finger
  body.hidden = !open;
  byId(`${section}-title`).querySelector(".fold").setAttribute("aria-expanded", String(open));
}

// --- changing ------------------------------------------------------------------------------------------------------

/** Change something, with what Undo needs: `fields` are those of the rows that it puts back. */
function change(label, list, edit, fields = ["takenAt", "repeats"]) {
  undoable.push({
    label,
    rows: Object.fromEntries(list.map((row) => [row.key, Object.fromEntries(fields.map((name) => [name, row[name]]))])),
    metered: Object.fromEntries(metered),
    prepared: [...prepared],
    place,
  });
  edit();
  save();
}

function undo() {
  const last = undoable.pop();
  if (!last) return;
  for (const [key, entered] of Object.entries(last.rows)) Object.assign(rows.get(key), entered);
  for (const [name, time] of Object.entries(last.metered)) metered.set(name, time);
  prepared.clear();
  last.prepared.forEach((name) => prepared.add(name));
  lastTaken = null;
  go(last.place);
  save();
  showAll();
  announce(`Undone: ${last.label}.`);
}

/** Shoot in this section from now on. What is open stays open: lists must not jump from under a finger. */
function shootAt(section) {
  place = section;
  keep(`${KEY}:place`, place);
}
/** Leave a section for another one. */
function go(section) {
  if (section !== place) {
    fold(place, false);
    fold(section, true);
  }
  shootAt(section);
}

function setDone(row, done) {
  change(`${done ? "tick" : "untick"} ${row.section} ${row.number}`, [row], () => {
    if (done && row.takenAt !== null) row.repeats = Math.min(row.repeats + 1, plan.most_repeats);
    row.takenAt = done ? row.dial : null;
  });
  lastTaken = done ? row : null;
  shootAt(row.section);
  if (!nextRow()) {
    const at = sections.indexOf(place);
    const open = [...sections.slice(at + 1), ...sections.slice(0, at)].find((section) => rowsOf(section).some((one) => !one.done));
    if (open) go(open);
  }
  showSection(row.section);
  showNext();
  announce(done ? "Taken." : "No longer ticked.");
}

function repeat(row) {
  change(`repeat ${row.section} ${row.number}`, [row], () => {
    row.takenAt = null;
    row.repeats = Math.min(row.repeats + 1, plan.most_repeats);
  });
  lastTaken = null;
  shootAt(row.section);
  showSection(row.section);
  showNext();
  announce("To be taken again.");
}

function meter(section, text) {
  const [time, now] = [table.get(text), table.get(metered.get(section))];
  const problem = byId(`${section}-problem`);
  problem.hidden = !time.problem;
  problem.textContent = time.problem ? `${time.problem}. The shots below are still those of ${now.shown} s.` : "";
  if (!time.problem && time !== now) {
    change(`metered time of ${section}`, [], () => {
      metered.set(section, text);
      replan(section);
    });
  }
  showSection(section);  // a list that stands at a refused time goes back
  if (time.problem || time === now) return;
  showNext();
  const taken = rowsOf(section).filter((row) => row.takenAt !== null && !row.done);
  announce(`${section} is planned for ${time.shown} s.${taken.length ? ` ${taken.length} shots were taken at other settings and are to be taken again.` : ""}`);
}

/** The next faster or slower time of the table. */
function step(section, direction) {
  const other = plan.times[plan.times.indexOf(table.get(metered.get(section))) + direction];
  if (other) meter(section, other.metered);
}

// Cold fingers tap twice: the second tap within half a second on the same control is not meant.
const tap = { what: null, at: -Infinity };
function doubled(what, event) {
  const soon = tap.what === what && event.timeStamp - tap.at < 500;
  tap.what = what;
  tap.at = event.timeStamp;
  return soon;
}

// --- seconds to wait, and a screen that stays on -------------------------------------------------------------------

let timer = null;   // of the exposure that runs: its row and dial, when it ends, its sounds
let audio = null;
let lock = null;    // on the screen

/** Lay out the sounds of a timer at once: a page in the background is given few moments of its own, its sounds are not. */
function sounds(end) {
  audio ??= new AudioContext();  // browsers allow sound only after a tap
  const volume = new GainNode(audio, { gain: 0.5 });
  volume.connect(audio.destination);
  audio.resume().then(() => {
    const over = audio.currentTime + (end - Date.now()) / 1000;
    for (const [before, lasting, frequency] of [[3, 0.08, 660], [2, 0.08, 660], [1, 0.08, 660], [0, 0.8, 880]]) {
      if (over - before < audio.currentTime) continue;
      const tone = new OscillatorNode(audio, { frequency });
      tone.connect(volume);
      tone.start(over - before);
      tone.stop(over - before + lasting);
      tone.onended = () => { if (!timer) audio.suspend(); };  // or it would go on playing silence
    }
  });
  return volume;
}

function startTimer() {
  const { key, dial } = nextRow();
  const end = Date.now() + 1000 * plan.lasting[dial];
  let volume = null;
  try { volume = sounds(end); } catch { byId("say").textContent = "No sound here: watch the seconds."; }
  timer = { key, dial, end, volume, clock: setInterval(showTimer, 200) };
  showNext();
}

function stopTimer() {
  clearInterval(timer.clock);
  timer.volume?.disconnect();
  timer = null;
  audio?.suspend();
}

/** Show the seconds left, and what the button beside the next shot would do. */
function showTimer() {
  const row = nextRow();
  if (timer && (row?.key !== timer.key || row.dial !== timer.dial)) stopTimer();  // taken, or another one is next
  const left = timer ? Math.ceil((timer.end - Date.now()) / 1000) : 0;
  if (timer && left <= 0) {
    clearInterval(timer.clock);  // its last sound goes on
    timer = null;
    byId("say").textContent = byId("live").textContent = "The time is over.";
    stayAwake();
  }
  const seconds = plan.lasting[row?.dial];
  byId("timer").hidden = seconds === undefined;
  byId("timer").textContent = timer ? "Stop timer" : `Start timer, ${Math.round(seconds)} s`;
  byId("left").textContent = timer ? `${left} s ` : "";
  byId("hint").textContent = timer ? "left" : row ? hint(row) : "";
}

/** Keep the screen on while a scene is being shot; the browser lets go of it whenever the page is hidden. */
async function stayAwake() {
  const list = rowsOf(place);
  const shooting = timer !== null || (list.some((row) => row.done) && list.some((row) => !row.done));
  if (document.visibilityState !== "visible" || shooting === (lock !== null)) return;
  const held = lock;
  lock = shooting ? "asked for" : null;
  if (!shooting) { held.release?.(); return; }
  try {
    const granted = await navigator.wakeLock.request("screen");
    granted.addEventListener("release", () => { if (lock === granted) lock = null; });
    lock = granted;
    byId("not-awake").hidden = true;
    stayAwake();  // what was asked for may no longer be wanted
  } catch {
    lock = null;
    byId("not-awake").hidden = document.visibilityState !== "visible";  // hidden meanwhile, or refused, as on a low battery
  }
}

// --- the page ------------------------------------------------------------------------------------------------------

function startPlace() {
  const wanted = kept(`${KEY}:place`);
  const open = (section) => rowsOf(section).some((row) => !row.done);
  place = sections.includes(wanted) && open(wanted) ? wanted : sections.find(open) ?? place;
  sections.forEach((section) => fold(section, section === place));
}

function setTheme(name) {
  if (![...byId("theme").options].some((option) => option.value === name)) return;
  byId("theme").value = name;
  document.documentElement.dataset.theme = name;
  document.querySelector('meta[name="theme-color"]').content = getComputedStyle(document.body).backgroundColor;
}

function listen() {
  rows.forEach((row) => {
    const { element } = row;
    const box = element.querySelector(".tick input");
    box.addEventListener("click", (event) => {
      if (doubled(box, event)) event.preventDefault();
      else setDone(row, box.checked);
    });
    const more = element.querySelector(".more");
    more.addEventListener("click", () => more.setAttribute("aria-expanded", String(more.getAttribute("aria-expanded") === "false")));
    for (const name of ["file", "remark"]) {
      element.querySelector(`.${name}`).addEventListener("input", (event) => {
        row[name] = event.target.value;
        more.classList.toggle("used", Boolean(row.file || row.remark));
        save();
      });
    }
    element.querySelector(".again").addEventListener("click", () => repeat(row));
  });
  every("[data-item]").forEach((box) => box.addEventListener("click", (event) => {
    if (doubled(box, event)) { event.preventDefault(); return; }
    const name = box.dataset.item;
    change(box.checked ? "tick" : "untick", [], () => { if (box.checked) prepared.add(name); else prepared.delete(name); });
    showNext();
  }));
  every("[data-metered]").forEach((input) => {
    const section = input.dataset.metered;
    input.replaceChildren(...plan.times.map((time) => new Option(`${time.shown} s`, time.metered)));
    input.addEventListener("change", () => meter(section, input.value));
    const [faster, slower] = every("button", input.parentElement);
    faster.addEventListener("click", () => step(section, -1));
    slower.addEventListener("click", () => step(section, 1));
  });
  every(".fold").forEach((button) => button.addEventListener("click", () => {
    fold(button.getAttribute("aria-controls").replace(/-body$/, ""), button.getAttribute("aria-expanded") === "false");
  }));
  byId("taken").addEventListener("click", (event) => {
    const row = nextRow();
    if (row && !doubled("taken", event)) setDone(row, true);
    if (byId("taken").disabled) byId("next").focus();  // a disabled button would lose the keyboard's place
  });
  byId("timer").addEventListener("click", (event) => {
    if (doubled("timer", event)) return;
    if (!timer) { startTimer(); return; }
    stopTimer();
    showNext();
  });
  byId("undo").addEventListener("click", () => {
    undo();
    if (byId("undo").disabled) byId("taken").focus();
  });
  byId("again").addEventListener("click", () => {
    repeat(before(nextRow()));
    if (byId("again").disabled) byId("taken").focus();
  });
  byId("show").addEventListener("click", () => {
    const { element } = nextRow();
    fold(place, true);
    element.querySelector(".more").setAttribute("aria-expanded", "true");
    element.scrollIntoView({ block: "center" });
    element.querySelector(".file").focus({ preventScroll: true });
  });
  byId("place").addEventListener("change", (event) => {
    go(event.target.value);
    lastTaken = null;
    showNext();
    announce("");
  });
  byId("print").addEventListener("click", () => window.print());
  byId("theme").addEventListener("change", (event) => {
    setTheme(event.target.value);
    keep("capture-checklist:theme", event.target.value);
  });
  addEventListener("storage", (event) => {  // the same page in another tab
    if (event.newValue === null) return;
    if (event.key === UNDO) {
      restoreUndo();
      showNext();
    }
    if (event.key !== KEY) return;
    try { adopt(JSON.parse(event.newValue)); } catch { return; }
    showAll();
  });
  document.addEventListener("visibilitychange", stayAwake);
  addEventListener("beforeunload", (event) => { if (unsaved) event.preventDefault(); });
}

every(".screen:not(.warn), .more, .again").forEach((element) => { element.hidden = false; });
byId("not-awake").hidden = "wakeLock" in navigator;
plan.scenes.forEach((scene) => metered.set(scene.name, scene.metered));
keep("capture-checklist:test", "");  // to say at once if nothing is kept
restore();
restoreUndo();
setTheme(kept("capture-checklist:theme"));
startPlace();
fold("preparation", prepared.size < plan.preparation.length);
listen();
showAll();
