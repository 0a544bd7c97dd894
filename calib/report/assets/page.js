"use strict";
// Tables sort on a click on a header: numbers by value, text by the reader's alphabet; a second click turns the order round.
for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => head.firstElementChild.addEventListener("click", () => {
    const down = head.getAttribute("aria-sort") === "ascending";
    for (const other of heads) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
    const body = table.tBodies[0];
    const rows = [...body.rows].sort((a, b) => {
      const [x, y] = [a.cells[column].dataset.key, b.cells[column].dataset.key];
      const [u, v] = [parseFloat(x), parseFloat(y)];
      const order = Number.isNaN(u) || Number.isNaN(v) ? x.localeCompare(y) : u - v;
      return down ? -order : order;
    });
    body.append(...rows);
  }));
}
// What is folded on the screen is printed.
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((fold) => { fold.open = true; }));
