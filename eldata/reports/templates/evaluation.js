"use strict";

// Tables: the heads of sortable ones become buttons.

const collator = new Intl.Collator("en", { numeric: true });

function keyOf(row, column) {
  const text = row.cells[column].dataset.value;
  return text === undefined ? row.cells[column].textContent.trim() : Number(text);
}

function compare(a, b) {
  if (typeof a === "number" && typeof b === "number") return a < b ? -1 : a > b ? 1 : 0;
  return collator.compare(String(a), String(b));
}

function sortBy(table, head, say) {
  const column = head.cellIndex;
  const direction = head.getAttribute("aria-sort") === "ascending" ? "descending" : "ascending";
  for (const other of head.parentElement.cells) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", direction);
  const sign = direction === "ascending" ? 1 : -1;
  const body = table.tBodies[0];
  const rows = [...body.rows].map((row, index) => ({ row, index, key: keyOf(row, column) }));
  const unknown = (item) => Number.isNaN(item.key);
  rows.sort((a, b) => unknown(a) - unknown(b) || (unknown(a) ? 0 : sign * compare(a.key, b.key)) || a.index - b.index);
  body.append(...rows.map((item) => item.row));
  say.textContent = `Sorted by ${head.textContent.trim()}, ${direction}.`;
}

for (const table of document.querySelectorAll("table.sortable")) {
  const say = document.createElement("p");
  say.className = "unseen";
  say.setAttribute("role", "status");
  table.parentElement.after(say);
  for (const head of table.tHead.rows[0].cells) {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => sortBy(table, head, say));
  }
}

// Viewers: two of the pictures lie on each other, and a line divides them.

for (const viewer of document.querySelectorAll(".viewer")) {
  const stage = viewer.querySelector(".stage");
  const range = viewer.querySelector("input[type=range]");
  const layers = [...stage.querySelectorAll(".layer")];
  const names = Object.fromEntries(layers.map((layer) => [layer.dataset.layer, layer.dataset.label]));

  const choose = (side, name) => {
    for (const layer of layers) layer.classList.toggle(side, layer.dataset.layer === name);
    viewer.querySelector(`.tag.${side}`).textContent = names[name];
  };
  const move = () => {
    stage.style.setProperty("--at", `${range.value}%`);
    range.setAttribute("aria-valuetext", `${range.value} % from the left`);
  };
  const drag = (event) => {
    const box = stage.getBoundingClientRect();
    range.value = Math.round((100 * (event.clientX - box.left)) / box.width);
    move();
  };

  for (const radio of viewer.querySelectorAll("input[type=radio]")) {
    radio.addEventListener("change", () => choose(radio.dataset.side, radio.value));
    if (radio.checked) choose(radio.dataset.side, radio.value);
  }
  range.addEventListener("input", move);
  stage.addEventListener("pointerdown", (event) => {
    stage.setPointerCapture(event.pointerId);
    drag(event);
  });
  stage.addEventListener("pointermove", (event) => {
    if (stage.hasPointerCapture(event.pointerId)) drag(event);
  });
  stage.addEventListener("dragstart", (event) => event.preventDefault());
  viewer.querySelector(".controls").hidden = false;
  viewer.classList.add("live");
  move();
}
