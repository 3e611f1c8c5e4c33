"use strict";
// The script of the checklist. Everything that it knows about the plan is in the page; what is entered is kept in this
// browser under the plan's digest, in the form that Export writes. The page is whole without it, to read and to print.

const plan = JSON.parse(document.getElementById("plan-data").textContent);
const byId = (id) => document.getElementById(id);
const every = (selector, inside = document) => [...inside.querySelectorAll(selector)];

// --- exact numbers: fractions of BigInt ----------------------------------------------------------------------------
// A camera's 1/60 s is 2^-6 s, its next faster time 2^(-19/3) s. In sixth powers both are fractions, and so are all
// products and quotients; the order stays the same. So rounding here is that of capture.camera, to the last case.

function fraction(text) {
  const [n, d = "1"] = String(text).split("/");
  return { n: BigInt(n), d: BigInt(d) };
}
const times = (a, b) => ({ n: a.n * b.n, d: a.d * b.d });
const over = (a, b) => ({ n: a.n * b.d, d: a.d * b.n });
const less = (a, b) => a.n * b.d < b.n * a.d;
const equal = (a, b) => a.n * b.d === b.n * a.d;
const sixthPower = (a) => ({ n: a.n ** 6n, d: a.d ** 6n });
const log2 = (a) => Math.log2(Number(a.n)) - Math.log2(Number(a.d));

function reduced(a) {
  let [x, y] = [a.n, a.d];
  while (y) [x, y] = [y, x % y];
  return { n: a.n / x, d: a.d / x };
}
function textOf(a) {
  const { n, d } = reduced(a);
  return d === 1n ? String(n) : `${n}/${d}`;
}

/** Seconds as capture.exact.parse_seconds reads them; null if it would refuse. */
function seconds(text) {
  if (!/^(?:[0-9]{1,9}(?:\/[0-9]{1,9}|\.[0-9]{1,9})?|\.[0-9]{1,9})$/.test(text)) return null;
  const [whole, decimals] = text.split(".");
  const found = decimals === undefined ? fraction(text) : fraction(`${whole}${decimals}/1${"0".repeat(decimals.length)}`);
  return found.n > 0n && found.d > 0n ? found : null;
}

// --- the shots of a scene, as capture.shots plans them ---------------------------------------------------------------

const settings = plan.times.map(({ dial, nominal, sixth }) => ({ dial, nominal: fraction(nominal), sixth: fraction(sixth) }));
const stepSixth = fraction(plan.step_sixth);
const fitting = plan.fitting.map((index) => settings[index]);

/** The setting nearest by ratio to a time given as its sixth power; null beyond the camera's by over half a step. */
function nearest(wanted) {
  const square = times(wanted, wanted);
  const last = settings.length - 1;
  let index = 0;
  while (index < last && less(times(settings[index].sixth, settings[index + 1].sixth), square)) index += 1;
  const end = times(settings[index].sixth, settings[index].sixth);
  if (index === 0) {
    const ratio = last === 0 ? stepSixth : over(settings[1].sixth, settings[0].sixth);
    if (less(times(square, ratio), end)) return null;
  }
  if (index === last) {
    const ratio = last === 0 ? stepSixth : over(settings[last].sixth, settings[last - 1].sixth);
    if (less(times(end, ratio), square)) return null;
  }
  return settings[index];
}

/** How much shorter a frame's time is than the reference's: base ISO over ISO and factor. */
const scale = (frame) => ({ n: BigInt(frame.factor === null ? 1 : plan.base_iso), d: BigInt(frame.factor === null ? 1 : frame.iso * frame.factor) });

function sceneShots(metered) {
  const base = settings.find((setting) => equal(setting.nominal, metered)) ?? nearest(sixthPower(metered));
  const shots = plan.frames.map((frame) => {
    const target = textOf(times(base ? base.nominal : metered, scale(frame)));
    if (base === null) return { ...frame, target, setting: null };
    const setting = frame.factor === null ? base : nearest(times(base.sixth, sixthPower(fraction(frame.light))));
    return { ...frame, target, setting };
  });
  const failing = shots.find((shot) => shot.setting === null);
  return {
    shots,
    problem: failing ? whatToChange(metered, failing) : "",
    remarks: failing ? [] : remarks(metered, base, shots),
  };
}

function whatToChange(metered, frame) {
  const tooFast = less(metered, fitting[0].nominal);
  const bound = tooFast ? fitting[0] : fitting[1];
  const limit = tooFast ? settings[0] : settings[settings.length - 1];
  const stops = stopsUp(Math.abs(log2(over(bound.sixth, sixthPower(metered))) / 6));
  const factor = frame.factor === null ? "" : `, x${frame.factor}`;
  const start = `metered at ${textOf(metered)} s (ISO ${plan.base_iso}): ${frame.role} frame ${frame.number} (ISO ${frame.iso}${factor}) `
    + `needs ${textOf(times(metered, scale(frame)))} s, and ${plan.camera}'s ${tooFast ? "fastest" : "slowest"} time is ${limit.dial} s. `;
  if (tooFast) {
    return start + `Let ${stops} less light in, so that the scene meters at ${bound.dial} s or longer: stop down by ${stops}, `
      + `or add a neutral-density filter of ${stops}, or dim the lamps. Another base ISO does not help: ISO x time stays the same`;
  }
  const raised = over(times({ n: BigInt(plan.base_iso), d: 1n }, metered), bound.nominal);
  const least = Math.min(...plan.noisy_isos);
  const other = plan.isos.find((iso) => !less({ n: BigInt(iso), d: 1n }, raised) && iso < least);
  const base = frame.factor === null && other !== undefined ? `; or take ISO ${other} as the base` : "";
  return start + `Let ${stops} more light in, so that the scene meters at ${bound.dial} s or shorter: open up by ${stops}, or add light${base}`;
}

function stopsUp(stops) {
  const thirds = Math.max(1, Math.ceil(3 * stops - 1e-6));
  const parts = [Math.floor(thirds / 3) || "", thirds % 3 ? `${thirds % 3}/3` : ""].filter(Boolean);
  return `${parts.join(" ")} stop${thirds <= 3 ? "" : "s"}`;
}

function remarks(metered, base, shots) {
  const found = [];
  if (!equal(base.nominal, metered)) {
    found.push(`metered at ${textOf(metered)} s, set as ${base.dial} s, the camera's nearest time`);
  }
  const far = shots.filter((shot) => shot.factor !== null && farOff(base, shot));
  if (far.length) {
    found.push(`frames ${far.flatMap((shot) => Array.from({ length: shot.count }, (_, n) => shot.number + n)).join(", ")}: the ratio is more than 10 % off its factor, which eldata `
      + "verify refuses; set the camera to thirds of a stop, or meter another time");
  }
  return found;
}

function farOff(base, shot) {
  const speeds = { n: BigInt(plan.base_iso), d: BigInt(shot.iso) };
  const named = reduced(times(over(base.nominal, shot.setting.nominal), speeds));
  const light = times(fraction(shot.light), { n: BigInt(shot.factor), d: 1n });
  const given = times(over(base.sixth, shot.setting.sixth), sixthPower(light));
  const bound = (tenths) => sixthPower({ n: BigInt(tenths * shot.factor), d: 10n });
  return Math.abs(Number(named.n) / Number(named.d) - shot.factor) > shot.factor / 10
    || less(given, bound(9)) || less(bound(11), given);
}

// --- what has been entered -----------------------------------------------------------------------------------------

const sections = [...plan.scenes.map((scene) => scene.name), ...(plan.calibration.length ? ["calibration"] : [])];
const rows = new Map();      // "scene-1/4" -> what is known and entered of that row, with its element
const metered = new Map();   // scene -> its metered time as text
const scenes = new Map();    // scene -> its shots at that time, problem, remarks
const prepared = new Set();
const undoable = [];
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
  Object.assign(row, { key, section, element, count: 1, dial: null }, fixed, { takenAt: null, repeats: 0, file: "", remark: "" });
  rows.set(key, row);
});
const rowsOf = (section) => [...rows.values()].filter((row) => row.section === section);
const problemOf = (section) => scenes.get(section)?.problem ?? "";
const frameCount = (list) => list.reduce((sum, row) => sum + row.count, 0);

/** Text without tabs and whatever else a file name or remark cannot hold. */
const plain = (text) => text.replace(/[\p{Cc}\p{Cs}]/gu, " ");

/** What Export writes, and what is kept; capture.checklist.load_progress reads it. */
function progress() {
  const one = ({ number, count, role, iso, dial, takenAt, repeats, file, remark }) => (
    { number, count, role, iso, dial, taken_at: takenAt, repeats, file, remark });
  return {
    kind: plan.kind,
    schema: plan.schema,
    plan: plan.digest,
    camera: plan.camera,
    preparation: plan.preparation.filter((name) => prepared.has(name)),
    scenes: plan.scenes.map(({ name }) => ({ name, metered_s: metered.get(name), shots: rowsOf(name).map(one) })),
    calibration: rowsOf("calibration").map(one),
  };
}

/** Take over what Export wrote; return the scenes that do not fit this plan. An unusable file changes nothing. */
function adopt(content) {
  const check = (right, what) => { if (!right) throw new Error(what); };
  check(content && content.kind === plan.kind, "it is not the exported progress of a checklist");
  check(content.schema === plan.schema, "it was written by another version of capture");
  check(content.camera === plan.camera, `it is for the camera ${content.camera}, and this plan is for ${plan.camera}`);
  for (const name of ["preparation", "scenes", "calibration"]) check(Array.isArray(content[name]), `its ${name} is not a list`);
  const left = [];
  const found = [];
  const times = new Map();
  const parts = [...content.scenes, { name: "calibration", shots: content.calibration }];
  for (const part of parts) {
    check(part && typeof part.name === "string" && Array.isArray(part.shots), "a scene lacks its name or its shots");
    const there = rowsOf(part.name);
    if (there.length !== part.shots.length) { left.push(part.name); continue; }
    if (part.name !== "calibration") {
      const time = seconds(String(part.metered_s));
      check(time, `${part.name} has no metered time`);
      times.set(part.name, textOf(time));
    }
    part.shots.forEach((shot, index) => {
      const where = `${part.name}, row ${index + 1}`;
      check(shot && (shot.taken_at === null || typeof shot.taken_at === "string"), `${where}: taken_at is neither a time nor null`);
      check(Number.isInteger(shot.repeats) && shot.repeats >= 0 && shot.repeats <= plan.most_repeats, `${where}: repeats is not a whole number up to ${plan.most_repeats}`);
      for (const name of ["file", "remark"]) {
        check(typeof shot[name] === "string" && shot[name].length <= plan.longest_text, `${where}: ${name} is not a text, or too long`);
      }
    });
    const fits = part.shots.every((shot, index) => ["number", "count", "role", "iso"].every((name) => shot[name] === there[index][name]));
    if (!fits) { left.push(part.name); times.delete(part.name); continue; }
    part.shots.forEach((shot, index) => found.push([there[index], {
      takenAt: shot.taken_at, repeats: shot.repeats, file: plain(shot.file), remark: plain(shot.remark),
    }]));
  }
  for (const [row, entered] of found) Object.assign(row, entered);
  for (const [name, time] of times) metered.set(name, time);
  prepared.clear();
  plan.preparation.filter((name) => content.preparation.includes(name)).forEach((name) => prepared.add(name));
  return left.filter((name) => name !== "calibration" || content.calibration.length);
}

// --- keeping -------------------------------------------------------------------------------------------------------

const KEY = `capture-checklist:${plan.digest}`;

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
  unsaved = !keep(KEY, JSON.stringify(progress()));
}
function restore() {
  const text = kept(KEY);
  if (text === null) return;
  try {
    adopt(JSON.parse(text));
  } catch (error) {
    keep(`${KEY}:unreadable`, text);  // or the next tick would overwrite it
    refuse(`What this browser kept for this page cannot be read (${error.message}); a copy stays under "${KEY}:unreadable".`);
  }
}

// --- showing -------------------------------------------------------------------------------------------------------

function replan(section) {
  if (section === "calibration") return;
  const scene = sceneShots(seconds(metered.get(section)));
  scenes.set(section, scene);
  rowsOf(section).forEach((row, index) => {
    row.dial = scene.shots[index].setting?.dial ?? null;
    row.target = scene.shots[index].target;
  });
}

function showRow(row) {
  const { element } = row;
  const box = element.querySelector(".tick input");
  box.checked = row.done;
  box.disabled = problemOf(row.section) !== "" && !row.done;
  const dial = element.querySelector(".dial");
  dial.textContent = `${row.dial ?? row.target} s`;
  dial.classList.toggle("impossible", row.dial === null);
  let state = "";
  if (row.repeats && !row.done) state = "Take it again; the last one counts.";
  if (row.repeats && row.done) state = `Taken ${row.repeats + 1} times; the last one counts.`;
  if (row.takenAt !== null && !row.done) state = `Taken at ${row.takenAt} s; take it again at this time.`;
  if (row.dial === null) state = `Impossible: the camera has no time near ${row.target} s.`;
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
  const scene = scenes.get(section);
  if (!scene) return;
  const problem = byId(`${section}-problem`);
  problem.hidden = scene.problem === "";
  problem.textContent = scene.problem;
  byId(`${section}-remarks`).replaceChildren(...scene.remarks.map((text) => {
    const item = document.createElement("li");
    item.textContent = text;
    return item;
  }));
  const input = byId(`${section}-metered`);
  if (input !== document.activeElement) input.value = metered.get(section);
  every(".metered-text", byId(`${section}-body`)).forEach((text) => { text.textContent = metered.get(section); });
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
  const problem = problemOf(place);
  const all = [...rows.values()];
  const done = frameCount(all.filter((one) => one.done));
  byId("total").value = done;
  byId("total-text").textContent = `${done} of ${frameCount(all)} frames`;
  byId("preparation-title").querySelector(".count").textContent = `${every(":checked", byId("preparation-body")).length} of ${every("[data-item]", byId("preparation-body")).length}`;
  byId("place").value = place;
  byId("where").textContent = row ? sentence(row) : done === frameCount(all) ? "All frames are taken. Export, then copy the card." : `${place}: all frames are taken.`;
  byId("dials").hidden = !row || problem !== "";
  byId("hint").textContent = row && problem === "" ? hint(row) : "";
  byId("next-iso").textContent = row ? row.iso : "";
  byId("next-dial").textContent = row ? `${row.dial} s` : "";
  byId("next-problem").hidden = !row || problem === "";
  byId("next-problem").textContent = problem;
  byId("taken").disabled = !row || problem !== "";
  byId("taken").textContent = row && row.count > 1 ? `Taken, all ${row.count}` : "Taken";
  byId("show").disabled = !row;
  byId("show").textContent = row && problem ? "Metered time" : "File and remark";
  byId("again").disabled = !before(row);
  const undo = undoable[undoable.length - 1];
  byId("undo").disabled = !undo;
  byId("undo").textContent = undo ? `Undo ${undo.label}` : "Undo";
  every(".shot.now").forEach((element) => element.classList.remove("now"));
  row?.element.classList.add("now");
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
  const next = row && !problemOf(place) ? `Next: ${sentence(row)}, ISO ${row.iso}, ${row.dial} s.` : byId("where").textContent;
  byId("say").textContent = text;
  byId("live").textContent = `${text} ${next}`.trim();
}
function refuse(text) {
  byId("refused").hidden = text === "";
  byId("refused").textContent = text;
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
    rows: list.map((row) => [row, Object.fromEntries(fields.map((name) => [name, row[name]]))]),
    metered: new Map(metered),
    prepared: [...prepared],
    place,
  });
  if (undoable.length > 200) undoable.shift();
  edit();
  save();
}

function undo() {
  const last = undoable.pop();
  if (!last) return;
  for (const [row, entered] of last.rows) Object.assign(row, entered);
  for (const [name, time] of last.metered) metered.set(name, time);
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
  const input = byId(`${section}-metered`);
  const found = seconds(text.trim().replace(/\s*s$/, "").replace(",", "."));
  input.setAttribute("aria-invalid", String(!found));
  if (!found) {
    const problem = byId(`${section}-problem`);
    problem.hidden = false;
    problem.textContent = `"${text}" is not a time: write seconds such as 4, 1/2 or 0.5. The shots below are still those of ${metered.get(section)} s.`;
    return;
  }
  const time = textOf(found);
  input.value = time;
  if (time === metered.get(section)) { showSection(section); return; }
  change(`metered time of ${section}`, [], () => {
    metered.set(section, time);
    replan(section);
  });
  const taken = rowsOf(section).filter((row) => row.takenAt !== null && !row.done);
  showSection(section);
  showNext();
  const planned = problemOf(section) ? "cannot be taken when metered at" : "is planned for";
  announce(`${section} ${planned} ${time} s.${taken.length ? ` ${taken.length} shots were taken at other settings and are to be taken again.` : ""}`);
}

/** The camera's next faster or slower time. */
function step(section, direction) {
  const now = seconds(metered.get(section));
  const other = direction < 0
    ? settings.filter((setting) => less(setting.nominal, now)).pop()
    : settings.find((setting) => less(now, setting.nominal));
  if (other) meter(section, textOf(other.nominal));
}

// Cold fingers tap twice: the second tap within half a second on the same control is not meant.
const tap = { what: null, at: -Infinity };
function doubled(what, event) {
  const soon = tap.what === what && event.timeStamp - tap.at < 500;
  tap.what = what;
  tap.at = event.timeStamp;
  return soon;
}

const exported = () => JSON.stringify(progress(), null, 1) + "\n";  // in short lines, which terminals take

function exportFile() {
  const address = URL.createObjectURL(new Blob([exported()], { type: "application/json" }));
  const link = document.createElement("a");
  link.href = address;
  link.download = `${plan.camera}-progress.json`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(address), 60000);
  unsaved = false;
  byId("kept").textContent = `Exported as ${link.download}.`;
}

/** Put the exported text on the clipboard; where the browser forbids that, show it to be copied by hand. */
async function copyText() {
  let copied = true;
  try { await navigator.clipboard.writeText(exported()); } catch { copied = false; }
  byId("text-label").hidden = copied;
  if (!copied) {
    byId("text").value = exported();
    byId("text").select();
  }
  byId("kept").textContent = copied ? "Copied." : "";
}

async function importFile(file) {
  refuse("");
  byId("kept").textContent = "";
  let content;
  try { content = JSON.parse(await file.text()); } catch { refuse(`${file.name}: is not JSON.`); return; }
  let left = [];
  try {
    change("import", [...rows.values()], () => { left = adopt(content); }, ["takenAt", "repeats", "file", "remark"]);
  } catch (error) {
    undoable.pop();
    refuse(`${file.name}: ${error.message}.`);
    return;
  }
  lastTaken = null;
  showAll();
  startPlace();
  showNext();
  byId("kept").textContent = `Imported ${file.name}.${left.length ? ` Not in this plan, and left out: ${left.join(", ")}.` : ""}`;
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
        row[name] = plain(event.target.value);
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
    if (problemOf(place)) { byId(`${place}-metered`).focus(); return; }
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
  byId("export").addEventListener("click", exportFile);
  byId("copy").addEventListener("click", copyText);
  byId("import").addEventListener("click", () => byId("import-file").click());
  byId("import-file").addEventListener("change", (event) => {
    const [file] = event.target.files;
    if (file) importFile(file).finally(() => { event.target.value = ""; });
  });
  byId("print").addEventListener("click", () => window.print());
  byId("theme").addEventListener("change", (event) => {
    setTheme(event.target.value);
    keep("capture-checklist:theme", event.target.value);
  });
  addEventListener("storage", (event) => {  // the same page in another tab
    if (event.key !== KEY || event.newValue === null) return;
    try { adopt(JSON.parse(event.newValue)); } catch { return; }
    undoable.length = 0;
    showAll();
  });
  addEventListener("beforeunload", (event) => { if (unsaved) event.preventDefault(); });
}

every(".screen, .more, .again").forEach((element) => { element.hidden = element.id === "not-kept"; });
plan.scenes.forEach((scene) => metered.set(scene.name, scene.metered));
keep("capture-checklist:test", "");  // to say at once if nothing is kept
restore();
setTheme(kept("capture-checklist:theme"));
startPlace();
fold("preparation", prepared.size < plan.preparation.length);
listen();
showAll();
