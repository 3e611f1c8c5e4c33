// Filters: rows of the table of every image that have the chosen values and hold the words searched for.

const table = document.querySelector("table.sortable");
const bar = document.querySelector(".filters");
const selects = [...bar.querySelectorAll("select")];
const search = bar.querySelector("input");
const heads = [...table.tHead.rows[0].cells].map((cell) => cell.textContent.trim());

function shownRows() {
  return [...table.tBodies[0].rows].filter((row) => !row.hidden);
}

function filter() {
  const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
  const wanted = selects.filter((one) => one.value).map((one) => [heads.indexOf(one.dataset.column), one.value]);
  for (const row of table.tBodies[0].rows) {
    const text = [...row.cells].slice(0, 1 + selects.length).map((cell) => cell.textContent).join(" ").toLowerCase();
    const fits = wanted.every(([column, value]) => row.cells[column].textContent.trim() === value);
    row.hidden = !fits || !words.every((word) => text.includes(word));
  }
  document.getElementById("filter-count").textContent = `${shownRows().length} of ${table.tBodies[0].rows.length}`;
}

for (const one of [...selects, search]) one.addEventListener("input", filter);
bar.hidden = false;
filter();

// The viewer: all pictures of an image show the same part of it, at the same size. Of zoom and place there is one state:
// `scale`, and the point of the pictures that lies in the middle of every glass.

const looking = document.querySelector(".looking");
if (looking) {
  const data = JSON.parse(document.getElementById("look-data").textContent);
  const panels = looking.querySelector(".panels");
  const figures = [...panels.querySelectorAll(".panel")];
  const glasses = [...panels.querySelectorAll(".glass")];
  const boxes = Object.fromEntries([...looking.querySelectorAll(".look-choice input")].map((one) => [one.value, one]));
  const flipButton = looking.querySelector("[data-do=flip]");
  const view = { scale: 1, x: 0, y: 0, flip: false, one: figures[1].dataset.panel };
  let row = null;
  let image = null;

  const firstGlass = () => glasses.find((one) => one.clientWidth) ?? glasses[0];
  const usual = [1, 2, 4, 8, 16];
  const least = () => Math.min(1, firstGlass().clientWidth / image.box[2]); // all of it, or pixel by pixel
  const levels = () => (least() < 0.999 ? [least(), ...usual] : usual);

  function place() {
    const glass = firstGlass();
    const [, , columns, rows] = image.box;
    const middle = (at, length, window) => (window >= length ? length / 2 : Math.min(Math.max(at, window / 2), length - window / 2));
    view.x = middle(view.x, columns, glass.clientWidth / view.scale);
    view.y = middle(view.y, rows, glass.clientHeight / view.scale);
    // All glasses have one size; those that are hidden have none just now.
    const corner = [glass.clientWidth / 2 - view.x * view.scale, glass.clientHeight / 2 - view.y * view.scale];
    for (const one of glasses) {
      one.firstElementChild.style.transform = `translate(${corner[0]}px, ${corner[1]}px) scale(${view.scale})`;
      one.classList.toggle("small", view.scale < 1);
    }
    const text = view.scale >= 1 ? `${+view.scale.toFixed(2)}:1` : `1:${+(1 / view.scale).toFixed(2)}`;
    document.getElementById("look-zoom").value = text;
    const [left, top] = image.box;
    const frame = looking.querySelector(".overview span");
    const width = Math.min(columns, glass.clientWidth / view.scale);
    const height = Math.min(rows, glass.clientHeight / view.scale);
    const share = (value, of) => `${(100 * value) / of}%`;
    frame.style.left = share(left + view.x - width / 2, image.size[0]);
    frame.style.top = share(top + view.y - height / 2, image.size[1]);
    frame.style.width = share(width, image.size[0]);
    frame.style.height = share(height, image.size[1]);
  }

  // `at`: a point of a glass, from its corner, that keeps its place.
  function zoomTo(scale, at = null) {
    const glass = firstGlass();
    if (at) {
      const dx = at[0] - glass.clientWidth / 2;
      const dy = at[1] - glass.clientHeight / 2;
      view.x += dx / view.scale - dx / scale;
      view.y += dy / view.scale - dy / scale;
    }
    view.scale = scale;
    place();
  }

  function zoom(direction, at = null) {
    const every = levels();
    const next = direction > 0 ? every.find((one) => one > view.scale * 1.001) : every.findLast((one) => one < view.scale * 0.999);
    if (next) zoomTo(next, at);
  }

  function pan(dx, dy) {
    view.x -= dx / view.scale;
    view.y -= dy / view.scale;
    place();
  }

  function arrange() {
    for (const figure of figures) {
      const key = figure.dataset.panel;
      figure.hidden = view.flip ? key !== view.one : !boxes[key].checked;
    }
    panels.classList.toggle("flip", view.flip);
    panels.classList.toggle("no-errors", !boxes.error.checked);
    flipButton.setAttribute("aria-pressed", String(view.flip));
    place();
  }

  function show(next, { jump = false } = {}) {
    const found = data[next.id];
    if (!found) return;
    const same = image !== null && image.box.slice(2).join() === found.box.slice(2).join();
    row?.removeAttribute("aria-current");
    row = next;
    image = found;
    row.setAttribute("aria-current", "true");
    looking.dataset.row = row.id;
    document.getElementById("look-name").textContent = image.name;
    document.getElementById("look-facts").textContent = image.facts;
    document.getElementById("look-limit").textContent = image.limit;
    for (const img of looking.querySelectorAll("img[data-layer]")) {
      const address = image.files[img.dataset.layer];
      if (img.getAttribute("src") !== address) img.src = address;
      if (img.dataset.layer !== "whole") [, , img.width, img.height] = image.box;
      img.alt = `${img.alt.split(": ")[0]}: ${image.name}`;
    }
    for (const figure of figures) {
      const words = image.scores[figure.dataset.panel];
      if (words) figure.querySelector("[data-scores]").textContent = words;
    }
    for (const glass of glasses) glass.style.setProperty("--shape", `${image.box[2]} / ${image.box[3]}`);
    if (!same) [view.x, view.y] = [image.box[2] / 2, image.box[3] / 2];
    place();
    // The row comes into the table's own window; the page stays where it is.
    const box = row.closest(".tall");
    const top = row.offsetTop - box.clientHeight / 2;
    if (row.offsetTop < box.scrollTop + 60 || row.offsetTop > box.scrollTop + box.clientHeight - 40) box.scrollTop = top;
    if (jump) looking.scrollIntoView({ block: "nearest" });
    const after = neighbour(1);
    if (after) for (const address of Object.values(data[after.id].files)) new Image().src = address;
  }

  function neighbour(step) {
    const rows = shownRows();
    const at = rows.indexOf(row);
    return at < 0 ? rows[0] : rows[at + step];
  }

  function step(by) {
    const next = neighbour(by);
    if (next) show(next);
  }

  function choose(key) {
    if (!boxes[key]) return;
    if (view.flip && key !== "error") view.one = key;
    else boxes[key].checked = !boxes[key].checked;
    arrange();
  }

  const flip = () => {
    view.flip = !view.flip;
    arrange();
  };
  const acts = { previous: () => step(-1), next: () => step(1), in: () => zoom(1), out: () => zoom(-1), flip };
  for (const button of looking.querySelectorAll("[data-do]")) button.addEventListener("click", () => acts[button.dataset.do]());
  for (const one of Object.values(boxes)) {
    one.addEventListener("change", () => {
      if (view.flip && one.value !== "error") view.one = one.value;
      arrange();
    });
  }

  const pans = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  document.addEventListener("keydown", (event) => {
    const typing = event.target.closest?.("select, textarea, input:not([type=checkbox])");
    if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
    const key = event.key;
    if (event.shiftKey && pans[key]) pan(...pans[key].map((one) => 40 * one));
    else if (key === "ArrowLeft" || key === "ArrowRight") {
      if (event.target.closest?.(".scroll") && !event.target.closest?.("tr")) return; // what scrolls sideways
      step(key === "ArrowLeft" ? -1 : 1);
    } else if (key === "+" || key === "=") zoom(1);
    else if (key === "-") zoom(-1);
    else if (key === "0") zoomTo(1);
    else if (/^[1-9]$/.test(key)) choose(`method-${key}`);
    else if (key === "i") choose("input");
    else if (key === "r") choose("reference");
    else if (key === "e") choose("error");
    else if (key === "f") flip();
    else return;
    event.preventDefault();
  });

  const pointers = new Map();
  const at = (event) => {
    const box = event.target.closest(".glass").getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  for (const glass of glasses) {
    glass.classList.add("live-glass");
    glass.addEventListener("pointerdown", (event) => {
      glass.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    glass.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      const now = [event.clientX, event.clientY];
      const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
      pointers.set(event.pointerId, now);
      if (other) {
        const far = (point) => Math.hypot(point[0] - other[0], point[1] - other[1]) || 1;
        zoomTo(Math.min(16, Math.max(least(), (view.scale * far(now)) / far(before))), at(event));
      } else pan(now[0] - before[0], now[1] - before[1]);
    });
    for (const name of ["pointerup", "pointercancel"]) glass.addEventListener(name, (event) => pointers.delete(event.pointerId));
    glass.addEventListener("dblclick", (event) => zoom(event.shiftKey ? -1 : 1, at(event)));
    glass.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) return; // the page scrolls
      event.preventDefault();
      zoom(event.deltaY < 0 ? 1 : -1, at(event));
    }, { passive: false });
  }

  const byAddress = () => {
    const target = document.getElementById(location.hash.slice(1));
    if (target && data[target.id]) show(target, { jump: true });
  };
  addEventListener("hashchange", byAddress);
  for (const link of document.querySelectorAll("a[href^='#image-']")) {
    link.addEventListener("click", (event) => {
      event.preventDefault();
      const target = document.getElementById(link.hash.slice(1));
      target.hidden = false;
      show(target, { jump: true });
      history.replaceState(null, "", link.hash);
    });
  }

  for (const part of looking.querySelectorAll("[hidden]")) if (!part.matches(".panel")) part.hidden = false;
  show(document.getElementById(looking.dataset.row));
  // One to one; of small images, as many times as they fit.
  view.scale = usual.findLast((one) => one * image.box[2] <= firstGlass().clientWidth) ?? 1;
  arrange();
  byAddress();
  new ResizeObserver(() => {
    view.scale = Math.max(view.scale, least());
    place();
  }).observe(panels);
}
